"""The circle of ranges: folding, sigma on it, and whether c_0 can be told."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.circle import circular_noise, fold, has_no_return
from tofmix.sensor import NoiseCurve, Sensor

LENGTH = 7495.0


@given(value=st.floats(-1e6, 1e6), turns=st.integers(-3, 3))
def test_folding_takes_out_whole_turns(*, value: float, turns: int) -> None:
    folded = float(fold(value + turns * LENGTH, LENGTH))
    assert 0 <= folded < LENGTH
    away = abs(folded - float(fold(value, LENGTH)))
    assert min(away, LENGTH - away) < 1e-6


def test_what_is_not_finite_stays_invalid_and_zero_stays_a_range() -> None:
    np.testing.assert_array_equal(
        fold([np.nan, np.inf, -np.inf, 0.0, -1e-20, LENGTH], LENGTH), [np.nan] * 3 + [0.0] * 3
    )


def test_sigma_is_the_files_outside_the_zone_after_the_fold(sensor: Sensor) -> None:
    assert sensor.noise is not None
    circle = circular_noise(sensor, 5000.0)
    top = float(sensor.noise.sigma(5000.0))
    zone = 4 * top
    at = np.linspace(zone, 5000.0, 50)
    for turn in range(-1, 3):
        np.testing.assert_allclose(circle.sigma(at + turn * 5000.0), sensor.noise.sigma(at), rtol=1e-12)
        # The same on both sides of the fold, over half of what the camera does not see; then linear to the zone's end.
        np.testing.assert_allclose(circle.sigma(turn * 5000.0 + np.array([0.0, 100.0, 200.0])), top)
        middle = float(circle.sigma(turn * 5000.0 + (200.0 + zone) / 2))
        assert middle == pytest.approx((top + float(sensor.noise.sigma(zone))) / 2)


@pytest.mark.parametrize(("range_min", "first", "zone"), [(900.0, 400.0, 900.0), (None, 1100.0, 1100.0)])
def test_the_zone_reaches_to_where_the_camera_begins_to_see(range_min: float | None, first: float, zone: float) -> None:
    noise = NoiseCurve(np.array([first, 5000.0]), np.array([5.0, 50.0]))
    circle = circular_noise(Sensor(name="x", range_min_mm=range_min, noise=noise), 5000.0)
    assert circle.sigma(zone) == pytest.approx(float(noise.sigma(zone)))
    assert circle.sigma(0.9 * zone) > circle.sigma(zone)


def test_a_circle_too_short_for_the_noise_is_refused(sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="shorter than 10 sigma"):
        circular_noise(sensor, 100.0)
    with pytest.raises(ValueError, match="no noise curve"):
        circular_noise(replace(sensor, noise=None), 5000.0)


@pytest.mark.parametrize(("length", "told"), [(6401.0, True), (6399.0, False), (5900.0, False)])
def test_no_return_is_told_where_two_sigma_of_it_stay_before_the_fold(
    length: float, told: bool, sensor: Sensor
) -> None:
    assert has_no_return(sensor, length) is told  # range_max 6000, sigma 200 there
    assert not has_no_return(replace(sensor, range_max_mm=None), length)
