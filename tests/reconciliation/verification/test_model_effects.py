"""No effect is named instead of a model's own one with wrong numbers; with right numbers, other effects are named."""

from dataclasses import replace

import pytest
from support.reconcile_errors import scene
from support.recordings import MAKE, recorded

from tofmix.reconciliation.parameters.standard_errors import numeric
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.words import headline
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

KINDS = ("wiggling", "range_offset", "surface_pose", "multipath", "fixed_pattern", "excess_noise", "temperature_drift")
WEAK, STRONG = (MAKE["wiggling"](amplitude_mm=a, phase_rad=0.5) for a in (12.0, 20.0))
FAINT, CLEAR = (MAKE["multipath"](surface="near", share=s, extra_path_mm=900.0) for s in (0.06, 0.10))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "true"),
    [pytest.param(WEAK, STRONG, id="wiggling"), pytest.param(FAINT, CLEAR, id="multipath")],
)
def test_given_effect_with_wrong_numbers_is_unexplained_with_better_ones(
    small: Model, given: Effect, true: Effect
) -> None:
    model = scene(rows=10, cols=12, frames=60) if given is WEAK else small
    result = reconcile(replace(model, effects=(given,)), recorded(model, true), Settings(kinds=KINDS))
    assert (result.verified.verdict, result.named) == ("unexplained", ())
    assert result.verified.own is not None
    assert result.verified.own.kind == true.kind
    if true.kind == "wiggling":  # path and share of a second path are less certain
        found, wanted = numeric(result.verified.own), numeric(true)
        assert found["amplitude_mm"] == pytest.approx(wanted["amplitude_mm"], rel=0.05)
        assert found["phase_rad"] == pytest.approx(wanted["phase_rad"], abs=0.1)
    assert "the model's own effect fits with other numbers" in headline(result)


@pytest.mark.slow
def test_missing_pose_is_named_if_the_given_effect_has_right_numbers(small: Model) -> None:
    hidden = MAKE["surface_pose"](surface="middle", shift_mm=20.0)
    kinds = ("wiggling", "range_offset", "surface_pose", "fixed_pattern")
    result = reconcile(replace(small, effects=(STRONG,)), recorded(small, STRONG, hidden), Settings(kinds=kinds))
    assert result.verified.own is None
    assert [n.effect.kind for n in result.named] == ["surface_pose"]
