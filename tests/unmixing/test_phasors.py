"""Mean phasors: against NumPy's own moments, with outliers, gaps, and ranges beyond a turn."""

import numpy as np
import pytest

from tofmix.sensor import Sensor
from tofmix.unmixing.phasors import FIELDS, mean_phasors, phase_scale_mm

CAMERA = Sensor(name="lock-in", modulation_frequency_hz=20.0e6, outlier_probability=1e-4)
SCALE = phase_scale_mm(20.0e6)


def _drawn(
    rng: np.random.Generator, range_mm: float, frames: int = 60, pixels: int = 40
) -> tuple[np.ndarray, np.ndarray]:
    z = (
        100.0 * np.exp(1j * range_mm / SCALE)
        + rng.normal(0, 2, (frames, pixels))
        + 1j * rng.normal(0, 2, (frames, pixels))
    )
    turns = np.rint((range_mm - SCALE * np.angle(z)) / (2 * np.pi * SCALE))
    return SCALE * (np.angle(z) + 2 * np.pi * turns), np.abs(z)


def test_mean_and_covariance_are_those_of_numpy(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    found = mean_phasors(ranges, light, CAMERA)
    z = light * np.exp(1j * ranges / SCALE)
    np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], z.mean(axis=0), atol=1e-3)
    for pixel in range(z.shape[1]):
        expected = np.cov(z[:, pixel].real, z[:, pixel].imag)
        np.testing.assert_allclose(found[pixel, 2:5], [expected[0, 0], expected[1, 1], expected[0, 1]], atol=2e-2)
    np.testing.assert_array_equal(found[:, FIELDS.index("samples")], 60)


@pytest.mark.parametrize("range_mm", [300.0, 3700.0, 7300.0, 9000.0, 16000.0])
def test_range_of_the_mean_is_on_the_turn_of_the_samples(rng: np.random.Generator, range_mm: float) -> None:
    found = mean_phasors(*_drawn(rng, range_mm), CAMERA)
    back = SCALE * (np.angle(found[:, 0] + 1j * found[:, 1]) + 2 * np.pi * found[:, 6])
    np.testing.assert_allclose(back, range_mm, atol=20.0)


def test_one_outlier_is_left_out_and_a_second_surface_is_not(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    wild, several = ranges.copy(), ranges.copy()
    wild[7] = 5800.0
    several[:15] = 4000.0
    np.testing.assert_array_equal(mean_phasors(wild, light, CAMERA)[:, 5], 59)
    clean, found = (
        mean_phasors(np.delete(ranges, 7, 0), np.delete(light, 7, 0), CAMERA),
        mean_phasors(wild, light, CAMERA),
    )
    np.testing.assert_allclose(found[:, :2], clean[:, :2], rtol=1e-5)
    np.testing.assert_array_equal(mean_phasors(several, light, CAMERA)[:, 5], 60)


def test_samples_without_range_or_amplitude_are_skipped(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    gaps, dark = ranges.copy(), light.copy()
    gaps[::3], dark[1::3] = np.nan, np.nan
    np.testing.assert_allclose(
        mean_phasors(gaps, dark, CAMERA), mean_phasors(ranges[2::3], light[2::3], CAMERA), rtol=1e-5
    )
    np.testing.assert_array_equal(mean_phasors(np.full((5, 3), np.nan), np.ones((5, 3)), CAMERA), 0.0)


def test_pixels_do_not_depend_on_each_other(rng: np.random.Generator) -> None:
    ranges, light = _drawn(rng, 2500.0)
    ranges[3, ::2] = 6000.0
    together = mean_phasors(ranges, light, CAMERA)
    alone = np.concatenate([mean_phasors(ranges[:, [k]], light[:, [k]], CAMERA) for k in range(ranges.shape[1])])
    np.testing.assert_array_equal(together, alone)


def test_an_unknown_frequency_is_refused() -> None:
    with pytest.raises(ValueError, match="modulation frequency"):
        mean_phasors(np.ones((3, 2)), np.ones((3, 2)), Sensor(name="direct"))
