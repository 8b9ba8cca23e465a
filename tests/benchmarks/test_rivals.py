"""The rival forward models against closed forms, SciPy and the naive EM."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.rivals import ForwardModel, fit_decaying_shares, fit_thin_beam
from scipy.integrate import trapezoid
from scipy.optimize import minimize_scalar
from scipy.stats import norm
from support import naive
from support.drawing import draw

from tofmix.sensor import NoiseCurve, Sensor

pytestmark = pytest.mark.slow  # of the benchmarks alone

FLAT = NoiseCurve(np.array([0.0]), np.array([20.0]))


def pixel(rng: np.random.Generator, sensor: Sensor, ranges: list[float], shares: list[float], n: int) -> naive.Array:
    samples = draw(rng, sensor, ranges_mm=ranges, shares=shares, n=n, pixels=1)
    return samples[:, 0].astype(np.float64)


def sum_of_logs(samples: naive.Array, model: ForwardModel) -> float:
    """log_likelihood in SciPy's densities."""
    mean, sigma, weight = model.mean_mm, model.sigma_mm, model.weight
    sensor = replace(model.sensor, outlier_probability=model.weight_outlier)
    return float(np.log(naive.mixture_density(samples, mean, sigma, weight, model.weight_no_return, sensor)).sum())


def test_one_surface_is_the_mean_of_its_samples(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = pixel(rng, sensor, [2000.0], [1.0], 60)
    fit = fit_thin_beam(samples, replace(sensor, outlier_probability=1e-9))
    assert fit.converged
    assert fit.mean_mm[0] == pytest.approx(samples.mean(), abs=1e-3)
    assert fit.weight[0] == pytest.approx(1, abs=1e-6)
    assert fit.weight_no_return == pytest.approx(0, abs=1e-6)


def test_shares_of_events_far_apart_are_their_counts(rng: np.random.Generator, sensor: Sensor) -> None:
    parts = rng.normal(1500.0, 20.0, 60), rng.normal(6000.0, 20.0, 30), np.linspace(2500.0, 4500.0, 10)
    fit = fit_thin_beam(np.concatenate(parts), replace(sensor, noise=FLAT), free_outliers=True)
    # c_r is spread over all of the range, so it takes a little of the surface and of c_0.
    found = [fit.weight[0], fit.weight_no_return, fit.weight_outlier]
    np.testing.assert_allclose(found, [0.6, 0.3, 0.1], atol=0.01)
    assert sum(found) == pytest.approx(1, abs=1e-12)


def test_thin_beam_equals_the_naive_em_of_one_surface(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = pixel(rng, sensor, [1400.0], [0.8], 80)
    fit = fit_thin_beam(samples, sensor)
    mean, sigma, weight, no_return = naive.em(samples, np.array([1500.0]), sensor, mode="tied", iterations=200)
    np.testing.assert_allclose([*fit.mean_mm, *fit.sigma_mm, *fit.weight], [*mean, *sigma, *weight], rtol=1e-6)
    assert fit.weight_no_return == pytest.approx(no_return, abs=1e-6)


def test_thin_beam_takes_the_heavier_of_two_surfaces_and_no_average(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = np.concatenate([rng.normal(1000.0, 20.0, 30), rng.normal(2000.0, 20.0, 70)])
    fit = fit_thin_beam(samples, replace(sensor, noise=FLAT))
    assert fit.mean_mm[0] == pytest.approx(samples[30:].mean(), abs=0.01)
    free = fit_thin_beam(samples, replace(sensor, noise=FLAT), free_outliers=True)
    assert free.weight_outlier == pytest.approx(0.3, abs=0.01)
    assert free.log_likelihood(samples) > fit.log_likelihood(samples) + 100


def test_thin_beam_finds_the_highest_likelihood(rng: np.random.Generator, sensor: Sensor) -> None:
    flat = replace(sensor, noise=FLAT)
    samples = np.concatenate([rng.normal(1000.0, 20.0, 40), rng.normal(1050.0, 20.0, 60), rng.uniform(300, 6000, 4)])
    fit = fit_thin_beam(samples, flat, free_outliers=True)

    def loss(mean: float) -> float:
        return -replace(fit, mean_mm=np.array([mean])).log_likelihood(samples)

    best = min(minimize_scalar(loss, bounds=(low, low + 100), method="bounded").fun for low in range(300, 6000, 100))
    assert -fit.log_likelihood(samples) == pytest.approx(best, abs=1e-4)


@pytest.mark.parametrize("ratio", [0.2, 0.5, 1.0])
def test_decaying_shares_have_their_ratio_and_the_means_of_their_samples(
    rng: np.random.Generator, sensor: Sensor, ratio: float
) -> None:
    groups = [rng.normal(mean, 20.0, n) for mean, n in ((1000.0, 10), (2000.0, 30), (3000.0, 60))]
    samples = np.concatenate(groups)
    fit = fit_decaying_shares(samples, [3010.0, 990.0, 2010.0], replace(sensor, noise=FLAT), ratio=ratio)
    assert fit.converged
    np.testing.assert_allclose(fit.mean_mm, [group.mean() for group in groups], atol=1e-3)
    np.testing.assert_allclose(fit.weight[1:] / fit.weight[:-1], ratio)
    assert fit.weight.sum() == pytest.approx(1 - sensor.outlier_probability, abs=1e-9)


def test_no_return_share_is_a_count_with_decaying_shares(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = np.concatenate([rng.normal(1000.0, 20.0, 80), rng.normal(6000.0, 20.0, 20)])
    fit = fit_decaying_shares(samples, [1000.0], replace(sensor, noise=FLAT), ratio=0.5)
    assert fit.weight_no_return == pytest.approx(0.2, abs=1e-3)


def test_one_decaying_share_is_a_thin_beam(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = pixel(rng, sensor, [1800.0], [0.7], 50)
    one, thin = fit_decaying_shares(samples, [1800.0], sensor, ratio=0.3), fit_thin_beam(samples, sensor)
    assert one.mean_mm[0] == pytest.approx(thin.mean_mm[0], abs=1e-3)
    assert one.log_likelihood(samples) == pytest.approx(thin.log_likelihood(samples), abs=1e-6)


def test_likelihood_is_that_of_other_samples_and_integrates_to_one(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = pixel(rng, sensor, [1200.0, 2500.0], [0.5, 0.4], 60)
    for fit in (fit_thin_beam(samples, sensor), fit_decaying_shares(samples, [1200.0, 2500.0], sensor, ratio=0.6)):
        others = np.append(pixel(rng, sensor, [1200.0, 2500.0], [0.5, 0.4], 40), 400.0)
        assert fit.log_likelihood(np.append(others, np.nan)) == pytest.approx(sum_of_logs(others, fit), rel=1e-12)
        surfaces = replace(fit, weight_outlier=0.0)
        grid = np.arange(200.0, 8000.0, 2.0)
        density = np.exp([surfaces.log_likelihood([r]) for r in grid])
        assert trapezoid(density, grid) == pytest.approx(1 - sensor.outlier_probability, abs=1e-6)


def test_a_fit_without_surfaces_has_a_likelihood(sensor: Sensor) -> None:
    none = np.empty(0)
    model = ForwardModel(
        mean_mm=none, sigma_mm=none, weight=none, weight_no_return=1.0, weight_outlier=0.0, sensor=sensor
    )
    assert model.log_likelihood([6000.0]) == pytest.approx(norm.logpdf(6000.0, 6000.0, 200.0))


@pytest.mark.parametrize("ratio", [0.0, 1.1, np.nan])
def test_a_ratio_out_of_its_bounds_is_refused(sensor: Sensor, ratio: float) -> None:
    with pytest.raises(ValueError, match="ratio: "):
        fit_decaying_shares([1000.0], [1000.0], sensor, ratio=ratio)


def test_missing_values_are_refused(sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="none is finite"):
        fit_thin_beam([np.nan], sensor)
    with pytest.raises(ValueError, match="starting means"):
        fit_decaying_shares([1000.0], [], sensor, ratio=0.5)
    with pytest.raises(ValueError, match="no noise curve"):
        fit_thin_beam([1000.0], replace(sensor, noise=None))
