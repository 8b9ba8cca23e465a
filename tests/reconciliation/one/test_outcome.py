"""The outcome of the search as `reconcile` has it."""

from dataclasses import replace

import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

KINDS = ("range_offset", "surface_pose", "amplitude_walk", "excess_noise", "temperature_drift", "fixed_pattern")
OFFSET, NOISE = MAKE["range_offset"](offset_mm=9.0), MAKE["excess_noise"](factor=1.4)


def _found(model: Model, *hidden: Effect, also: Model | None = None, **options: object) -> Reconciliation:
    settings = Settings(**{"kinds": KINDS, **options})  # type: ignore[arg-type]
    further = [] if also is None else [(also, recorded(also, *hidden, seed=8))]
    return reconcile(model, recorded(model, *hidden), settings, also=further)


def _kinds(found: Reconciliation) -> set[str]:
    return {n.effect.kind for n in found.named}


def test_named_effects_have_errors_and_held_out_gains(small: Model) -> None:
    found = _found(small, OFFSET, NOISE)
    assert (found.verified.verdict, _kinds(found)) == ("explained", {"range_offset", "excess_noise"})
    offset = next(n for n in found.named if n.effect.kind == "range_offset")
    assert abs(offset.effect.numbers()["offset_mm"] - 9.0) < 4 * offset.stderr["offset_mm"]
    assert all(n.heldout_gain_nats > 5 for n in found.named)


def test_sets_that_were_weighed_have_reasons_and_the_winner_is_first(small: Model) -> None:
    found = _found(small, OFFSET, NOISE)
    first, *others = found.added.considered
    assert {kind for kind, _ in first.names} == _kinds(found)
    assert first.why_not is None
    assert others
    assert all(other.why_not for other in others)
    assert max(o.evidence_nats for o in others if len(o.names) <= 2) <= first.evidence_nats


def test_a_right_model_agrees(small: Model) -> None:
    found = _found(small)
    assert found.verified.verdict == "agree"
    assert not found.named
    assert found.as_dict()["effects"] == []


def test_search_keeps_to_its_kinds_and_to_its_most_effects(small: Model) -> None:
    only = _found(small, OFFSET, NOISE, kinds=("excess_noise",))
    assert _kinds(only) <= {"excess_noise"}
    assert {c.kind for c in only.added.chosen} <= {"excess_noise"}
    assert len(_found(small, OFFSET, NOISE, max_effects=1).added.chosen) == 1
    assert not _found(small, OFFSET, max_effects=0).added.chosen


def test_effects_of_the_model_stay_and_are_not_named_again(small: Model) -> None:
    own = replace(small, effects=(OFFSET,))
    found = reconcile(own, recorded(own, OFFSET, NOISE), Settings(kinds=KINDS))
    assert _kinds(found) == {"excess_noise"}


def test_own_pattern_of_the_model_is_integrated_out(small: Model) -> None:
    pattern = MAKE["fixed_pattern"](pixel_sigma_mm=6.0, column_sigma_mm=4.0, row_sigma_mm=4.0)
    own = replace(small, effects=(pattern,))
    found = reconcile(own, recorded(own, pattern, NOISE), Settings(kinds=KINDS))
    assert _kinds(found) == {"excess_noise"}


def test_two_recordings_share_an_effect_of_the_camera(small: Model) -> None:
    away = tuple(
        replace(s, name=f"far {s.name}", center_mm=(*s.center_mm[:2], s.center_mm[2] + 600)) for s in small.surfaces
    )
    found = _found(small, OFFSET, also=replace(small, surfaces=away))
    assert _kinds(found) == {"range_offset"}
    assert found.named[0].recordings == (0, 1)
    assert found.named[0].effect.numbers()["offset_mm"] == pytest.approx(9.0, abs=1.0)


@pytest.mark.parametrize("hidden", [(), (OFFSET,), (NOISE,)], ids=lambda hidden: "".join(e.kind for e in hidden))
def test_widths_of_single_pixels_are_integrated_out(small: Model, hidden: tuple[Effect, ...]) -> None:
    noise = replace(small.sensor.noise, width_spread=0.2)
    wide = replace(small, sensor=replace(small.sensor, noise=noise))
    found = reconcile(wide, recorded(wide, *hidden), Settings(kinds=("range_offset", "excess_noise", "fixed_pattern")))
    assert found.verified.verdict == ("explained" if hidden else "agree")
    assert _kinds(found) == {e.kind for e in hidden}
