"""Noise that is not Gaussian, coarse readings, outliers and drift: what must hold all the same."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from support.sizes import sized

from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.sensor import NoiseCurve, Sensor

SIGMA = 20.0
CAMERA = Sensor(
    name="test", range_min_mm=300.0, range_max_mm=7500.0, noise=NoiseCurve(np.array([1000.0]), np.array([SIGMA]))
)
Draw = Callable[[np.random.Generator, tuple[int, int]], NDArray[np.float64]]

NOISES: dict[str, Draw] = {
    "skewed": lambda rng, shape: (rng.gamma(4.0, size=shape) - 4.0) / 2.0,
    "heavy-tailed": lambda rng, shape: rng.standard_t(5, size=shape) * np.sqrt(3 / 5),
    "steps of sigma": lambda rng, shape: np.rint(rng.standard_normal(shape)),
    "steps of two sigma": lambda rng, shape: 2 * np.rint(0.5 * np.sqrt(2 / 3) * rng.standard_normal(shape)),
    "tied": lambda rng, shape: rng.choice([-0.5, 0.0, 0.0, 0.5], size=shape),
    "near-constant": lambda rng, shape: 1e-3 * rng.standard_normal(shape),
    "constant": lambda rng, shape: 0.0 * rng.standard_normal(shape),
    "drifting": lambda rng, shape: np.linspace(-1, 1, shape[0])[:, None] + 0.8 * rng.standard_normal(shape),
}
TAILED = ("skewed", "heavy-tailed")
"""A few of their samples lie where no Gaussian sample would: docs/results/limits.md has the rates of false layers."""


def _hold_together(layers: Layers, samples: NDArray[np.float64]) -> None:
    found = np.isfinite(layers.range)
    np.testing.assert_array_equal(found.sum(axis=1), layers.n_modes)
    ok = (layers.status == Status.OK)[:, np.newaxis] & found
    assert (layers.n_modes[layers.status == Status.OK] > 0).all()
    for name in ("sigma", "weight", "range_stderr", "weight_stderr", "probability"):
        values = getattr(layers, name)[ok]
        assert np.isfinite(values).all(), name
        assert (values >= 0).all(), name
    fitted = layers.status != Status.TOO_FEW_SAMPLES
    total = np.nansum(layers.weight, axis=1) + layers.weight_no_return + layers.weight_outlier
    np.testing.assert_allclose(total[fitted], 1, atol=1e-5)
    assert np.isfinite(layers.log_likelihood[fitted]).all()
    low, high = samples.min(axis=0) - SIGMA, samples.max(axis=0) + SIGMA
    assert ((layers.range >= low[:, np.newaxis]) & (layers.range <= high[:, np.newaxis]))[found].all()


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("n", [2, 3, 5, 15, 100, 600])
def test_layers_keep_all_rules_under_any_noise(noise: str, n: int, rng: np.random.Generator) -> None:
    pixels = sized(60, 5) if n < 600 else sized(8, 1)
    near = rng.random((n, pixels)) < 0.4
    samples = np.where(near, 1200.0, 3000.0) + SIGMA * NOISES[noise](rng, (n, pixels))
    for options in (
        EstimateOptions(min_samples=2),
        EstimateOptions(min_samples=2, sigma=SigmaMode.FREE, refine=Refine.NONE),
    ):
        _hold_together(layer_pixels(samples, CAMERA, options), samples)


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("n", [10, 100])
def test_no_layer_lies_between_two_surfaces(noise: str, n: int, rng: np.random.Generator) -> None:
    pixels = sized(400, 40)
    near = rng.random((n, pixels)) < 0.5
    samples = np.where(near, 2000.0, 2000.0 + 25 * SIGMA) + SIGMA * NOISES[noise](rng, (n, pixels))
    layers = layer_pixels(samples, CAMERA)
    between = (layers.range > 2000 + 3 * SIGMA) & (layers.range < 2000 + 22 * SIGMA)
    if noise in TAILED:
        assert between.any(axis=1).mean() < 0.08
        # What there is are a few samples next to the surface whose tail they are, never a bridge.
        assert (layers.weight[between] < 0.08).all() or n < 100
        assert not ((layers.range > 2000 + 9 * SIGMA) & (layers.range < 2000 + 16 * SIGMA)).any()
    else:
        assert not between.any()
    both = (layers.n_modes >= 2).mean()
    assert both > (0.97 if n == 10 else 0.999)


@pytest.mark.parametrize("outliers", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("n", [30, 300])
def test_many_outliers_make_no_layer(outliers: float, n: int, rng: np.random.Generator) -> None:
    pixels = sized(100, 10) if n < 300 else sized(12, 2)
    samples = np.where(rng.random((n, pixels)) < 0.5, 2000.0, 5000.0) + SIGMA * rng.standard_normal((n, pixels))
    wild = rng.random(samples.shape) < outliers
    samples[wild] = rng.uniform(300, 7500, int(wild.sum()))
    camera = Sensor(
        name="test", range_min_mm=300.0, range_max_mm=7500.0, noise=CAMERA.noise, outlier_probability=outliers
    )
    layers = layer_pixels(samples, camera)
    _hold_together(layers, samples)
    away = np.minimum(np.abs(layers.range - 2000), np.abs(layers.range - 5000))
    assert (away > 4 * SIGMA).any(axis=1).mean() <= 0.02  # asked: 0.1 %
    if n * (1 - outliers) > 100:
        assert (layers.n_modes == 2).all()


@pytest.mark.parametrize("noise", ["steps of sigma", "steps of two sigma", "tied", "near-constant", "constant"])
@pytest.mark.parametrize("n", [5, 30, 200])
def test_coarse_or_quiet_readings_of_one_surface_are_one_layer(noise: str, n: int, rng: np.random.Generator) -> None:
    pixels = sized(300, 30)
    place = rng.uniform(1000, 3000, pixels)
    samples = place + SIGMA * NOISES[noise](rng, (n, pixels))
    layers = layer_pixels(samples, CAMERA)
    assert (layers.n_modes == 1).mean() > sized(0.985, 0.96)  # 0.1 % asked; 4 standard errors of 300 pixels
    spread = 2 * SIGMA / np.sqrt(n)
    assert (np.abs(layers.range[:, 0] - place) < 4 * spread).mean() > sized(0.99, 0.95)


def test_a_drift_of_one_sigma_is_one_layer_and_a_long_one_is_not_nan(rng: np.random.Generator) -> None:
    drift = np.linspace(-0.5, 0.5, 100)[:, None]
    for length, pixels, least in ((1.0, sized(100, 20), sized(0.97, 0.9)), (40.0, sized(5, 1), 0.0)):
        samples = 2000 + SIGMA * (length * drift + rng.standard_normal((100, pixels)))
        layers = layer_pixels(samples, CAMERA)
        _hold_together(layers, samples)
        assert (layers.n_modes == 1).mean() >= least
