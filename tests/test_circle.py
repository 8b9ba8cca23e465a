"""The circle of ranges: folding, sigma on it, and whether c_0 can be told."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.circle import circular_noise, cut_between, fold, has_no_return, open_at
from tofmix.sensor import NoiseCurve, Sensor

LENGTH = 7495.0


@given(value=st.floats(-1e6, 1e6), turns=st.integers(-3, 3))
def test_folding_takes_out_whole_turns(*, value: float, turns: int) -> None:
    folded = float(fold(value + turns * LENGTH, LENGTH))
    assert 0 <= folded < LENGTH
    away = abs(folded - float(fold(value, LENGTH)))
    assert min(away, LENGTH - away) < 1e-6


def test_fold_keeps_invalid_values_and_zero() -> None:
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
def test_no_return_is_separate_if_two_sigma_of_it_lie_before_the_fold(
    length: float, told: bool, sensor: Sensor
) -> None:
    assert has_no_return(sensor, length) is told  # range_max 6000, sigma 200 there
    assert not has_no_return(replace(sensor, range_max_mm=None), length)


@given(
    st.lists(st.floats(0.0, 4999.0), min_size=1, max_size=5, unique=True).map(sorted),
    st.floats(1.0, 200.0),
    st.floats(0.0, 4999.0),
)
def test_cut_keeps_surfaces_across_the_fold_in_one_piece(places: list[float], sigma: float, turn: float) -> None:
    range_mm = np.sort((np.array(places) + turn) % 5000.0)
    cut = cut_between(range_mm, np.full(len(places), sigma), 5000.0)
    opened = open_at(range_mm, cut, 5000.0)
    assert np.all((opened >= cut) & (opened < cut + 5000.0))
    np.testing.assert_allclose(opened % 5000.0, range_mm, atol=1e-9)
    past, before = range_mm < 4 * sigma, range_mm > 5000.0 - 4 * sigma
    if not np.any(past | before):
        assert cut == 0.0
    elif not np.all(past):  # surfaces past the fold follow all others, and half a gap lies behind the last
        assert opened[past].min(initial=np.inf) > opened[~past].max()
        last = opened[past].max(initial=opened[~past].max())
        first = opened[opened < last].min(initial=last)
        assert cut + 5000.0 - last == pytest.approx(first - cut, abs=1e-6)


def test_surfaces_that_are_not_known_leave_the_circle_cut_at_the_fold() -> None:
    assert cut_between([np.nan, 30.0], [20.0, np.nan], 5000.0) == 0.0
    assert cut_between([], [], 5000.0) == 0.0
