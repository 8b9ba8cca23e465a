"""The noise law, the sensor of a profile, and its bounds."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tofmix.sensors import SensorProfile, load_profile


@pytest.fixture
def profile() -> SensorProfile:
    return load_profile("sr3000")


def test_noise_follows_the_integration_time(profile: SensorProfile) -> None:
    for tau in (0.2, 1.2, 10.0, 51.0):
        np.testing.assert_allclose(profile.noise_at(tau).sigma_mm, profile.noise.sigma_mm * (10.0 / tau) ** 0.5)
    np.testing.assert_array_equal(profile.noise_at(10.0).range_mm, profile.noise.range_mm)


def test_noise_scaled_in_two_steps_equals_one_step(profile: SensorProfile) -> None:
    other = replace(profile, noise=profile.noise_at(1.2), reference_integration_time_ms=1.2)
    np.testing.assert_allclose(other.noise_at(3.4).sigma_mm, profile.noise_at(3.4).sigma_mm)


def test_sensor_is_at_the_profiles_time(profile: SensorProfile) -> None:
    sensor = replace(profile, integration_time_ms=1.2).sensor()
    assert sensor.integration_time_ms == 1.2
    assert sensor.noise is not None
    np.testing.assert_allclose(sensor.noise.sigma_mm, profile.noise_at(1.2).sigma_mm)
    for key in ("name", "modulation_frequency_hz", "range_min_mm", "range_max_mm", "fov_horizontal_deg"):
        assert getattr(sensor, key) == getattr(profile, key)


@pytest.mark.parametrize("tau", [0.0, -1.0, float("nan"), float("inf")])
def test_noise_at_an_invalid_time_is_refused(profile: SensorProfile, tau: float) -> None:
    with pytest.raises(ValueError, match=r"^integration_time_ms: "):
        profile.noise_at(tau)


@pytest.mark.parametrize(
    "change",
    [
        {"rows": 0},
        {"cols": 4097},
        {"fov_horizontal_deg": 361.0},
        {"fov_vertical_deg": 0.0},
        {"range_min_mm": -1.0},
        {"range_min_mm": 8000.0},
        {"range_max_mm": 65_001.0},
        {"modulation_frequency_hz": 0.0},
        {"integration_time_ms": float("nan")},
        {"default_integration_time_ms": 0.0},
        {"reference_integration_time_ms": float("inf")},
        {"outlier_probability": 1.0},
        {"outlier_probability": float("nan")},
        {"exponent": -0.1},
    ],
)
def test_values_out_of_bounds_are_refused(profile: SensorProfile, change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(change))}: "):
        replace(profile, **change)
