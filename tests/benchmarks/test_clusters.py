"""The rule by which tests/benchmarks/real.py says what real pixels see, on pixels that are made up."""

import argparse
from pathlib import Path

import numpy as np
import pytest
from benchmarks import real, real_recordings
from benchmarks.clusters import (
    Judged,
    Kind,
    judge_recording,
)
from benchmarks.simulated_noise import CAMERA, NOISES, draw

import tofmix
from tofmix.arrays import FloatArray

LOW, TOP = 300.0, 6000.0
pytestmark = pytest.mark.slow  # of the benchmarks alone

SIGMA = 15.0


def judged(samples: FloatArray) -> Judged:
    """Judge made-up pixels of a known working range."""
    return judge_recording(samples, range_min_mm=LOW, range_max_mm=TOP)


def share(found: Judged, kind: Kind) -> float:
    return found.pixels(kind).size / len(found.kind)


def surfaces(
    rng: np.random.Generator,
    *,
    pixels: int,
    frames: int = 100,
    apart: float = 0.0,
    lesser: float = 0.5,
    background: float = 0.0,
) -> FloatArray:
    """Samples (frame, pixel) of two surfaces `apart` sigma from each other, on uniform background."""
    second = rng.random((frames, pixels)) < lesser
    place = rng.uniform(1000.0, 5000.0, pixels) + apart * SIGMA * second
    samples = place + SIGMA * rng.standard_normal((frames, pixels))
    random = rng.random((frames, pixels)) < background
    return np.asarray(np.where(random, rng.uniform(LOW, TOP, (frames, pixels)), samples))


@pytest.mark.parametrize("name", [name for name in NOISES if "background" not in name])
def test_one_surface_of_any_shape_width_or_drift_is_single(name: str) -> None:
    samples = draw(NOISES[name], 60, 500, np.random.default_rng(1)).samples
    assert share(judged(samples), Kind.SINGLE) > 0.99


@pytest.mark.parametrize(("lesser", "background"), [(0.5, 0.0), (0.2, 0.0), (0.5, 0.4), (0.2, 0.4)])
def test_two_surfaces_far_apart_are_double(lesser: float, background: float) -> None:
    rng = np.random.default_rng(4)
    samples = np.hstack(
        [
            surfaces(rng, pixels=200, apart=40.0, lesser=lesser, background=background),
            surfaces(rng, pixels=200, background=background),
        ]
    )
    found = judged(samples)
    double = found.kind[:200] == list(Kind).index(Kind.DOUBLE)
    assert double.mean() > (0.9 if lesser * (1.0 - background) < 0.15 else 0.98)
    assert (double | found.faint[:200]).mean() > 0.97
    assert (found.kind[200:] == list(Kind).index(Kind.SINGLE)).mean() > 0.98


def test_splice_has_the_requested_distance_share_and_number_of_pixels() -> None:
    rng = np.random.default_rng(17)
    recording = tofmix.from_array(np.rint(500.0 + 20.0 * rng.standard_normal((100, 20, 20))), units="mm", sensor=CAMERA)
    made = real_recordings.SinglePixels(
        real_recordings.RealRecording(name="made up", recording=recording, most_split=0.0)
    ).splice(sigma_mm=20.0, distance=10.0, share=0.2, pixels=200, mixed=0.15, rng=rng)
    assert made.spliced.size == 30
    assert made.distance == pytest.approx(10.0, rel=0.01)
    samples = made.recording.range_mm[:, 0, :]
    assert samples.shape == (100, 200)
    away = np.abs(samples[:, made.spliced] - np.median(samples[:, made.spliced], axis=0)) > 100.0
    np.testing.assert_allclose(away.mean(axis=0), 0.2, atol=0.001)
    rest = np.setdiff1d(np.arange(200), made.spliced)
    assert np.abs(samples[:, rest] - 500.0).max() < 100.0


def test_table_of_the_recording_of_the_project_has_its_pixels() -> None:
    chosen = argparse.Namespace(data=Path("/nowhere"), only=["vl53l8cx"], workers=1)
    assert list(real.run_real(chosen)) == []
    judged = real_recordings.tmf8829().judged()
    assert (judged.pixels(Kind.SINGLE).size, judged.pixels(Kind.DOUBLE).size) == (240, 15)
