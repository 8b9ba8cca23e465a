"""A model's own effect with wrong numbers gets no other effect's name; with right ones it stands in no other's way."""

from dataclasses import replace

import pytest
from recordings import MAKE, Record

from tofmix.reconciliation.profiles import numeric
from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.words import headline
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

KINDS = ("wiggling", "range_offset", "surface_pose", "multipath", "fixed_pattern", "excess_noise", "temperature_drift")
WRONG = (
    (MAKE["wiggling"](amplitude_mm=12.0, phase_rad=0.5), MAKE["wiggling"](amplitude_mm=20.0, phase_rad=0.5)),
    (
        MAKE["multipath"](surface="near", share=0.06, extra_path_mm=900.0),
        MAKE["multipath"](surface="near", share=0.10, extra_path_mm=900.0),
    ),
)


@pytest.mark.parametrize(("given", "true"), WRONG, ids=[given.kind for given, _ in WRONG])
def test_it_is_said_to_have_other_numbers(model: Model, record: Record, given: Effect, true: Effect) -> None:
    result = reconcile(replace(model, effects=(given,)), record(true), Settings(kinds=KINDS))
    assert (result.verified.verdict, result.named) == ("unexplained", ())
    assert result.verified.own is not None
    assert result.verified.own.kind == true.kind
    if true.kind == "wiggling":  # a path and its share are told apart by less
        assert numeric(result.verified.own) == pytest.approx(numeric(true), rel=0.05)
    assert "the model's own effect fits better with other numbers" in headline(result)


def test_with_right_numbers_it_leaves_another_its_name(model: Model, record: Record) -> None:
    given, hidden = WRONG[0][1], MAKE["surface_pose"](surface="middle", shift_mm=20.0)
    result = reconcile(replace(model, effects=(given,)), record(given, hidden), Settings(kinds=KINDS))
    assert result.verified.own is None
    assert [n.effect.kind for n in result.named] == ["surface_pose"]
