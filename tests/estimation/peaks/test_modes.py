"""Test (5) against a fine-grid twin, and its promises."""

import numpy as np
import pytest
from support import naive
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.peaks.modes import find_modes
from tofmix.sensor import NoiseCurve, Sensor

STRICT = 1e-9


@pytest.mark.parametrize("n", [5, 15, pytest.param(100, marks=pytest.mark.slow)])
def test_modes_equal_the_fine_grid_twin(n: int, rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    differing = 0
    for column in draw(rng, sensor, ranges_mm=[1200, 2000, 4000], shares=[0.2, 0.3, 0.5], n=n, pixels=sized(30, 15)).T:
        samples = column.astype(np.float64)
        expected = naive.peaks(samples, sensor.noise, gamma=0.02, step=0.02)
        found = find_modes(samples, sensor.noise, epsilon=STRICT)
        if len(found) == len(expected):
            assert np.all(np.abs(found - expected) < 0.1 * sensor.noise.sigma(expected))
        else:
            differing += 1
    # Two maxima closer than a step of the walk, or a height within rounding of gamma.
    assert differing <= 1


def test_one_lone_sample_is_no_peak(sensor: Sensor) -> None:
    assert sensor.noise is not None
    samples = [1000.0] * 10 + [4000.0]
    assert find_modes(samples, sensor.noise, epsilon=STRICT) == pytest.approx([1000.0], abs=0.1)


def test_gamma_is_the_least_share_of_a_surface(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    samples = draw(rng, sensor, ranges_mm=[1000, 3000], shares=[0.9, 0.1], n=sized(5000, 1000), pixels=1)
    for gamma, peaks in ((0.05, 2), (0.2, 1)):
        places = find_modes(samples, sensor.noise, gamma=gamma, epsilon=STRICT)
        clusters = {round(place / 1000) for place in places}
        assert len(clusters) == peaks


def test_a_large_epsilon_also_takes_a_shoulder() -> None:
    flat = NoiseCurve(np.array([0.0]), np.array([10.0]))
    # A tall and a low pile 1.3 sigma apart: one maximum with a shoulder.
    samples = np.concatenate([np.full(60, 1000.0), np.full(22, 1014.0)])
    assert len(find_modes(samples, flat, epsilon=1e-6)) == 1
    assert len(find_modes(samples, flat, epsilon=0.6)) == 2


def test_corners_of_a_noise_curve_make_no_peaks() -> None:
    range_mm = np.linspace(900, 1100, 41)
    jagged = NoiseCurve(range_mm, np.tile([20.0, 23.0], 21)[:41])
    samples = 1000 + 20 * np.linspace(-2, 2, 401)
    assert len(find_modes(samples, jagged, epsilon=STRICT)) == 1


def test_modes_survive_any_place_and_more_peaks_than_kept(sensor: Sensor) -> None:
    assert sensor.noise is not None
    samples = np.repeat(np.linspace(-1e6, 1e6, 100), 3)
    places = find_modes(samples, sensor.noise, epsilon=STRICT, most=20)
    assert len(places) == 20
    assert np.all(np.diff(places) > 0)
