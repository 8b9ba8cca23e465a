"""What the model has already is part of its prediction, of whatever kind: nothing is missing, or only what is."""

from dataclasses import replace

import numpy as np
import pytest
from support.reconcile_errors import EFFECTS_OF
from support.recordings import MAKE, reconciled, recorded

from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model

IMAGE = (14, 18)
BIASES = np.random.default_rng(7).normal(0, 8, IMAGE).astype(np.float32)
STUCK = np.full(IMAGE, np.nan, dtype=np.float32)
STUCK[3, 4], STUCK[10, 11] = 777, 2000

GIVEN: dict[str, Effect] = {name: effects[0] for name, effects in EFFECTS_OF.items() if len(effects) == 1} | {
    "phase_wrapping": MAKE["phase_wrapping"](),
    "fixed_pattern, map": MAKE["fixed_pattern"](map=PixelMap("biases.npy", BIASES)),
    "stuck_pixels": MAKE["stuck_pixels"](share=0.01),
    "stuck_pixels, map": MAKE["stuck_pixels"](map=PixelMap("stuck.npy", STUCK)),
    "motion, fast": MAKE["motion"](surface="middle", velocity_mm_s=200.0),
    "pixel_crosstalk, strong": MAKE["pixel_crosstalk"](share=0.15),
    "temporal_correlation, strong": MAKE["temporal_correlation"](coefficient=0.9),
    "quantisation, coarse": MAKE["quantisation"](step_mm=80.0),
}
VARIANTS = (
    "temperature_drift, slow",
    "multipath, faint",
    "dropout of dark samples",
    "motion, fast",
    "pixel_crosstalk, strong",
    "temporal_correlation, strong",
    "quantisation, coarse",
)
"""Further magnitudes of kinds that are given once anyway."""
RIVALS = ("range_offset", "surface_pose", "excess_noise", "fixed_pattern", "temporal_correlation", "temperature_drift")


def _with(small: Model, given: Effect) -> Model:
    """The model with the effect; with a motion, few frames of two surfaces, because each frame is cast separately."""
    if given.kind == "motion":
        recording = replace(small.recording, frames=30, frame_rate_hz=4.0)
        return replace(small, effects=(given,), recording=recording, surfaces=small.surfaces[1:])
    return replace(small, effects=(given,))


def test_every_kind_of_effect_is_given_once() -> None:
    kinds = {effect.kind for effect in GIVEN.values()}
    assert kinds == set(EFFECTS), (
        "add the kind to EFFECTS_OF in tests/support/reconcile_errors.py, alone, or to GIVEN in this file"
    )


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in VARIANTS else ()) for name in GIVEN]
)
def test_recording_agrees_with_a_model_that_has_its_effect(model: Model, small: Model, name: str) -> None:
    has = _with(model if name == "temporal_correlation, strong" else small, GIVEN[name])
    assert reconciled(has, GIVEN[name], seed=3, kinds=RIVALS).verified.verdict == "agree"


@pytest.mark.slow
def test_map_that_was_measured_agrees_with_the_next_recording(small: Model) -> None:
    """The map has the errors of so many frames; `--tolerance` covers them."""
    kinds = ("fixed_pattern", "range_offset", "surface_pose")
    pattern = MAKE["fixed_pattern"](map=PixelMap("biases.npy", BIASES))
    (named,) = reconciled(small, pattern, kinds=kinds).named
    again = reconcile(replace(small, effects=(named.effect,)), recorded(small, pattern, seed=9), Settings(kinds=kinds))
    assert again.verified.verdict == "agree"
