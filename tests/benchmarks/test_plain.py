"""Plain Gaussian mixtures against textbook EM from random starts, and against another program on classic data."""

import csv
from pathlib import Path

import numpy as np
import pytest
from benchmarks.plain import PlainFit, Variances, fit_gaussians
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support import naive
from support.sizes import sized

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


def test_one_component_is_mean_and_standard_deviation(rng: np.random.Generator) -> None:
    samples = rng.exponential(3.0, 60)
    fit = fit_gaussians([*samples, np.nan, np.inf], 1)
    assert (fit.means[0], fit.sigmas[0]) == (pytest.approx(samples.mean()), pytest.approx(samples.std()))
    assert fit.weights.tolist() == [1.0]


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


def test_as_many_components_as_samples() -> None:
    fit = fit_gaussians([1.0, 2.0, 4.0, 8.0], 4)
    assert fit.means.tolist() == pytest.approx([1, 2, 4, 8], abs=0.05)


@pytest.mark.parametrize(
    ("samples", "k", "settings", "text"),
    [
        ([1.0, 2.0], 3, {}, "k: 3"),
        ([1.0, 2.0], 0, {}, "k: 0"),
        ([2.0, 2.0], 1, {}, "all are equal"),
        ([np.nan], 1, {}, "none is finite"),
        ([1.0, 2.0], 1, {"floor": 0.0}, "floor"),
        ([1.0, 2.0], 1, {"max_iter": 1}, "max_iter"),
        ([1.0, 2.0], 1, {"tol": 0.0}, "tol"),
        ([1.0, 2.0], 1, {"variances": "tied"}, "tied"),
    ],
)
def test_plain_mixture_refuses_invalid_samples_and_numbers(
    samples: list[float], k: int, settings: dict[str, float], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        fit_gaussians(samples, k, **settings)  # type: ignore[arg-type]


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
