"""An effect with a structure is named beside a fixed pattern, whose columns could stand for most of it."""

from dataclasses import replace

import pytest
from support.reconcile_errors import in_errors
from support.recordings import MAKE, reconciled

from tofmix.reconciliation.parameters.standard_errors import numeric
from tofmix.reconciliation.workflow import Reconciliation
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model

COLUMNS = MAKE["fixed_pattern"](pixel_sigma_mm=2.0, column_sigma_mm=10.0, row_sigma_mm=2.0)
KINDS = (
    "range_offset",
    "surface_pose",
    "wiggling",
    "amplitude_walk",
    "scattering",
    "multipath",
    "temperature_drift",
    "fixed_pattern",
    "excess_noise",
)
slow = pytest.mark.slow


def named_within_errors(result: Reconciliation, hidden: tuple[Effect, ...]) -> bool:
    """Whether exactly the hidden effects are named, each number within 4 standard errors; a pattern by its kind."""
    assert result.verified.verdict == "explained"
    assert sorted(n.effect.kind for n in result.named) == sorted(e.kind for e in hidden)
    for effect in hidden:
        own = next(n for n in result.named if n.effect.kind == effect.kind)
        if effect.kind != "fixed_pattern":
            off = in_errors(effect, own.effect, own.stderr)
            assert off.keys() == {name for name, value in numeric(effect).items() if value}
            assert all(abs(distance) < 4 for distance in off.values()), off
    return True


FEW = ("range_offset", "wiggling", "fixed_pattern")
WAVE = MAKE["wiggling"](amplitude_mm=20.0, phase_rad=0.7)


@pytest.mark.parametrize(
    ("effect", "kinds"),
    [
        pytest.param(WAVE, FEW, id="wiggling, few rivals"),
        pytest.param(WAVE, KINDS, id="wiggling"),
        pytest.param(MAKE["scattering"](share=0.05), KINDS, id="scattering"),
        pytest.param(MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=1.5), KINDS, id="drift"),
    ],
)
@pytest.mark.slow
def test_structured_effect_is_named_in_the_presence_of_columns(
    small: Model, effect: Effect, kinds: tuple[str, ...]
) -> None:
    two = replace(small, surfaces=small.surfaces[1:])
    assert named_within_errors(reconciled(two, effect, COLUMNS, kinds=kinds), (effect, COLUMNS))


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [FEW, KINDS], ids=["few rivals", "all rivals"])
def test_columns_alone_are_named_a_pattern_only(small: Model, kinds: tuple[str, ...]) -> None:
    assert named_within_errors(reconciled(small, COLUMNS, kinds=kinds), (COLUMNS,))


@slow
def test_pose_and_offset_together_are_not_named_a_pattern(small: Model) -> None:
    """The pose, added first, absorbs a part of the offset; the remainder looks like another law."""
    hidden = MAKE["surface_pose"](surface="middle", shift_mm=25.0), MAKE["range_offset"](offset_mm=8.0)
    assert named_within_errors(reconciled(small, *hidden, kinds=KINDS), hidden)


DRIFT = MAKE["temperature_drift"](amplitude_mm=12.0, time_constant_s=2.0)
