"""Which surfaces stand: noise goes, weak surfaces stay, orphans are adopted."""

from dataclasses import replace

import numpy as np
import pytest
from drawing import draw

from tofmix.estimation.counting import CERTAIN_SIGMAS, CERTAIN_SUPPORT, MIN_GAIN_NATS
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions
from tofmix.sensor import NoiseCurve, Sensor


@pytest.mark.parametrize("n", [15, 30, 100, 300])
def test_one_surface_is_one(n: int, rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[2500], shares=[1.0], n=n, pixels=4000)
    layers = layer_pixels(samples, sensor)
    # Expected well below 0.25 %; the bound leaves three binomial standard deviations above it.
    assert np.mean(layers.n_modes != 1) < 0.005


@pytest.mark.parametrize(
    ("shares", "least"), [((0.3, 0.3, 0.4), 0.99), ((0.1, 0.3, 0.6), 0.99), ((0.05, 0.15, 0.8), 0.94)]
)
def test_three_surfaces_are_three(
    shares: tuple[float, ...], least: float, rng: np.random.Generator, sensor: Sensor
) -> None:
    samples = draw(rng, sensor, ranges_mm=[1000, 2200, 4000], shares=shares, n=100, pixels=1000)
    # At a share of 0.05, P(fewer than 2 of 100 samples) = 0.037.
    assert np.mean(layer_pixels(samples, sensor).n_modes == 3) > least


def test_no_layer_rests_on_a_single_sample(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[1500], shares=[1.0], n=60, pixels=500)
    samples[0] = 4000
    assert np.all(layer_pixels(samples, sensor).n_modes == 1)


def test_scattered_samples_of_a_weak_surface_are_gathered(sensor: Sensor) -> None:
    # Three samples too far apart to pile up into a peak, in one spread of sigma: a surface, not three outliers.
    assert sensor.noise is not None
    sigma = float(sensor.noise.sigma(1000.0))
    samples = np.concatenate([np.full(30, 4000.0), 1000 + sigma * np.array([-1.3, 0.0, 1.3])])
    layers = layer_pixels(samples[:, None], sensor)
    assert layers.n_peaks[0] == 1
    assert layers.n_modes[0] == 2
    assert layers.range[0, 0] == pytest.approx(1000, abs=1)


def test_more_outliers_than_expected_are_no_surfaces_when_the_sensor_says_so(rng: np.random.Generator) -> None:
    noise = NoiseCurve(np.array([0.0]), np.array([20.0]))
    camera = Sensor(name="wild", range_min_mm=0.0, range_max_mm=8000.0, outlier_probability=0.1, noise=noise)
    samples = draw(rng, camera, ranges_mm=[3000], shares=[1.0], n=100, pixels=2000, outliers=0.1)
    layers = layer_pixels(samples, camera)
    # About 2.5 %: ten outliers in one pixel sometimes fall together. Taken for 1e-4, they would in most pixels.
    assert np.mean(layers.n_modes != 1) < 0.04
    unaware = layer_pixels(samples, replace(camera, outlier_probability=1e-4))
    assert np.mean(unaware.n_modes != 1) > 0.2


def test_a_certain_surface_would_be_missed_by_far_more_than_the_least_gain() -> None:
    # Each sample at z sigma from all else costs z^2 / 2 nats, less ln of the shares' ratio.
    assert CERTAIN_SUPPORT * CERTAIN_SIGMAS**2 / 2 > 10 * MIN_GAIN_NATS


def test_the_weakest_surfaces_give_way_to_max_layers(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[800, 1800, 3600], shares=[0.5, 0.1, 0.4], n=200, pixels=50)
    layers = layer_pixels(samples, sensor, EstimateOptions(max_layers=2))
    assert np.all(layers.n_modes == 2)
    assert layers.range.shape == (50, 2)
    np.testing.assert_allclose(layers.range.mean(axis=0), [800, 3600], atol=60)
