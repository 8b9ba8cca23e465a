"""Standard errors under the learnt noise are the scatter of fits about the truth: a Monte Carlo of whole pixels."""

from typing import Any

import numpy as np
import pytest
from support.learnt_pixels import KNOWN, SIGMA_MM, camera_with, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.layers import Layers
from tofmix.learnt_noise import DRIFTS

NEAR_MM = 2000.0


def _found(samples: FloatArray, noise: PixelNoise, count: int) -> tuple[Layers, FloatArray]:
    """Layers, and which pixels have the right number of them."""
    layers = layer_pixels(samples, camera_with(noise))
    return layers, layers.n_modes == count


def _held(errors: FloatArray, stated: FloatArray, margin: float) -> None:
    """The scatter, by its central 95 %, is what is stated, and so is that of the errors over their own."""
    low, high = np.quantile(errors, [0.025, 0.975])
    assert (high - low) / (2 * 1.95996) == pytest.approx(float(np.sqrt(np.mean(stated**2))), rel=margin)
    low, high = np.quantile(errors / stated, [0.025, 0.975])
    assert (high - low) / (2 * 1.95996) == pytest.approx(1.0, rel=margin)


@pytest.mark.compiled("thousands of pixels")
@pytest.mark.parametrize("name", KNOWN)
def test_error_of_one_surface_is_its_scatter(name: str, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (60, 1500), (NEAR_MM,), errors=KNOWN[name].draw)
    layers, right = _found(samples, pixel_noise(name), 1)
    assert right.mean() > 0.98
    # Fisher's information is a sample of 60's only in the limit: a sharp peak is farther from it.
    _held(layers.range[right, 0] - NEAR_MM, layers.range_stderr[right, 0], 0.2 if name == "laplace" else 0.1)


CASES: dict[str, tuple[dict[str, Any], str]] = {
    "Gaussian": ({}, "gaussian"),
    "skewed": ({}, "skewed"),
    "on background": ({"background": (2.0, 6.0)}, "gaussian"),
}


@pytest.mark.slow
@pytest.mark.compiled("thousands of pixels")
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("distance", [3.5, 8.0])
def test_errors_of_two_surfaces_are_their_scatter(name: str, distance: float, rng: np.random.Generator) -> None:
    parts, shape = CASES[name]
    background = 0.25 if parts else 0.0
    truth = NEAR_MM, NEAR_MM + distance * SIGMA_MM
    samples = surfaces(rng, (150, 1000), truth, (0.4, 0.6), errors=KNOWN[shape].draw, background=background)
    layers, right = _found(samples, pixel_noise(shape, **parts), 2)
    assert right.mean() > 0.95
    for i in range(2):
        _held(layers.range[right, i] - truth[i], layers.range_stderr[right, i], 0.15)
    shares = (1.0 - background) * np.array([0.4, 0.6])
    if not parts:  # a prior pulls the shares of background, and so of surfaces, towards its mean
        for i in range(2):
            _held(layers.weight[right, i] - shares[i], layers.weight_stderr[right, i], 0.15)


@pytest.mark.compiled("thousands of pixels")
def test_error_knows_of_the_pixels_own_width_and_drift(rng: np.random.Generator) -> None:
    pixels, time = 1500, np.linspace(-1.0, 1.0, 80)
    width = np.exp(0.3 * rng.standard_normal(pixels))
    drift = rng.normal(0.0, 15.0, pixels) * time[:, np.newaxis]
    samples = surfaces(rng, (80, pixels), (NEAR_MM,), width=width, drift_mm=drift)
    noise = pixel_noise(width_spread=0.3, drift_mm=(15.0, *(0.0,) * (DRIFTS - 1)))
    layers, right = _found(samples, noise, 1)
    assert right.mean() > 0.97
    away = layers.range[right, 0] - NEAR_MM
    _held(away, layers.range_stderr[right, 0], 0.1)
    # A pixel's error goes with its own width: half of the pixels are wide, half are narrow.
    assert layers.noise_width is not None
    wide = layers.noise_width[right] > 1.0
    ratio = layers.range_stderr[right, 0][wide].mean() / layers.range_stderr[right, 0][~wide].mean()
    assert ratio == pytest.approx(away[wide].std() / away[~wide].std(), rel=0.15)


@pytest.mark.compiled("thousands of pixels")
def test_errors_of_samples_that_remember_are_their_scatter(rng: np.random.Generator) -> None:
    frames, pixels, memory = 200, 1500, 0.5
    fresh = rng.standard_normal((frames, pixels))
    z = fresh.copy()
    for j in range(1, frames):
        z[j] = memory * z[j - 1] + np.sqrt(1.0 - memory**2) * fresh[j]
    layers, right = _found(NEAR_MM + SIGMA_MM * z, pixel_noise(memory=memory), 1)
    assert right.mean() > 0.8
    _held(layers.range[right, 0] - NEAR_MM, layers.range_stderr[right, 0], 0.1)


def test_one_surface_alone_has_the_error_of_fishers_information() -> None:
    for name in KNOWN:
        noise = pixel_noise(name)
        law = noise.laws()[0]
        z = KNOWN[name].law.ppf((np.arange(100) + 0.5) / 100)
        samples = NEAR_MM + SIGMA_MM * (z - KNOWN[name].middle) / KNOWN[name].half
        layers = layer_pixels(samples[:, np.newaxis], camera_with(noise))
        assert layers.n_modes[0] == 1
        # p(c_r) of 10^-4 takes next to nothing of any sample.
        assert layers.range_stderr[0, 0] == pytest.approx(SIGMA_MM / np.sqrt(100 * law.information), rel=0.02)
