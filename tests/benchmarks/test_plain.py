"""Plain Gaussian mixtures and rival forward models against textbook EM, closed forms, SciPy and classic data."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.plain import PlainFit, Variances, fit_gaussians
from benchmarks.rivals import ForwardModel, fit_decaying_shares, fit_thin_beam
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.optimize import minimize_scalar
from support import naive
from support.drawing import draw
from support.sizes import sized

from tofmix.sensor import NoiseCurve, Sensor

pytestmark = pytest.mark.slow  # of the benchmarks alone

CLASSIC = Path(__file__).parents[3] / "shared" / "real" / "classic_1d"
needs_classic = pytest.mark.skipif(not CLASSIC.is_dir(), reason="the classic data are not beside the checkout")


def _three(rng: np.random.Generator, n: int = 150) -> NDArray[np.float64]:
    which = rng.choice(3, p=[0.3, 0.5, 0.2], size=n)
    return np.asarray(rng.normal(np.array([0.0, 4.0, 7.0])[which], np.array([1.0, 0.5, 1.5])[which]))


@pytest.mark.slow
@pytest.mark.parametrize("variances", Variances)
@pytest.mark.parametrize("k", [1, 2, 3, pytest.param(5, marks=pytest.mark.compiled("five surfaces take long"))])
def test_no_random_start_of_textbook_em_ends_higher(k: int, variances: Variances, rng: np.random.Generator) -> None:
    samples = _three(rng)
    fit = fit_gaussians(samples, k, variances=variances, floor=0.05)
    assert fit.converged
    own = naive.plain_log_likelihood(samples, fit.weights, fit.means, fit.sigmas)
    assert fit.log_likelihood == pytest.approx(own, abs=1e-8)
    for _ in range(12):
        start = rng.choice(samples, k, replace=False), np.full(k, samples.std() / k)
        found = naive.plain_em(
            samples, *start, equal=variances is Variances.EQUAL, floor=0.05 * samples.std(), iterations=300
        )
        assert naive.plain_log_likelihood(samples, *found) <= fit.log_likelihood + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("variances", Variances)
def test_the_end_is_a_fixed_point_of_textbook_em(variances: Variances, rng: np.random.Generator) -> None:
    samples = _three(rng, 400)
    fit = fit_gaussians(samples, 2, variances=variances)
    weight, mean, sigma = naive.plain_em(
        samples, fit.means, fit.sigmas, equal=variances is Variances.EQUAL, floor=0.01 * samples.std(), iterations=3000
    )
    np.testing.assert_allclose(fit.weights, weight, atol=1e-3)
    np.testing.assert_allclose(fit.means, mean, atol=3e-3)
    np.testing.assert_allclose(fit.sigmas, sigma, atol=3e-3)
    if variances is Variances.EQUAL:
        assert np.ptp(fit.sigmas) < 1e-12


@settings(max_examples=sized(15, 3))
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 1e4), shift=st.floats(-1e4, 1e4))
def test_units_origin_and_order_do_not_matter(*, seed: int, scale: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    samples = _three(rng, 60)
    fit = fit_gaussians(samples, 3)
    other = fit_gaussians(shift + scale * rng.permutation(samples), 3)
    assert other.log_likelihood == pytest.approx(fit.log_likelihood - 60 * np.log(scale), abs=1e-3)
    assert _is_sorted(other)


def _is_sorted(fit: PlainFit) -> bool:
    return bool((np.diff(fit.means) >= 0).all() and abs(fit.weights.sum() - 1) < 1e-12)


def test_ties_and_gaps_end_at_the_floor_and_not_below() -> None:
    samples = np.repeat([0.0, 1.0, 1000.0], [20, 5, 1])
    fit = fit_gaussians(samples, 3, floor=0.02)
    assert np.isfinite(fit.log_likelihood)
    assert (fit.sigmas >= 0.02 * samples.std() * (1 - 1e-12)).all()


def _references() -> dict[tuple[str, int, str], float]:
    """Log likelihoods that another program reaches, by data set, components and model, up to four components."""
    if not CLASSIC.is_dir():
        return {}
    with (CLASSIC / "cls_mclust_fits.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {(r["dataset"], int(r["G"]), r["model"]): float(r["loglik"]) for r in rows if int(r["G"]) <= 4}


@needs_classic
@pytest.mark.parametrize(("name", "k", "model"), _references())
def test_classic_data_reach_the_reference(name: str, k: int, model: str) -> None:
    samples = np.loadtxt(CLASSIC / f"cls_{name}.csv", skiprows=1)
    fit = fit_gaussians(samples, k, variances="equal" if model == "E" else "free")
    assert fit.log_likelihood >= _references()[name, k, model] - 1e-3


@needs_classic
def test_the_published_fit_of_old_faithful() -> None:
    fit = fit_gaussians(np.loadtxt(CLASSIC / "cls_faithful_waiting.csv", skiprows=1), 2)
    assert fit.log_likelihood == pytest.approx(-1034.0017, abs=5e-4)
    np.testing.assert_allclose(fit.weights, [0.360886, 0.639114], atol=2e-3)
    np.testing.assert_allclose(fit.means, [54.6149, 80.0911], atol=0.02)
    np.testing.assert_allclose(fit.sigmas, [5.87122, 5.86773], atol=0.02)


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
