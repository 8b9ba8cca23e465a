"""The paper's algorithm against a plain NumPy twin, and its place beside the default."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from tofmix.arrays import FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.peaks.counters import Cpdf, Kde
from tofmix.estimation.settings import EstimateOptions
from tofmix.flags import Status
from tofmix.invariants import layer_rules
from tofmix.sensor import NoiseCurve, Sensor

CURVE = NoiseCurve(np.array([500.0, 3000.0, 7500.0]), np.array([30.0, 90.0, 300.0]))
CAMERA = Sensor(name="a camera", range_min_mm=500.0, range_max_mm=7500.0, noise=CURVE)


def twin(samples: FloatArray, gamma: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Means, sigmas and shares of the surfaces, and sigma_0, by equations (1), (4) and (5) and section V."""
    step = CURVE.sigma_mm.min() / 8.0
    cells = np.arange(-np.ceil(1500.0 / step), np.ceil((np.ptp(samples) + 1500.0) / step))
    grid = samples.min() + step * cells
    h = CURVE.sigma(grid)[:, None] / 2.0
    p = stats.norm.pdf(grid[:, None], samples, h).mean(axis=1)  # (4)
    lone = stats.norm.pdf(0.0, 0.0, np.hypot(h[:, 0], 2.0 * h[:, 0]))
    higher = np.r_[False, (p[1:-1] > p[:-2]) & (p[1:-1] >= p[2:]), False]
    places = grid[higher & (p > gamma * lone)]  # (5)
    places = places[places <= 7500.0 - 2.0 * 300.0]
    mean, sigma = np.r_[places, 7500.0], CURVE.sigma(np.r_[places, 7500.0])
    share = np.full(len(mean), (1.0 - 1e-4) / len(mean))
    for _ in range(50):
        density = share * stats.norm.pdf(samples[:, None], mean, sigma)
        posterior = density / (1e-4 / 7500.0 + density.sum(axis=1, keepdims=True))
        support = posterior.sum(axis=0)
        mean = np.r_[(posterior * samples[:, None]).sum(axis=0)[:-1] / support[:-1], 7500.0]
        with np.errstate(invalid="ignore", divide="ignore"):
            free = np.sqrt((posterior * (samples[:, None] - mean) ** 2).sum(axis=0) / support)
        sigma = np.where(free > 1e-6 * CURVE.sigma(mean), free, sigma)  # on one sample alone it would be 0
        share = (1.0 - 1e-4) * support / support.sum()
    order = np.argsort(mean[:-1])
    return mean[:-1][order], sigma[:-1][order], share[:-1][order], float(sigma[-1])


def draw(rng: np.random.Generator, pixels: int) -> NDArray[np.float32]:
    """Two boards and samples without a return, (frame, pixel)."""
    truth = rng.choice([1500.0, 2400.0, 7500.0], p=[0.4, 0.4, 0.2], size=(80, pixels))
    return (truth + CURVE.sigma(truth) * rng.standard_normal(truth.shape)).astype(np.float32)


@pytest.mark.parametrize("gamma", [0.02, 0.1])
def test_paper_algorithm_equals_its_numpy_twin(rng: np.random.Generator, gamma: float) -> None:
    samples = draw(rng, 8)
    found = layer_pixels(samples, CAMERA, EstimateOptions(paper=True, counter=Kde(gamma=gamma), max_layers=32))
    for pixel in range(samples.shape[1]):
        mean, sigma, share, _ = twin(samples[:, pixel].astype(np.float64), gamma)
        k = int(found.n_modes[pixel])
        assert k == len(mean)
        np.testing.assert_allclose(found.range[pixel, :k], mean, rtol=1e-4)
        if found.status[pixel] == Status.OK:
            np.testing.assert_allclose(found.sigma[pixel, :k], sigma, rtol=2e-3)
        np.testing.assert_allclose(found.weight[pixel, :k], share, atol=1e-4)


def test_paper_algorithm_frees_sigma_0_and_holds_mu_0(rng: np.random.Generator) -> None:
    """No return with a quarter of the curve's spread: all of its samples are c_0's, though (1) has sigma(r_max)."""
    truth = np.where(rng.random((200, 20)) < 0.5, 1500.0, 7500.0)
    spread = np.where(truth < 7000.0, CURVE.sigma(truth), 75.0)
    samples = truth + spread * rng.standard_normal(truth.shape)
    found = layer_pixels(samples, CAMERA, EstimateOptions(paper=True, counter=Kde(gamma=0.1)))
    share = (truth > 7000.0).mean(axis=0)
    assert (found.n_modes == 1).all()
    np.testing.assert_allclose(found.weight_no_return, share, atol=2e-3)
    as_held = layer_pixels(samples, CAMERA)
    assert (found.log_likelihood > as_held.log_likelihood + 50.0).all()


def test_paper_algorithm_keeps_every_rule_of_a_layers_file(rng: np.random.Generator) -> None:
    samples = np.concatenate([draw(rng, 200), np.full((80, 1), 7500.0), np.full((80, 1), np.nan)], axis=1)
    samples[:, 3] = 1500.0  # equal samples: sigma goes to 0
    found = layer_pixels(samples.reshape(80, 2, 101), CAMERA, EstimateOptions(paper=True))
    layers = found.reshaped((1, 2, 101))
    assert [rule.text for rule in layer_rules(layers, np.array([80])) if rule.broken.any()] == []
    assert found.status.ravel()[3] == Status.DEGENERATE
    assert found.status.ravel()[-2:].tolist() == [Status.NO_SURFACE, Status.TOO_FEW_SAMPLES]


def test_paper_algorithm_starts_from_the_highest_modes_where_there_are_more_than_max_layers(
    rng: np.random.Generator,
) -> None:
    truth = rng.choice([1000.0, 2000.0, 3000.0, 4500.0], p=[0.3, 0.1, 0.3, 0.3], size=(200, 10))
    samples = truth + 0.5 * CURVE.sigma(truth) * rng.standard_normal(truth.shape)
    options = EstimateOptions(paper=True, counter=Kde(gamma=0.05), max_layers=3)
    found = layer_pixels(samples, CAMERA, options)
    assert (found.n_peaks >= 4).all()
    assert (found.n_modes == 3).all()


def test_paper_option_refuses_another_counter_and_a_wrapped_axis() -> None:
    with pytest.raises(ValueError, match="kernel density"):
        EstimateOptions(paper=True, counter=Cpdf())
    with pytest.raises(ValueError, match="wrapped range axis"):
        EstimateOptions(paper=True, unambiguous_range_mm=7500.0)


def test_paper_option_is_recorded_without_options_that_it_does_not_have() -> None:
    recorded = EstimateOptions(paper=True, counter=Kde(gamma=0.1)).as_dict()
    assert recorded["paper"] is True
    assert (recorded["gamma"], recorded["sigma"], recorded["refine"], recorded["max_iter"]) == (0.1, "free", "none", 50)
    assert not {"epsilon", "tol", "false_alarm"} & set(recorded)
    assert "paper" not in EstimateOptions().as_dict()
