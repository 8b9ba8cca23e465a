"""EM on equation (1): its fixed points, its acceleration, its gradient, and standard errors."""

import numpy as np
import pytest
from numpy.typing import NDArray
from support import naive
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.mixture.em import (
    FREE_SIGMA_FLOOR,
    MEAN,
    SIGMA,
    TOTAL,
    WEIGHT,
    em_step,
    expectation_maximisation,
    fit_mixture,
    log_likelihood,
    maximise_likelihood,
    new_components,
    new_scratch,
    start_at,
)
from tofmix.estimation.mixture.gain_bound import best_share, steepest_place
from tofmix.estimation.samples import readings_of
from tofmix.estimation.settings import MODE_FREE, MODE_PRIOR, MODE_TIED, EstimateOptions, SigmaMode
from tofmix.sensor import Sensor


def _pixel(rng: np.random.Generator, sensor: Sensor, n: int = 200) -> naive.Array:
    return draw(rng, sensor, ranges_mm=[1000, 2000], shares=[0.3, 0.5], n=n, pixels=1)[:, 0].astype(np.float64)


@pytest.mark.parametrize("mode", list(SigmaMode))
def test_em_equals_its_naive_twin(mode: SigmaMode, rng: np.random.Generator, sensor: Sensor) -> None:
    samples, start = _pixel(rng, sensor), np.array([1100.0, 1900.0])
    for iterations in (1, 2, 10):
        options = EstimateOptions(sigma=mode, max_iter=iterations, tol=1e-12)
        fit = fit_mixture(samples, start, sensor, options)
        mean, sigma, weight, no_return = naive.em(samples, start, sensor, mode=mode, iterations=iterations)
        np.testing.assert_allclose(fit.mean_mm, mean, rtol=1e-9)
        np.testing.assert_allclose(fit.sigma_mm, sigma, rtol=1e-9)
        np.testing.assert_allclose(fit.weight, weight, rtol=1e-9)
        assert fit.weight_no_return == pytest.approx(no_return, rel=1e-9)
        expected = np.log(naive.mixture_density(samples, mean, sigma, weight, no_return, sensor)).sum()
        assert fit.log_likelihood == pytest.approx(expected, rel=1e-9)


def test_likelihood_never_falls_with_free_sigmas(rng: np.random.Generator, sensor: Sensor) -> None:
    # A theorem of EM; it holds for the paper's form, where nothing is tied.
    samples = _pixel(rng, sensor)
    values = [
        fit_mixture(samples, [1200.0, 2300.0], sensor, EstimateOptions(sigma=SigmaMode.FREE, max_iter=n, tol=1e-15))
        for n in range(1, 30)
    ]
    assert np.all(np.diff([fit.log_likelihood for fit in values]) > -1e-9)


def test_a_weak_component_runs_away_only_when_free(rng: np.random.Generator, sensor: Sensor) -> None:
    # The paper's sigma_1 = 1252 mm: a weak component between two strong ones, fed by outliers.
    assert sensor.noise is not None
    strong = draw(rng, sensor, ranges_mm=[2500, 4500], shares=[0.45, 0.55], n=92, pixels=1)[:, 0]
    weak = np.array([600, 900, 1300, 1500, 1700, 3200, 3400, 3600])
    samples = np.concatenate([strong, weak])
    start = [1400.0, 2500.0, 4500.0]
    ratio = {}
    for mode in SigmaMode:
        fit = fit_mixture(samples, start, sensor, EstimateOptions(sigma=mode))
        ratio[mode] = (fit.sigma_mm / sensor.noise.sigma(fit.mean_mm)).max()
    assert ratio[SigmaMode.FREE] > 5
    assert ratio[SigmaMode.PRIOR] < 2
    assert ratio[SigmaMode.TIED] == pytest.approx(1, abs=1e-9)


def test_a_free_sigma_does_not_shrink_onto_one_sample(sensor: Sensor) -> None:
    assert sensor.noise is not None
    fit = fit_mixture([1000.0, 1010.0, 990.0, 5000.0], [1000.0, 5000.0], sensor, EstimateOptions(sigma=SigmaMode.FREE))
    assert np.all(fit.sigma_mm >= FREE_SIGMA_FLOOR * sensor.noise.sigma(fit.mean_mm) * (1 - 1e-12))


@pytest.mark.parametrize(("samples", "start"), [([], [1.0]), ([np.nan], [1.0]), ([1.0], [np.inf])])
def test_fit_refuses_means_that_are_not_finite(samples: list[float], start: list[float], sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="finite"):
        fit_mixture(samples, start, sensor)


@pytest.mark.slow
@pytest.mark.parametrize("mode", [MODE_TIED, MODE_PRIOR, MODE_FREE])
def test_acceleration_converges_to_the_likelihood_of_em(mode: int, rng: np.random.Generator, sensor: Sensor) -> None:
    beam = beam_of(sensor)
    block = draw(rng, sensor, ranges_mm=[1500, 1560, 3500], shares=[0.4, 0.3, 0.2], n=150, pixels=sized(40, 4))
    sooner = []
    scratch = new_scratch(3, len(block))
    for column in block.T:
        samples = readings_of(column)
        fast, slow = new_components(3), new_components(3)
        for fit in (fast, slow):
            start_at(np.array([1480.0, 1580.0, 3500.0]), np.ones(3), 3, 0.1, fit, beam)
        n_fast = maximise_likelihood(samples, 3, fast, beam, mode, 2000, 1e-6, scratch)
        n_slow = expectation_maximisation(samples, 3, slow, beam, mode, 20000, 1e-9, scratch)
        assert n_fast > 0
        if mode != MODE_PRIOR:  # there EM climbs likelihood and prior together
            assert (
                log_likelihood(samples, 3, fast, beam, scratch) > log_likelihood(samples, 3, slow, beam, scratch) - 1e-3
            )
        before = fast[MEAN].copy()
        em_step(samples, 3, fast, beam, mode, scratch)
        np.testing.assert_allclose(fast[MEAN], before, atol=1e-3)
        sooner.append(n_fast < abs(n_slow))
    assert np.mean(sooner) > sized(0.9, 0.7)


@pytest.mark.slow
def test_acceleration_returns_negative_iterations_without_convergence(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = readings_of(draw(rng, sensor, ranges_mm=[1500, 1540], shares=[0.5, 0.5], n=100, pixels=1))
    fit = new_components(2)
    start_at(np.array([1400.0, 1700.0]), np.ones(2), 2, 0.0, fit, beam_of(sensor))
    assert maximise_likelihood(samples, 2, fit, beam_of(sensor), MODE_TIED, 4, 1e-12, new_scratch(2, 100)) < 0


@pytest.mark.slow
def test_no_second_surface_gains_more_than_the_steepest_slope(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    beam = beam_of(sensor)
    block = draw(rng, sensor, ranges_mm=[1500, 1530], shares=[0.7, 0.3], n=50, pixels=sized(20, 6))
    for column in np.sort(block, axis=0).T:
        samples, data = column.astype(np.float64), readings_of(column)
        fit, scratch = new_components(1), new_scratch(1, len(column))
        fit[MEAN, 0], fit[SIGMA, 0], fit[WEIGHT, 0] = samples.mean(), 25.0, 1 - beam.p_outlier
        expectation_maximisation(data, 1, fit, beam, MODE_TIED, 200, 1e-9, scratch)
        slope, place, _ = steepest_place(data, 1, fit, beam, scratch, 0.0)
        mean, sigma, weight = (fit[row, :1] for row in (MEAN, SIGMA, WEIGHT))
        one = naive.mixture_density(samples, mean, sigma, weight, 0.0, sensor)
        np.testing.assert_allclose(scratch[TOTAL], one, rtol=1e-9)

        # The slope is that of the likelihood as share moves there.
        def moved(share: float, place: float = place, one: naive.Array = one, samples: naive.Array = samples) -> float:
            assert sensor.noise is not None
            sigma = sensor.noise.sigma(np.array([place]))
            new = naive.mixture_density(samples, np.array([place]), sigma, np.array([1 - 1e-4]), 0.0, sensor)
            return float(np.log((1 - share) * one + share * new).sum())

        assert np.isclose((moved(1e-7) - moved(0)) / 1e-7, slope, rtol=1e-3, atol=0.05)
        two = naive.em(samples, np.array([samples.min(), samples.max()]), sensor, mode="tied", iterations=300)
        gain = np.log(naive.mixture_density(samples, *two, sensor)).sum() - np.log(one).sum()
        assert gain < slope + 0.1
        # and the best share is where it peaks
        best = best_share(data, place, beam, scratch)
        assert moved(best) >= max(moved(0.8 * best), moved(min(1.2 * best, 0.95))) - 1e-3 or slope < 0


TIED = EstimateOptions(sigma=SigmaMode.TIED, tol=1e-9, max_iter=2000)


def _numeric_hessian(samples: naive.Array, point: naive.Array, *args: object) -> NDArray[np.float64]:
    size = len(point)
    step = np.where(np.arange(size) < args[0], 1e-2, 1e-5)  # type: ignore[operator]  # args[0] is k
    hessian = np.zeros((size, size))
    for a in range(size):
        for b in range(size):
            for sign_a in (-1, 1):
                for sign_b in (-1, 1):
                    shift = np.zeros(size)
                    shift[a] += sign_a * step[a]
                    shift[b] += sign_b * step[b]
                    value = naive.log_likelihood(samples, point + shift, *args)  # type: ignore[arg-type]
                    hessian[a, b] += sign_a * sign_b * value / (4 * step[a] * step[b])
    return hessian


@pytest.mark.parametrize(
    ("ranges", "shares"), [([1500, 1580], [0.4, 0.6]), ([1500, 1600, 3000], [0.3, 0.3, 0.4]), ([2000], [0.6])]
)
def test_errors_equal_the_inverse_numeric_hessian(
    ranges: list[float], shares: list[float], rng: np.random.Generator, sensor: Sensor
) -> None:
    samples = draw(rng, sensor, ranges_mm=ranges, shares=shares, n=400, pixels=1)
    layers = layer_pixels(samples, sensor, TIED)
    k = int(layers.n_modes[0])
    assert k == len(ranges)
    with_no_return = layers.weight_no_return[0] * 400 > 0.5
    weights = [*layers.weight[0, :k], layers.weight_no_return[0]][: k + with_no_return]
    point = np.array([*layers.range[0, :k], *weights[:-1]], dtype=np.float64)
    sigma = layers.sigma[0, :k].astype(np.float64)
    hessian = _numeric_hessian(samples[:, 0].astype(np.float64), point, k, sigma, with_no_return, sensor)
    expected = np.sqrt(np.diag(np.linalg.inv(-hessian)))[:k]
    np.testing.assert_allclose(layers.range_stderr[0, :k], expected, rtol=5e-3)


@pytest.mark.compiled("a frequency over 4000 pixels")
def test_errors_cover_the_truth(rng: np.random.Generator, sensor: Sensor) -> None:
    truth = [1500.0, 1640.0, 3500.0]
    layers = layer_pixels(draw(rng, sensor, ranges_mm=truth, shares=[0.3, 0.3, 0.4], n=100, pixels=4000), sensor)
    right = layers.n_modes == 3
    assert right.mean() > 0.98
    z = (layers.range[right, :3] - truth) / layers.range_stderr[right, :3]
    cover = (np.abs(z) < 1.96).mean(axis=0)
    assert np.all((cover > 0.925) & (cover < 0.975))


@pytest.mark.compiled("a frequency over 4000 pixels")
def test_shares_have_errors_that_cover_the_truth(rng: np.random.Generator, sensor: Sensor) -> None:
    shares = [0.25, 0.35, 0.4]
    samples = draw(rng, sensor, ranges_mm=[1500, 1640, 3500], shares=shares, n=100, pixels=4000)
    layers = layer_pixels(samples, sensor)
    right = layers.n_modes == 3
    z = (layers.weight[right, :3] - shares) / layers.weight_stderr[right, :3]
    cover = (np.abs(z) < 1.96).mean(axis=0)
    assert np.all((cover > 0.925) & (cover < 0.975))


def test_share_without_a_competitor_has_no_error(rng: np.random.Generator, sensor: Sensor) -> None:
    layers = layer_pixels(draw(rng, sensor, ranges_mm=[1500], shares=[1], n=64, pixels=20), sensor)
    assert not layers.weight_stderr[layers.n_modes == 1, 0].any()
