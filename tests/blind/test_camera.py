from dataclasses import replace

import numpy as np
import pytest
from scipy.special import kolmogorov
from scipy.stats import kstest

from blind.calibrate import calibrated, flat_field
from blind.camera import Device, record
from blind.cases import DEVICES, draw_device
from blind.geometry import Array, cast
from blind.reference import scores, uniforms
from blind.scenes import draw_scene

DEVICE = Device(name="test camera", rows=40, cols=52, frames=120)


def _ks_pvalues(u: Array) -> Array:
    """Kolmogorov-Smirnov p-values (pixel,) of uniforms (frame, pixel), by Stephens' approximation."""
    n = len(u)
    u = np.sort(u, axis=0)
    steps = np.arange(n + 1)[:, None] / n
    distance = np.maximum(steps[1:] - u, u - steps[:-1]).max(axis=0)
    p: Array = kolmogorov(distance * (np.sqrt(n) + 0.12 + 0.11 / np.sqrt(n)))
    return p


@pytest.mark.slow
def test_samples_of_each_pixel_follow_equation_1_without_effects() -> None:
    """Per-pixel KS tests over 2080 pixels, mixed ones and open space included: their p-values are uniform."""
    surfaces = draw_scene("open_hall", [3], DEVICE.view).surfaces
    beams = cast(surfaces, DEVICE.view)
    assert ((beams.share > 0).sum(axis=0) > 1).sum() > 50
    short = replace(DEVICE, frames=80)
    samples = record(short, surfaces, seed=7).range_mm.reshape(short.frames, -1).astype(float)
    u = uniforms(samples, beams, DEVICE, calibrated(DEVICE), np.random.default_rng(1))
    p = _ks_pvalues(u)
    assert p.size >= 2000
    assert kstest(p, "uniform").pvalue > 0.01
    assert p.min() > 0.01 / p.size


@pytest.mark.slow
def test_moments_are_those_of_equation_1_without_effects() -> None:
    surfaces = draw_scene("near_far", [5], DEVICE.view).surfaces
    samples = record(DEVICE, surfaces, seed=8).range_mm.reshape(DEVICE.frames, -1).astype(float)
    noise = calibrated(DEVICE)
    score = scores(samples, cast(surfaces, DEVICE.view), DEVICE, noise, np.random.default_rng(1))
    n = score.size
    for power, mean, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((score**power).mean() - mean) < 4 * np.sqrt(variance / n)


def test_noise_of_a_board_depends_on_its_range_alone() -> None:
    """The contract's sigma depends on the range alone; the ambient light is such that the taps' noise does too."""
    noise = calibrated(DEVICE)
    for k, away in enumerate((700.0, 2500.0, 6000.0)):
        spread = flat_field(DEVICE, away, 40_000, seed=50 + k).std()
        assert spread == pytest.approx(float(noise.sigma(np.array(away))), rel=4 / np.sqrt(2 * 40_000))
        assert spread == pytest.approx(float(DEVICE.design_sigma(away)), rel=0.03)


@pytest.mark.parametrize("far", [False, True])
def test_phase_noise_is_below_a_fifth_of_a_radian(*, far: bool) -> None:
    for number in range(DEVICES):
        device = draw_device(1, number, far=far)
        sigma = float(device.design_sigma(device.range_max_mm))
        assert sigma * 2 * np.pi / device.unambiguous_mm < 0.2


def test_same_seed_gives_the_same_recording_and_another_another() -> None:
    small = replace(DEVICE, rows=8, cols=10, frames=20)
    surfaces = draw_scene("boards", [1], small.view).surfaces
    one, two, other = (record(small, surfaces, seed=s).range_mm for s in (1, 1, 2))
    assert (one == two).all()
    assert (one != other).mean() > 0.5
