"""Which surfaces stand: false alarms as often as asked for, the table of gains, and the quick look."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support import naive
from support.cameras import camera_of
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.mixture.counting import (
    CERTAIN_SIGMAS,
    CERTAIN_SUPPORT,
    FALSE_ALARMS,
    LEAST_BOUND,
    SAMPLES,
    Rules,
    Workspace,
    chance_of,
    gain_table,
    least_gain,
    new_workspace,
    try_one_more,
)
from tofmix.estimation.mixture.em import MEAN, SIGMA, WEIGHT, expectation_maximisation
from tofmix.estimation.mixture.gain_bound import gain_bound_of_clear
from tofmix.estimation.samples import Readings, readings_of
from tofmix.estimation.settings import MODE_TIED, EstimateOptions, Refine
from tofmix.sensor import NoiseCurve, Sensor


@pytest.mark.compiled("a frequency over 8000 pixels")
@pytest.mark.parametrize("n", [15, 40, 100, 250])
@pytest.mark.parametrize("false_alarm", [0.05, 0.01])
def test_false_alarms_have_the_requested_rate(
    n: int, false_alarm: float, rng: np.random.Generator, sensor: Sensor
) -> None:
    pixels = 8000
    samples = draw(rng, sensor, ranges_mm=[2500], shares=[1.0], n=n, pixels=pixels, outliers=1e-4)
    found = layer_pixels(samples, sensor, EstimateOptions(false_alarm=false_alarm))
    alarms = np.mean(found.n_modes > 1)
    # Three binomial standard deviations, and a fifth for what the table's own draws leave open.
    margin = 3 * np.sqrt(false_alarm / pixels) + 0.2 * false_alarm
    assert abs(alarms - false_alarm) < margin


@pytest.mark.parametrize(
    ("shares", "least"), [((0.3, 0.3, 0.4), 0.99), ((0.1, 0.3, 0.6), 0.99), ((0.05, 0.15, 0.8), 0.94)]
)
def test_three_surfaces_are_three(
    shares: tuple[float, ...], least: float, rng: np.random.Generator, sensor: Sensor
) -> None:
    samples = draw(rng, sensor, ranges_mm=[1000, 2200, 4000], shares=shares, n=100, pixels=sized(1000, 30))
    # At a share of 0.05, P(fewer than 2 of 100 samples) = 0.037.
    assert np.mean(layer_pixels(samples, sensor).n_modes == 3) > sized(least, least - 0.1)


def _gain_by_brute_force(samples: naive.Array, sensor: Sensor) -> float:
    """Likelihood-ratio statistic of two surfaces against one: plain EM from the best of a grid, no code shared."""
    assert sensor.noise is not None
    one = naive.em(samples, np.array([samples.mean()]), sensor, mode="tied", iterations=200)
    sigma = float(sensor.noise.sigma(samples.mean()))
    places = np.arange(samples.min() - sigma / 2, samples.max() + sigma / 2, sigma / 5)
    density = np.exp(-0.5 * ((samples[:, None] - places) / sigma) ** 2)
    near, far = np.triu_indices(places.size, 1)
    best = np.full(near.size, -np.inf)
    for share in np.linspace(0.025, 0.975, 39):
        both = share * density[:, near] + (1 - share) * density[:, far]
        best = np.maximum(best, np.log(both).sum(axis=0))
    start = places[[near[best.argmax()], far[best.argmax()]]]
    two = naive.em(samples, start, sensor, mode="tied", iterations=400)
    gain: float = np.log(naive.mixture_density(samples, *two, sensor)).sum()
    return gain - float(np.log(naive.mixture_density(samples, *one, sensor)).sum())


@pytest.mark.slow
@pytest.mark.compiled("some of 30 pixels, and not all")
def test_close_surfaces_are_found_where_the_likelihood_ratio_finds_them(
    rng: np.random.Generator,
) -> None:
    noise = NoiseCurve(np.array([0.0]), np.array([50.0]))
    camera = Sensor(name="flat", range_min_mm=0.0, noise=NoiseCurve(np.array([9000.0]), noise.sigma_mm))
    samples = draw(
        rng, replace(camera, range_max_mm=9000.0), ranges_mm=[3000, 3090], shares=[0.4, 0.6], n=100, pixels=30
    )
    found = layer_pixels(samples, camera, EstimateOptions(false_alarm=0.01)).n_modes > 1
    least = gain_table(100)[100, 3]
    gains = np.array([_gain_by_brute_force(column.astype(np.float64), camera) for column in samples.T])
    # 1.8 sigma apart: some are found and some are not, and the same ones but for those on the edge.
    assert 0.3 < np.mean(gains > least) < 1
    assert np.all(found[gains > least + 0.3])
    assert not np.any(found[gains < least - 0.3])


def test_no_layer_rests_on_a_single_sample(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[1500], shares=[1.0], n=60, pixels=sized(500, 60))
    samples[0] = 4000
    assert np.mean(layer_pixels(samples, sensor).n_modes == 1) > 0.99


def test_scattered_samples_of_a_weak_surface_are_gathered(sensor: Sensor) -> None:
    # Three samples too far apart to pile up into a peak, in one spread of sigma: a surface, not three outliers.
    assert sensor.noise is not None
    sigma = float(sensor.noise.sigma(1000.0))
    samples = np.concatenate([np.full(30, 4000.0), 1000 + sigma * np.array([-1.3, 0.0, 1.3])])
    layers = layer_pixels(samples[:, None], sensor)
    assert layers.n_peaks[0] == 1
    assert layers.n_modes[0] == 2
    assert layers.range[0, 0] == pytest.approx(1000, abs=1)


@pytest.mark.slow
@pytest.mark.compiled("a frequency over 4000 pixels")
@pytest.mark.parametrize("share", [0.01, 0.1])
def test_outliers_that_fall_together_are_no_surfaces_when_the_sensor_expects_them(
    share: float, rng: np.random.Generator
) -> None:
    noise = NoiseCurve(np.array([0.0]), np.array([20.0]))
    camera = Sensor(name="wild", range_min_mm=0.0, range_max_mm=8000.0, outlier_probability=share, noise=noise)
    samples = draw(rng, camera, ranges_mm=[3000], shares=[1.0], n=100, pixels=6000, outliers=share)
    assert np.mean(layer_pixels(samples, camera).n_modes != 1) < 0.003
    unaware = layer_pixels(samples, replace(camera, outlier_probability=1e-5))
    assert np.mean(unaware.n_modes != 1) > 0.003


def test_gain_table_is_monotone_exact_at_its_columns_and_far_below_a_certain_surface() -> None:
    table = gain_table(2000)
    assert np.all(np.diff(table, axis=1) > 0)
    # Between 500 and 1000 samples the draws' own error is as large as the rise.
    assert np.all(np.diff(table[list(SAMPLES)], axis=0) > -0.3)
    np.testing.assert_array_equal(table[2000], table[1000])
    np.testing.assert_array_equal(table[0], table[5])
    row = gain_table(100)[100]
    for chance, gain in zip(FALSE_ALARMS, row, strict=True):
        assert least_gain(chance, row) == pytest.approx(gain)
    row = gain_table(50)[50]
    chances = [chance_of(gain, row) for gain in np.linspace(0, 30, 200)]
    assert chances[0] == 1
    assert np.all(np.diff(chances) <= 1e-12)
    assert chance_of(math.inf, row) == 0
    # Each sample at z sigma from all else costs z^2 / 2 nats, less ln of the shares' ratio.
    assert 5 * gain_table(1000).max() < CERTAIN_SUPPORT * CERTAIN_SIGMAS**2 / 2


def test_the_weakest_surfaces_give_way_to_max_layers(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[800, 1800, 3600], shares=[0.5, 0.1, 0.4], n=200, pixels=sized(50, 8))
    for refine in Refine:
        layers = layer_pixels(samples, sensor, EstimateOptions(max_layers=2, refine=refine))
        assert np.all(layers.n_modes == 2)
        assert layers.range.shape == (samples.shape[1], 2)
        np.testing.assert_allclose(layers.range.mean(axis=0), [800, 3600], atol=80)


def test_probability_is_higher_for_strong_layers(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[1500, 1570], shares=[0.5, 0.5], n=100, pixels=sized(300, 40))
    layers = layer_pixels(samples, sensor, EstimateOptions(false_alarm=0.05))
    found = layers.probability[np.isfinite(layers.probability)]
    assert np.all((found >= 0.94) & (found <= 1))
    assert np.any(found < 0.999)
    apart = draw(rng, sensor, ranges_mm=[1500, 4000], shares=[0.5, 0.5], n=100, pixels=sized(50, 5))
    assert np.nanmin(layer_pixels(apart, sensor).probability) > 1 - 1e-6


@pytest.mark.parametrize("outliers", [0.3, 1e-4])
def test_the_probability_of_an_isolated_surface_is_that_of_its_gain_over_outliers(outliers: float) -> None:
    sigma, span, frames = 20.0, 6000.0, 100
    camera = camera_of([1000.0], [sigma], reach_mm=(0.0, span), outlier_probability=outliers)
    rng = np.random.default_rng(5)
    samples = np.full((frames, 2), np.nan)
    samples[:, :] = 4000.0 + sigma * rng.standard_normal((frames, 2))
    samples[:9, 0] = 1000.0 + sigma * np.linspace(-1.5, 1.5, 9)
    spread = rng.uniform(1200.0, 3500.0, 30) if outliers > 0.1 else np.zeros(0)
    samples[10 : 10 + len(spread), :] = spread[:, None]
    found = layer_pixels(samples, camera, EstimateOptions(false_alarm=0.1))
    at = int(np.nanargmin(np.abs(found.range[0] - 1000.0)))
    assert abs(found.range[0, at] - 1000.0) < 2 * sigma
    # Without the surface its samples are random values, and all else grows by its share.
    weight, own = found.weight[0, at], samples[:9, 0]
    peak = weight * np.exp(-0.5 * ((own - own.mean()) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
    gain = np.sum(np.log1p(peak * span / outliers)) + (frames - 9) * np.log1p(-weight / (1.0 - outliers))
    assert gain > 15.0
    assert found.probability[0, at] == pytest.approx(1.0 - chance_of(gain, gain_table(frames)[frames]), abs=2e-6)
    weak = layer_pixels(np.where(np.arange(frames)[:, None] < 9, np.nan, samples), camera)
    assert weak.probability[0, 0] == 1.0  # a hundred samples: it rounds to 1


@pytest.mark.parametrize("n", [7, 15, 100, 777])
@pytest.mark.parametrize("chance", [0.1, 0.03, 0.001, 1e-5])
def test_chance_is_the_inverse_of_gain(n: int, chance: float) -> None:
    row = gain_table(1000)[n]
    assert chance_of(least_gain(chance, row), row) == pytest.approx(chance)


LEAST = 5.8
ALL = Rules(0.0, 1.0, 8, 0.0)


def _fitted(column: np.ndarray, start: list[float], sensor: Sensor) -> tuple[Readings, Beam, Workspace]:
    data, beam, work = readings_of(column), beam_of(sensor), new_workspace(8, len(column))
    k = len(start)
    work.fit[MEAN, :k], work.fit[SIGMA, :k], work.fit[WEIGHT, :k] = start, 20.0, (1 - beam.p_outlier) / k
    expectation_maximisation(data, k, work.fit, beam, MODE_TIED, 300, 1e-9, work.scratch)
    return data, beam, work


@pytest.mark.slow
def test_a_surface_that_gains_enough_has_a_bound_above_the_threshold(rng: np.random.Generator, sensor: Sensor) -> None:
    gaining, missed, quick = 0, 0, 0
    for shares, apart in (([0.5, 0.5], 45), ([0.9, 0.1], 80), ([0.97, 0.03], 120), ([1.0, 0.0], 0)):
        block = draw(rng, sensor, ranges_mm=[1500, 1500 + apart], shares=shares, n=100, pixels=sized(300, 15))
        for column in block.T:
            data, beam, work = _fitted(column, [float(column.mean())], sensor)
            bound = gain_bound_of_clear(data, 1, work.fit, beam, work.scratch, math.inf)
            quick += bound < LEAST_BOUND * LEAST
            gain = try_one_more(data, 1, work, beam, ALL)
            if gain >= LEAST:
                gaining += 1
                missed += bound < LEAST_BOUND * LEAST
    assert gaining > sized(400, 18)
    assert missed <= 1
    assert quick > sized(200, 8)  # it does turn pixels away


@pytest.mark.slow
def test_gain_bound_is_infinite_where_surfaces_overlap(rng: np.random.Generator, sensor: Sensor) -> None:
    near = draw(rng, sensor, ranges_mm=[1500, 1560], shares=[0.5, 0.5], n=100, pixels=1)[:, 0]
    data, beam, work = _fitted(near, [1490.0, 1570.0], sensor)
    assert gain_bound_of_clear(data, 2, work.fit, beam, work.scratch, math.inf) == math.inf
    away = np.append(draw(rng, sensor, ranges_mm=[1500], shares=[1.0], n=99, pixels=1)[:, 0], 3000.0)
    data, beam, work = _fitted(away, [1500.0], sensor)
    assert gain_bound_of_clear(data, 1, work.fit, beam, work.scratch, math.inf) == math.inf
