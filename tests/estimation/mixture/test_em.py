"""EM on equation (1) against its naive twin, and the properties of its fixed points."""

import numpy as np
import pytest
from support import naive
from support.drawing import draw

from tofmix.estimation.mixture.em import FREE_SIGMA_FLOOR, fit_mixture
from tofmix.estimation.settings import EstimateOptions, SigmaMode
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


def test_weights_sum_to_one(rng: np.random.Generator, sensor: Sensor) -> None:
    fit = fit_mixture(_pixel(rng, sensor), [1000.0, 2000.0], sensor)
    assert fit.weight.sum() + fit.weight_no_return + sensor.outlier_probability == pytest.approx(1, abs=1e-12)


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


def test_no_surface_leaves_no_return_and_outliers(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[], shares=[], n=50, pixels=1)
    fit = fit_mixture(samples, [], sensor)
    assert fit.weight_no_return == pytest.approx(1 - sensor.outlier_probability)


@pytest.mark.parametrize(("samples", "start"), [([], [1.0]), ([np.nan], [1.0]), ([1.0], [np.inf])])
def test_fit_refuses_means_that_are_not_finite(samples: list[float], start: list[float], sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="finite"):
        fit_mixture(samples, start, sensor)
