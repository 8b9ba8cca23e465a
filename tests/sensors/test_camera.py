"""A camera: what may be missing of it, its noise law, its sensor, and its bounds."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tofmix.sensor import NoiseCurve
from tofmix.sensors import UNKNOWN, Camera, CompleteCamera, load_camera, load_profile

CURVE = NoiseCurve(np.array([1000.0]), np.array([8.0]))


def test_camera_without_gaps_equals_its_complete_camera() -> None:
    camera, profile = load_camera("sr3000"), load_profile("sr3000")
    assert camera.missing() == ()
    for key in ("rows", "cols", "fov_horizontal_deg", "range_max_mm", "exponent", "outlier_probability"):
        assert getattr(camera, key) == getattr(profile, key)
    mine, theirs = camera.sensor().noise, profile.sensor().noise
    assert mine is not None
    assert theirs is not None
    np.testing.assert_array_equal(mine.sigma_mm, theirs.sigma_mm)


def test_unknown_camera_has_no_values() -> None:
    sensor = UNKNOWN.sensor()
    assert sensor.name == "unknown"
    assert sensor.noise is None
    for key in ("range_min_mm", "range_max_mm", "fov_horizontal_deg", "modulation_frequency_hz"):
        assert getattr(sensor, key) is None


def test_noise_without_a_time_is_used_only_where_it_does_not_depend_on_time() -> None:
    law = Camera(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.5)
    assert law.sensor().noise is None
    constant = Camera(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.0)
    assert constant.sensor().noise is CURVE
    timed = Camera(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.5, integration_time_ms=2.5)
    noise = timed.sensor().noise
    assert noise is not None
    assert noise.sigma_mm.tolist() == [16.0]


@pytest.mark.parametrize(
    "change",
    [
        {"rows": 0},
        {"cols": 5000},
        {"fov_horizontal_deg": 361.0},
        {"fov_vertical_deg": 181.0},
        {"fov_vertical_deg": math.nan},
        {"range_min_mm": 5.0, "range_max_mm": 4.0},
        {"outlier_probability": 1.0},
        {"noise": CURVE},
        {"exponent": 0.5},
        {"reference_integration_time_ms": 0.0, "noise": CURVE, "exponent": 0.5},
        {"exponent": -1.0, "noise": CURVE, "reference_integration_time_ms": 10.0},
        {"integration_time_ms": 0.0, "noise": CURVE, "reference_integration_time_ms": 10.0, "exponent": 0.5},
        {"exponent": 5000.0, "noise": CURVE, "reference_integration_time_ms": 10.0, "integration_time_ms": 1.0},
    ],
)
def test_invalid_sensor_values_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change)).split("_")[0]):
        Camera(name="a", **change)  # type: ignore[arg-type]


@pytest.fixture
def profile() -> CompleteCamera:
    return load_profile("sr3000")


def test_noise_follows_the_integration_time(profile: CompleteCamera) -> None:
    for tau in (0.2, 1.2, 10.0, 51.0):
        np.testing.assert_allclose(profile.noise_at(tau).sigma_mm, profile.noise.sigma_mm * (10.0 / tau) ** 0.5)
    np.testing.assert_array_equal(profile.noise_at(10.0).range_mm, profile.noise.range_mm)


def test_noise_scaled_in_two_steps_equals_one_step(profile: CompleteCamera) -> None:
    other = replace(profile, noise=profile.noise_at(1.2), reference_integration_time_ms=1.2)
    np.testing.assert_allclose(other.noise_at(3.4).sigma_mm, profile.noise_at(3.4).sigma_mm)


def test_sensor_is_at_the_profiles_time(profile: CompleteCamera) -> None:
    sensor = replace(profile, integration_time_ms=1.2).sensor()
    assert sensor.integration_time_ms == 1.2
    assert sensor.noise is not None
    np.testing.assert_allclose(sensor.noise.sigma_mm, profile.noise_at(1.2).sigma_mm)
    for key in ("name", "modulation_frequency_hz", "range_min_mm", "range_max_mm", "fov_horizontal_deg"):
        assert getattr(sensor, key) == getattr(profile, key)


@pytest.mark.parametrize("tau", [0.0, -1.0, float("nan"), float("inf")])
def test_noise_at_an_invalid_time_is_refused(profile: CompleteCamera, tau: float) -> None:
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
def test_values_out_of_bounds_are_refused(profile: CompleteCamera, change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(change))}: "):
        replace(profile, **change)
