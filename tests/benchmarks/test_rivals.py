"""Rival forward models against textbook EM, closed forms and SciPy."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.rivals import ForwardModel, fit_decaying_shares, fit_thin_beam
from scipy.integrate import trapezoid
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


def test_likelihood_is_that_of_other_samples_and_integrates_to_one(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = pixel(rng, sensor, [1200.0, 2500.0], [0.5, 0.4], 60)
    for fit in (fit_thin_beam(samples, sensor), fit_decaying_shares(samples, [1200.0, 2500.0], sensor, ratio=0.6)):
        others = np.append(pixel(rng, sensor, [1200.0, 2500.0], [0.5, 0.4], 40), 400.0)
        assert fit.log_likelihood(np.append(others, np.nan)) == pytest.approx(sum_of_logs(others, fit), rel=1e-12)
        surfaces = replace(fit, weight_outlier=0.0)
        grid = np.arange(200.0, 8000.0, 2.0)
        density = np.exp([surfaces.log_likelihood([r]) for r in grid])
        assert trapezoid(density, grid) == pytest.approx(1 - sensor.outlier_probability, abs=1e-6)
