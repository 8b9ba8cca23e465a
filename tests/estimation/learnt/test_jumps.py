"""A jump in mid-window is two surfaces, a smooth drift is one: the same samples in another order."""

import numpy as np
import pytest
from support.learnt_pixels import SIGMA_MM, camera_with, flat, pixel_noise

from tofmix.arrays import FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions
from tofmix.layers import Layers

FRAMES, PIXELS = 150, 120
TIME = np.linspace(-1.0, 1.0, FRAMES)[:, np.newaxis]
DRIFTING = pixel_noise(drift_mm=(2.0 * SIGMA_MM, 0.5 * SIGMA_MM, 0.3 * SIGMA_MM))
RANGE_MM = 2000.0


def _layers(path_sigmas: FloatArray, rng: np.random.Generator) -> Layers:
    """Layers of pixels whose range follows a path (frame, 1), in sigmas."""
    samples = RANGE_MM + SIGMA_MM * (path_sigmas + rng.standard_normal((FRAMES, PIXELS)))
    return layer_pixels(samples, camera_with(DRIFTING, flat(8.0)))


@pytest.mark.parametrize(
    "path",
    [
        0.0 * TIME,
        1.5 * TIME,
        3.0 * TIME,
        -3.0 * TIME,
        2.0 * TIME**2,
        1.5 * np.sin(2.0 * TIME),
        2.0 * TIME + 1.0 * (2.5 * TIME**3 - 1.5 * TIME),
    ],
    ids=["none", "slow", "fast", "backward", "there and back", "slowing", "of third degree"],
)
def test_smooth_drift_is_one_surface(path: FloatArray, rng: np.random.Generator) -> None:
    layers = _layers(path, rng)
    assert (layers.n_modes == 1).mean() >= 0.97
    # What is stated is the place that the drift goes through on average.
    one = layers.n_modes == 1
    assert float(np.median(layers.range[one, 0])) == pytest.approx(RANGE_MM + SIGMA_MM * path.mean(), abs=6.0)


@pytest.mark.parametrize("at", [0.25, 0.5, 0.75])
@pytest.mark.parametrize("height", [4.0, -6.0, 12.0, 60.0])
def test_a_jump_is_two_surfaces(height: float, at: float, rng: np.random.Generator) -> None:
    layers = _layers(np.where(np.arange(FRAMES)[:, np.newaxis] < at * FRAMES, 0.0, height), rng)
    assert (layers.n_modes == 2).mean() >= 0.95
    two = layers.n_modes == 2
    np.testing.assert_allclose(
        np.median(layers.range[two, :2], axis=0),
        np.sort([RANGE_MM, RANGE_MM + height * SIGMA_MM]),
        atol=0.3 * SIGMA_MM,
    )


def test_two_surfaces_that_take_turns_are_two_where_drift_is_allowed(rng: np.random.Generator) -> None:
    turns = np.where(rng.random((FRAMES, 1)) < 0.5, 5.0, 0.0)
    assert (_layers(turns, rng).n_modes == 2).mean() >= 0.97


def test_two_surfaces_that_drift_together_are_two(rng: np.random.Generator) -> None:
    both = 12.0 * (rng.random((FRAMES, PIXELS)) < 0.5) + 2.0 * TIME
    samples = RANGE_MM + SIGMA_MM * (both + rng.standard_normal((FRAMES, PIXELS)))
    layers = layer_pixels(samples, camera_with(DRIFTING, flat(8.0)))
    assert (layers.n_modes == 2).mean() >= 0.95


def test_order_of_frames_matters_only_where_noise_drifts(rng: np.random.Generator) -> None:
    ramp = np.repeat(3.0 * TIME, PIXELS, axis=1)
    samples = (RANGE_MM + SIGMA_MM * (ramp + rng.standard_normal((FRAMES, PIXELS)))).astype(np.float32)
    mixed = samples[rng.permutation(FRAMES)]
    still = pixel_noise("skewed", background=(1.0, 9.0), width_spread=0.3, memory=0.2)
    one, other = (layer_pixels(block, camera_with(still)) for block in (samples, mixed))
    for a, b in zip(one.arrays(), other.arrays(), strict=True):
        assert a.tobytes() == b.tobytes()
    one, other = (layer_pixels(block, camera_with(DRIFTING)) for block in (samples, mixed))
    assert (one.n_modes == 1).mean() >= 0.97
    assert (other.n_modes > 1).mean() >= 0.9  # a ramp of 6 sigma in any order is wider than one surface


def test_neither_block_nor_neighbours_change_a_pixel(rng: np.random.Generator) -> None:
    samples = (RANGE_MM + SIGMA_MM * (2.0 * TIME + rng.standard_normal((FRAMES, PIXELS)))).astype(np.float32)
    whole = layer_pixels(samples, camera_with(DRIFTING))
    for first in range(0, PIXELS, 40):
        part = layer_pixels(samples[:, first : first + 40], camera_with(DRIFTING))
        for a, b in zip(part.arrays(), whole.arrays(), strict=True):
            assert a.tobytes() == b[first : first + 40].tobytes()


def test_no_pixel_drifts_on_a_circle(rng: np.random.Generator) -> None:
    samples = RANGE_MM + SIGMA_MM * (2.0 * TIME + rng.standard_normal((FRAMES, 20)))
    still = pixel_noise()
    on_circle = EstimateOptions(unambiguous_range_mm=8000.0)
    one, other = (layer_pixels(samples, camera_with(noise, flat(8.0)), on_circle) for noise in (DRIFTING, still))
    for a, b in zip(one.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(a, b)
