"""Effects that the simulator hides are named; a right model is left alone; other changes get no name."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from support.reconcile_errors import in_errors
from support.recordings import MAKE, Record, reconciled, recorded

from tofmix.reconciliation.comparison.compare import localise
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.words import headline
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.effects.parameter import PixelMap
from tofmix.simulation.model import Model

STUCK = np.full((14, 18), np.nan, dtype=np.float32)
STUCK.flat[::60] = 3000
HIDDEN: dict[str, Effect] = {
    effect.kind: effect
    for effect in (
        MAKE["range_offset"](offset_mm=15.0),
        MAKE["surface_pose"](surface="middle", shift_mm=20.0),
        MAKE["surface_offset"](surface="middle", offset_mm=35.0),
        MAKE["wiggling"](amplitude_mm=15.0, phase_rad=0.7),
        MAKE["tap_mismatch"](amplitude_2_mm=15.0, phase_2_rad=0.7),
        MAKE["amplitude_walk"](scale_mm=8.0, reference_amplitude=100.0, exponent=0.8),
        MAKE["temperature_drift"](amplitude_mm=40.0, time_constant_s=2.0),
        MAKE["motion"](surface="middle", velocity_mm_s=4.0),
        MAKE["scattering"](share=0.05),
        MAKE["multipath"](surface="middle", share=0.1, extra_path_mm=1500.0),
        MAKE["internal_reflection"](amplitude=6.0, range_mm=20.0),
        MAKE["near_return"](share=0.06, range_mm=25.0, sigma_mm=5.0),
        MAKE["smooth_pattern"](radial_2_mm=14.0, radial_4_mm=10.0),
        MAKE["fixed_pattern"](pixel_sigma_mm=3.0, column_sigma_mm=4.0, row_sigma_mm=2.0),
        MAKE["excess_noise"](factor=1.4),
        MAKE["vignetting"](corner_factor=1.6),
        MAKE["outliers"](probability=0.02),
        MAKE["pixel_crosstalk"](share=0.05),
        MAKE["flying_pixels"](probability=0.3),
        MAKE["dropout"](probability=0.05),
        MAKE["saturation"](full_well_amplitude=340.0),
        MAKE["interference"](probability=0.25, sigma_mm=30.0, burst_frames=5.0),
        MAKE["temporal_correlation"](coefficient=0.6),
        MAKE["quantisation"](step_mm=6.5),
        MAKE["phase_wrapping"](),
        MAKE["stuck_pixels"](map=PixelMap("stuck.npy", STUCK)),
    )
}
RIVALS = ("range_offset", "surface_pose", "excess_noise", "outliers", "temporal_correlation", "fixed_pattern")


WITHOUT_ERRORS = ("phase_wrapping", "stuck_pixels")
"""Kinds whose numbers are known exactly, or are a map."""


def alone(small: Model, kind: str) -> Reconciliation:
    """The outcome for one hidden effect, among rivals that are searched for quickly."""
    model = small
    if kind == "phase_wrapping":  # a turn of 3.75 m, so that a part of the wall lies beyond it
        model = replace(small, sensor=replace(small.sensor, modulation_frequency_hz=40e6))
    if kind == "motion":  # each frame is cast separately: few frames over 8 s, of two surfaces
        recording = replace(small.recording, frames=25, frame_rate_hz=3.0)
        model = replace(small, recording=recording, surfaces=small.surfaces[1:])
    return reconciled(model, HIDDEN[kind], kinds=tuple(k for k in KINDS if k in {kind, *RIVALS}))


def test_table_of_hidden_effects_has_every_kind() -> None:
    assert set(HIDDEN) == set(EFFECTS), "add the kind to HIDDEN in this file, with values that close a clear gap"


@pytest.mark.parametrize("kind", EFFECTS)
def test_effect_hidden_alone_is_named_and_closes_the_gap(small: Model, kind: str) -> None:
    result = alone(small, kind)
    assert [n.effect.kind for n in result.named] == [kind], f"{headline(result)}; candidates {result.candidates}"
    verified = result.verified
    assert (verified.verdict, verified.law, verified.own) == ("explained", None, None)
    assert verified.closed is not None
    assert 0.85 < verified.closed < 1.05
    assert verified.floor.gap < 1.3
    (named,) = result.named
    off = in_errors(HIDDEN[kind], named.effect, named.stderr)
    assert bool(off) == (kind not in WITHOUT_ERRORS)
    assert all(abs(distance) < 4 for distance in off.values()), off
    assert ("between samples 1" in headline(result)) == (kind == "temporal_correlation")
    assert "tolerance" not in headline(result)


def test_share_of_samples_between_surfaces_returns_to_prediction_with_flying_pixels(small: Model) -> None:
    """Of few mixed pixels, in some of which the nearer surface prevails and in some the farther one: scores cancel."""
    verified = alone(small, "flying_pixels").verified
    before, after = (
        max(c.z for c in panel.curves if c.statistic == "bridging") for panel in (verified.before, verified.after)
    )
    assert before > norm.isf(1e-4)
    assert after < 3


def test_right_model_agrees_with_the_gap_of_noise_alone(model: Model) -> None:
    result = reconciled(model, kinds=KINDS)
    assert result.verified.verdict == "agree"
    assert result.named == ()
    assert result.as_dict()["gap"]["before"] == pytest.approx(1.0, abs=0.25)


def test_model_off_by_less_than_the_tolerance_agrees(model: Model, record: Record) -> None:
    nearly = tuple(replace(s, reflectivity=s.reflectivity * 1.04) for s in model.surfaces)
    off = tuple(MAKE["surface_pose"](surface=s.name, shift_mm=d) for s, d in zip(nearly, (0.4, -0.7, 1.5), strict=True))
    result = reconcile(replace(model, surfaces=nearly), record(*off), Settings(kinds=KINDS))
    assert result.verified.verdict == "agree"


@pytest.mark.slow
def test_frames_with_random_biases_are_unexplained_on_the_frame_axis(small: Model) -> None:
    evidence = recorded(small)
    jitter = np.random.default_rng(8).normal(size=len(evidence.samples)) * 6.0
    shaken = np.rint(evidence.samples + jitter[:, None]).astype(np.uint16)
    result = reconcile(
        small, replace(evidence, samples=shaken), Settings(kinds=("temperature_drift", "interference", "range_offset"))
    )
    assert result.verified.verdict == "unexplained"
    assert result.named == ()
    assert result.where[0].axis == "frame"
    assert "None of the known effects explains it" in headline(result)


def test_shift_is_given_in_mm_if_many_pixels_see_open_space(
    in_the_open: Callable[[Effect], tuple[Model, Evidence]],
) -> None:
    """Empty pixels are in the bins of rows and columns too; their sigma is none that a shift is seen by."""
    result = reconcile(*in_the_open(MAKE["range_offset"](offset_mm=6.0)), Settings(kinds=("range_offset",)))
    shifts = [p for p in localise(result.verified.before, 0.01) if p.statistic == "bias" and p.unit == "mm"]
    assert {"row", "col"} & {p.axis for p in shifts}
    assert all(p.size == pytest.approx(6.0, rel=0.15) for p in shifts)
