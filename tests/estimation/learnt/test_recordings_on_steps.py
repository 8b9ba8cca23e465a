"""Learnt noise and layers of recordings whose ranges are stored on a step."""

import numpy as np
import pytest
from numpy.typing import NDArray

import tofmix as tm

SIGMA_MM = 6.0
FRAMES, ROWS, COLS = 60, 12, 20


def place() -> NDArray[np.float64]:
    return np.random.default_rng(1).uniform(1500.0, 4500.0, (ROWS, COLS))


def samples() -> NDArray[np.float64]:
    """Samples (frame, row, col), mm, of one surface in each pixel."""
    return np.asarray(place() + SIGMA_MM * np.random.default_rng(2).standard_normal((FRAMES, ROWS, COLS)))


def estimated(values: NDArray[np.float64], *, noise: tm.NoiseCurve | None = None, max_iter: int = 50) -> tm.Estimate:
    camera = tm.Sensor(name="camera", range_min_mm=500.0, range_max_mm=8000.0)
    recording = tm.from_array(values.astype(np.float32), units="mm", sensor=camera)
    return tm.estimate(recording, workers=1, noise=noise, max_iter=max_iter)


@pytest.mark.parametrize(
    "step", [0.3, pytest.param(1.0, marks=pytest.mark.slow), 2.0, pytest.param(5.0, marks=pytest.mark.slow)]
)
def test_sigma_false_alarms_and_errors_are_those_of_the_noise_before_rounding(step: float) -> None:
    step_mm = step * SIGMA_MM
    found = estimated(step_mm * np.rint(samples() / step_mm))
    assert found.sensor.range_step_mm is not None
    assert found.sensor.range_step_mm == pytest.approx(step_mm, rel=1e-6)
    assert np.nanmedian(found.sigma[0, ..., 0]) == pytest.approx(SIGMA_MM, rel=0.05)
    one = found.n_modes[0] == 1
    assert one.mean() > 0.99
    error = (found.range[0, ..., 0] - place())[one] / found.range_stderr[0, ..., 0][one]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=0.12)


@pytest.mark.slow
def test_a_step_by_range_stands_at_the_ranges_of_the_curve() -> None:
    part = 2.0 * SIGMA_MM / 3000.0
    found = estimated(np.exp(part * np.rint(np.log(samples()) / part)))
    noise, step = found.sensor.noise, found.sensor.range_step_mm
    assert noise is not None
    assert step is not None
    assert step.shape == noise.range_mm.shape
    inside = (noise.range_mm > 1600.0) & (noise.range_mm < 4400.0)
    np.testing.assert_allclose(step[inside], part * noise.range_mm[inside], rtol=0.03)
    assert np.nanmedian(found.sigma[0, ..., 0]) == pytest.approx(SIGMA_MM, rel=0.05)


@pytest.mark.slow
def test_steps_of_pixels_are_a_map_and_serve_their_pixels() -> None:
    own = 2.0 * SIGMA_MM * (1.0 + 0.3 * np.random.default_rng(3).random((ROWS, COLS)))
    found = estimated(own * np.rint(samples() / own))
    assert found.sensor.range_step_mm is not None
    np.testing.assert_allclose(found.sensor.range_step_mm, own, rtol=1e-3)
    assert np.nanmedian(found.sigma[0, ..., 0]) == pytest.approx(SIGMA_MM, rel=0.05)
    assert (found.n_modes == 1).mean() > 0.99


@pytest.mark.slow
def test_samples_of_one_value_have_the_standard_error_of_their_step() -> None:
    step_mm = 10.0 * SIGMA_MM
    values = step_mm * np.rint(samples() / step_mm)
    found = estimated(values, max_iter=1000)
    constant = (values == values[0]).all(axis=0)
    assert 0.4 < constant.mean() < 0.8
    stderr = found.range_stderr[0, ..., 0][constant]
    assert stderr.min() > 0.1 * step_mm
    assert stderr.max() < 0.5 * step_mm
    error = (found.range[0, ..., 0] - place())[constant]
    assert np.abs(error).max() < 0.6 * step_mm


@pytest.mark.slow
def test_two_alternating_values_are_one_surface_between_them() -> None:
    values = np.where(np.arange(FRAMES)[:, None, None] % 2 == 0, 3000.0, 3004.0) * np.ones((1, ROWS, COLS))
    found = estimated(values)
    assert found.sensor.range_step_mm == pytest.approx(4.0)
    assert (found.n_modes == 1).all()
    np.testing.assert_allclose(found.range[0, ..., 0], 3002.0, atol=0.05)
    assert (found.range_stderr[0, ..., 0] > 0.01).all()
    assert (found.sigma[0, ..., 0] >= 0.4).all()


def test_a_given_curve_is_integrated_over_the_step_too() -> None:
    step_mm = 2.0 * SIGMA_MM
    curve = tm.NoiseCurve(np.array([3000.0]), np.array([SIGMA_MM]))
    found = estimated(step_mm * np.rint(samples() / step_mm), noise=curve)
    assert found.sensor.noise is not None
    np.testing.assert_array_equal(found.sensor.noise.sigma_mm, SIGMA_MM)
    assert (found.n_modes == 1).mean() > 0.99


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*have two layers within 5 sigma:tofmix.errors.DoubtWarning")
def test_pairs_two_sigma_apart_are_found_and_not_taken_for_widths() -> None:
    rng, step_mm = np.random.default_rng([1, 100]), 0.9 * SIGMA_MM
    values = rng.uniform(1500.0, 4500.0, (15, 40)) + SIGMA_MM * rng.standard_normal((100, 15, 40))
    values[:, :, ::4] += 2.0 * SIGMA_MM * (rng.random((100, 15, 10)) < 0.5)
    found = estimated(step_mm * np.rint(values / step_mm))
    assert found.sensor.noise is not None
    assert found.sensor.noise.width_spread == 0.0
    assert (found.n_modes[0, :, ::4] == 2).mean() > 0.9  # of 150 pixels; taken for widths, it is 0.03
    assert (np.delete(found.n_modes[0], np.s_[::4], axis=1) > 1).mean() < 0.01
