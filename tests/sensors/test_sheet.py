"""A camera of which not all is known."""

import math

import numpy as np
import pytest

from tofmix.sensor import NoiseCurve
from tofmix.sensors import CameraSheet, load_profile, load_sheet
from tofmix.sensors.sheet import UNKNOWN

CURVE = NoiseCurve(np.array([1000.0]), np.array([8.0]))


def test_complete_sheet_equals_its_profile() -> None:
    sheet, profile = load_sheet("sr3000"), load_profile("sr3000")
    assert sheet.missing() == ()
    for key in ("rows", "cols", "fov_horizontal_deg", "range_max_mm", "exponent", "outlier_probability"):
        assert getattr(sheet, key) == getattr(profile, key)
    mine, theirs = sheet.sensor().noise, profile.sensor().noise
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
    law = CameraSheet(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.5)
    assert law.sensor().noise is None
    constant = CameraSheet(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.0)
    assert constant.sensor().noise is CURVE
    timed = CameraSheet(
        name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.5, integration_time_ms=2.5
    )
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
    ],
)
def test_invalid_sensor_values_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change)).split("_")[0]):
        CameraSheet(name="a", **change)  # type: ignore[arg-type]
