"""Noise curves and sensors: interpolation, and every refusal."""

from typing import Any

import numpy as np
import pytest

from tofmix.sensor import NoiseCurve, Sensor


def test_sigma_is_linear_between_points_and_constant_past_the_ends() -> None:
    curve = NoiseCurve(np.array([1000.0, 2000.0]), np.array([10.0, 30.0]))
    np.testing.assert_allclose(curve.sigma(np.array([0.0, 1000.0, 1250.0, 2000.0, 9000.0])), [10, 10, 15, 30, 30])
    np.testing.assert_allclose(curve.scaled(2.0).sigma(1500.0), 40)


def test_curve_is_a_read_only_copy_of_its_arrays() -> None:
    sigma = np.array([10.0, 30.0])
    curve = NoiseCurve(np.array([1000.0, 2000.0]), sigma)
    sigma[0] = -1
    assert curve.sigma_mm[0] == 10
    with pytest.raises(ValueError, match="read-only"):
        curve.sigma_mm[0] = 1


@pytest.mark.parametrize(
    ("range_mm", "sigma_mm", "reason"),
    [
        ([], [], "two lists"),
        ([1.0, 2.0], [1.0], "two lists"),
        ([1.0, np.nan], [1.0, 1.0], "not finite"),
        ([2.0, 1.0], [1.0, 1.0], "ascend"),
        ([1.0, 1.0], [1.0, 1.0], "ascend"),
        ([1.0, 2.0], [1.0, -3.0], "sigma is -3 mm at 2 mm"),
        ([1.0, 2.0], [0.0, 1.0], "sigma is 0 mm at 1 mm"),
        ([1.0, 2.0], [1.0, np.inf], "sigma is inf mm"),
        ([1.0, 2.0], [np.nan, 1.0], "sigma is nan mm"),
    ],
)
def test_unfit_curves_are_refused(range_mm: list[float], sigma_mm: list[float], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        NoiseCurve(np.array(range_mm), np.array(sigma_mm))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("modulation_frequency_hz", 0.0),
        ("modulation_frequency_hz", 1e300),
        ("modulation_frequency_hz", 1e-300),
        ("integration_time_ms", -1.0),
        ("range_max_mm", np.inf),
        ("fov_vertical_deg", np.nan),
        ("range_min_mm", np.nan),
        ("range_min_mm", 9000.0),
        ("outlier_probability", 1.0),
        ("outlier_probability", -0.1),
        ("outlier_probability", np.nan),
    ],
)
def test_unfit_sensors_are_refused(key: str, value: float) -> None:
    settings: dict[str, Any] = {"name": "x", "range_max_mm": 5000.0, key: value}
    with pytest.raises(ValueError, match=key):
        Sensor(**settings)


@pytest.mark.parametrize(
    ("known", "lock_in"),
    [
        ({}, None),
        ({"measurement": "lock-in"}, True),
        ({"measurement": "pulses"}, False),
        ({"measurement": "stereo"}, False),
        ({"modulation_frequency_hz": 47.5e6}, True),
        ({"measurement": "stereo", "modulation_frequency_hz": 47.5e6}, True),
    ],
)
def test_a_camera_is_lock_in_by_its_measurement_or_by_a_frequency(known: dict[str, Any], lock_in: bool | None) -> None:
    assert Sensor(name="camera", **known).is_lock_in is lock_in


def test_an_unknown_measurement_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match='measurement: "phase" is not one of lock-in, pulses, stereo'):
        Sensor(name="camera", measurement="phase")  # type: ignore[arg-type]  # a text of a user
