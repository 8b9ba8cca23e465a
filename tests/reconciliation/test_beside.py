"""What has a structure is named beside a fixed pattern, whose columns could stand for most of it."""

import pytest
from recordings import MAKE, Record

from tofmix.reconciliation.profiles import numeric
from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

COLUMNS = MAKE["fixed_pattern"](pixel_sigma_mm=2.0, column_sigma_mm=10.0, row_sigma_mm=2.0)
KINDS = (
    "range_offset", "surface_pose", "wiggling", "amplitude_walk", "scattering", "multipath", "temperature_drift",
    "fixed_pattern", "excess_noise",
)  # fmt: skip
STRUCTURED = (
    MAKE["wiggling"](amplitude_mm=20.0, phase_rad=0.7),
    MAKE["scattering"](share=0.05),
    MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=1.5),
)


@pytest.mark.parametrize("effect", STRUCTURED, ids=[e.kind for e in STRUCTURED])
def test_a_structured_effect_is_named_beside_columns(model: Model, record: Record, effect: Effect) -> None:
    result = reconcile(model, record(effect, COLUMNS), Settings(kinds=KINDS))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == sorted([effect.kind, "fixed_pattern"])
    own = next(n for n in result.named if n.effect.kind == effect.kind)
    truth, found = numeric(effect), numeric(own.effect)
    assert all(abs(found[name] - truth[name]) < 4 * own.stderr[name] for name in truth)


def test_columns_alone_are_nothing_else(model: Model, record: Record) -> None:
    result = reconcile(model, record(COLUMNS), Settings(kinds=KINDS))
    assert [n.effect.kind for n in result.named] == ["fixed_pattern"]
    assert result.verified.verdict == "explained"


def test_a_pose_and_an_offset_are_no_pattern(model: Model, record: Record) -> None:
    """The pose, added first, takes a part of the offset; what is left over looks like a law of another shape."""
    hidden = MAKE["surface_pose"](surface="middle", shift_mm=25.0), MAKE["range_offset"](offset_mm=8.0)
    result = reconcile(model, record(*hidden), Settings(kinds=KINDS))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == ["range_offset", "surface_pose"]


def test_what_changes_in_time_is_looked_at_though_it_is_far_behind_alone(model: Model, record: Record) -> None:
    """Beside the pattern that a large pose looks like, a small drift is the first; alone, wider noise gains more."""
    hidden = (
        MAKE["surface_pose"](surface="middle", shift_mm=90.0),
        MAKE["temperature_drift"](amplitude_mm=-9.0, time_constant_s=2.0),
    )
    kinds = (*KINDS, "motion", "vignetting", "outliers")
    result = reconcile(model, record(*hidden), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == ["surface_pose", "temperature_drift"]


TOGETHER = (
    (MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=2.0), MAKE["range_offset"](offset_mm=-8.0)),
    (MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=2.0), MAKE["range_offset"](offset_mm=8.0)),
    (MAKE["motion"](surface="near", velocity_mm_s=-3.0), MAKE["surface_pose"](surface="near", shift_mm=15.0)),
)


@pytest.mark.parametrize("hidden", TOGETHER, ids=["away from it", "with it", "of one surface"])
def test_what_changes_in_time_is_told_from_what_is_static(
    model: Model, record: Record, hidden: tuple[Effect, ...]
) -> None:
    """Alone, what changes takes up a part of what does not, and has numbers that no step leads away from."""
    kinds = ("temperature_drift", "range_offset", "motion", "surface_pose", "multipath", "wiggling", "fixed_pattern")
    result = reconcile(model, record(*hidden), Settings(kinds=kinds))
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == sorted(e.kind for e in hidden)
    for effect in hidden:
        own = next(n for n in result.named if n.effect.kind == effect.kind)
        truth, found = numeric(effect), numeric(own.effect)
        assert all(abs(found[name] - truth[name]) < 4 * own.stderr[name] for name in truth)


def test_a_drift_and_nothing_else_has_no_offset_beside(model: Model, record: Record) -> None:
    hidden = MAKE["temperature_drift"](amplitude_mm=40.0, time_constant_s=2.0)
    kinds = ("temperature_drift", "range_offset", "surface_pose")
    result = reconcile(model, record(hidden), Settings(kinds=kinds))
    assert [n.effect.kind for n in result.named] == ["temperature_drift"]
