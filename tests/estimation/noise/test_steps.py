"""The step of stored ranges: found where values repeat on one, never in continuous values."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tofmix.estimation.noise.steps import find_step, step_of_recording
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor

SIGMA_MM = 6.0
FRAMES = (12, 30, 100, 400)


def continuous(frames: int, pixels: int = 1500, sigma_mm: float = SIGMA_MM, seed: int = 1) -> NDArray[np.float64]:
    """Samples (pixel, frame), mm, of surfaces at 1 to 6 m."""
    rng = np.random.default_rng(seed)
    return rng.uniform(1000.0, 6000.0, (pixels, 1)) + sigma_mm * rng.standard_normal((pixels, frames))


def on(step_mm: float | NDArray[np.float64], range_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(step_mm * np.rint(range_mm / step_mm))


@pytest.mark.parametrize("frames", FRAMES)
@pytest.mark.parametrize("sigma_mm", [20.0, 6.0, 0.1, 0.005, 0.001])  # float32 has steps of 0.0001 to 0.0005 mm
def test_no_step_in_continuous_values(frames: int, sigma_mm: float) -> None:
    for seed in range(4):
        samples = continuous(frames, sigma_mm=sigma_mm, seed=seed)
        assert find_step(samples.astype(np.float32)) is None


@pytest.mark.parametrize("frames", FRAMES)
def test_no_step_where_continuous_values_have_constants_and_two_surfaces(frames: int) -> None:
    samples = continuous(frames)
    samples[::5] = samples[::5, :1]  # stuck
    samples[1::5, ::2] += 300.0
    samples[2::5, ::3] = 7500.0  # no return
    assert find_step(samples.astype(np.float32)) is None


@pytest.mark.parametrize("frames", FRAMES)
@pytest.mark.parametrize("step", [0.3, 1.0, 3.0, 10.0])
def test_a_common_step_is_found_exactly(frames: int, step: float) -> None:
    found = find_step(on(step * SIGMA_MM, continuous(frames)).astype(np.float32))
    assert found is not None
    assert found.is_common
    assert found.typical() == pytest.approx(step * SIGMA_MM, rel=1e-6)


@pytest.mark.parametrize("jitter_mm", [0.001, 0.01])
def test_a_step_is_found_in_values_that_a_conversion_has_moved(jitter_mm: float) -> None:
    samples = on(2.0, continuous(100))
    samples += np.random.default_rng(2).uniform(-jitter_mm, jitter_mm, samples.shape)
    found = find_step(samples.astype(np.float32))
    assert found is not None
    assert found.is_common
    assert found.typical() == pytest.approx(2.0, abs=0.2 * jitter_mm)


@pytest.mark.parametrize("step", [0.3, 1.0, 3.0])
def test_a_step_by_range_is_within_a_thousandth_at_each_range(step: float) -> None:
    part = step * SIGMA_MM / 3000.0
    found = find_step(np.exp(part * np.rint(np.log(continuous(100)) / part)).astype(np.float32))
    assert found is not None
    assert found.own_mm is None
    ranges = np.array([1200.0, 2000.0, 3000.0, 5000.0, 5900.0])
    np.testing.assert_allclose(found.at(ranges), part * ranges, rtol=1e-3)


@pytest.mark.parametrize("frames", [12, 100])
@pytest.mark.parametrize("sigma_mm", [1.0, 3.0])
@pytest.mark.parametrize(("unit_mm", "doubles_mm"), [(1.0, (2048.0, 4096.0)), (1000.0, (2000.0, 4000.0))])
def test_the_step_of_16_bit_floats_doubles_at_powers_of_two_of_their_unit(
    unit_mm: float, doubles_mm: tuple[float, float], sigma_mm: float, frames: int
) -> None:
    samples = (continuous(frames, sigma_mm=sigma_mm) / unit_mm).astype(np.float16).astype(np.float32) * unit_mm
    found = find_step(samples.astype(np.float32))
    assert found is not None
    assert found.own_mm is None
    ranges = np.array([1050.0, *(factor * end for end in doubles_mm for factor in (0.999, 1.001)), 5900.0])
    stored = np.spacing((ranges / unit_mm).astype(np.float16)).astype(float) * unit_mm
    np.testing.assert_allclose(found.at(ranges), stored, rtol=1e-3)


@pytest.mark.parametrize("step", [0.3, 2.0, 10.0])
def test_steps_of_pixels_are_found_in_each_pixel_that_shows_them(step: float) -> None:
    samples = continuous(100)
    own = step * SIGMA_MM * (1.0 + 0.2 * np.random.default_rng(3).random((len(samples), 1)))
    found = find_step(on(own, samples).astype(np.float32))
    assert found is not None
    assert found.own_mm is not None
    known = np.isfinite(found.own_mm)
    assert known.mean() > (0.9 if step < 10.0 else 0.3)  # a pixel of one value shows none
    assert (np.abs(found.own_mm[known] / own[known, 0] - 1.0) < 1e-3).mean() > 0.98


def test_two_surfaces_and_random_values_hide_no_step() -> None:
    rng = np.random.default_rng(4)
    samples = continuous(100)
    samples += 350.0 * (rng.random(samples.shape) < 0.4)
    random = rng.random(samples.shape) < 0.1
    samples[random] = rng.uniform(500.0, 8000.0, int(random.sum()))
    samples[rng.random(samples.shape) < 0.1] = np.nan
    found = find_step(on(1.83, samples).astype(np.float32))
    assert found is not None
    assert found.typical() == pytest.approx(1.83, rel=1e-4)


def test_two_alternating_values_show_their_distance() -> None:
    samples = np.where(np.arange(50) % 2 == 0, 3000.0, 3002.5) * np.ones((40, 1))
    found = find_step(samples.astype(np.float32))
    assert found is not None
    assert found.typical() == pytest.approx(2.5)
    assert find_step(np.full((40, 50), 3000.0, np.float32)) is None


def test_steps_of_pixels_of_a_recording_are_those_of_its_image() -> None:
    rows, cols = 12, 20
    own = 4.0 * (1.0 + 0.2 * np.random.default_rng(5).random((rows, cols)))
    samples = continuous(60, pixels=rows * cols).T.reshape(60, rows, cols)
    found = step_of_recording(ArrayRecording(on(own, samples), Sensor(name="camera")))
    assert found is not None
    assert found.own_mm is not None
    np.testing.assert_allclose(found.own_mm.reshape(rows, cols), own, rtol=1e-3)
