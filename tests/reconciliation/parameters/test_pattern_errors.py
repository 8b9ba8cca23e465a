"""What a fixed pattern does to errors, against brute force, Student's law and draws."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.reconcile_errors import scene
from support.recordings import recorded

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.likelihood.pixel_pattern import PixelBiases, marginal_pattern
from tofmix.reconciliation.parameters.fits import Numbers, Parabola, Value
from tofmix.reconciliation.parameters.pattern_errors import UnderPattern
from tofmix.simulation.effects.hidden import PatternSpreads

IMAGE = (8, 10)
PIXELS = IMAGE[0] * IMAGE[1]


@cache
def some_likelihood() -> Likelihood:
    """Of a recording with that image; its samples do not matter here."""
    model = scene(rows=IMAGE[0], cols=IMAGE[1], frames=20)
    evidence = recorded(model)
    return Likelihood(evidence, Scene(model, evidence.time_s))


def under(
    biases: FloatArray, noise: FloatArray, spreads: tuple[float, float, float], moves: FloatArray
) -> UnderPattern:
    """Biases of pixels with Gaussian noise, and numbers that change the biases; the pattern has its fitted values."""
    found = PixelBiases(bias=biases, information=1 / noise, gain=np.zeros(PIXELS))
    values = marginal_pattern(found, IMAGE, spreads)[1]
    pulls = (biases - values) / noise
    nothing = np.zeros(PIXELS)
    by_pixel = np.stack([nothing, pulls, 1 / noise, nothing], axis=1)
    top = Value(total=0.0, by_pixel=by_pixel, by_frame=np.zeros((1, 4)))
    about = Parabola(
        steps=np.ones(len(moves)),
        top=top,
        slope=moves @ pulls,
        hessian=(moves / noise) @ moves.T,
        cross=moves / noise,
        by_pixel=np.zeros((len(moves), PIXELS)),
        by_frame=np.zeros((len(moves), 1)),
    )
    likelihood = some_likelihood()
    state = replace(likelihood.start(), pixel_bias=values)
    part = np.arange(likelihood.evidence.shape[0]), np.arange(PIXELS)
    numbers = Numbers(likelihood=likelihood, state=state, fits={}, part=part)
    return UnderPattern(numbers, about, PatternSpreads(*spreads))


def covariance(noise: FloatArray, spreads: tuple[float, float, float]) -> FloatArray:
    row, col = np.divmod(np.arange(PIXELS), IMAGE[1])
    lines = spreads[1] ** 2 * (col[:, None] == col) + spreads[2] ** 2 * (row[:, None] == row)
    return np.asarray(np.diag(noise + spreads[0] ** 2) + lines)


def draw(rng: np.random.Generator, spreads: tuple[float, float, float], noise: FloatArray) -> FloatArray:
    pixels = rng.standard_normal(IMAGE) * spreads[0] + rng.standard_normal(IMAGE[1]) * spreads[1]
    pixels += rng.standard_normal((IMAGE[0], 1)) * spreads[2]
    return np.asarray(pixels.ravel() + rng.standard_normal(PIXELS) * np.sqrt(noise))


def test_curvature_is_that_of_generalised_least_squares(rng: np.random.Generator) -> None:
    noise, spreads = rng.uniform(0.5, 2.0, PIXELS), (2.0, 1.0, 0.7)
    moves = np.stack([np.ones(PIXELS), rng.normal(size=PIXELS)])
    found = under(draw(rng, spreads, noise), noise, spreads, moves).curvature(1.4, 0.3)
    wanted = moves @ np.linalg.solve(covariance(noise, (2.0, 1.4, 0.3)), moves.T)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_average_with_few_columns_and_no_noise_is_students_law(rng: np.random.Generator) -> None:
    """A mean of n normal values, their spread unknown: the variance is that of the values / n * (n - 1) / (n - 3)."""
    noise, n = np.full(PIXELS, 1e-4), IMAGE[1]
    columns = rng.standard_normal(n) * 2.0
    biases = np.tile(columns, IMAGE[0]) + rng.standard_normal(PIXELS) * 0.01
    fitted = float(np.sqrt((columns**2).mean()))
    found = under(biases, noise, (0.001, fitted, 0.001), np.ones((1, PIXELS))).averaged()
    assert found.covariance[0, 0] == pytest.approx(columns.var(ddof=1) / n * (n - 1) / (n - 3), rel=0.02)


def test_pixels_without_samples_do_not_change_the_error(rng: np.random.Generator) -> None:
    noise, spreads = rng.uniform(0.5, 2.0, PIXELS), (2.0, 1.0, 0.7)
    blind = rng.random(PIXELS) < 0.2
    biases = np.where(blind, 0.0, draw(rng, spreads, noise))
    found = [
        under(biases, np.where(blind, far, noise), spreads, np.where(blind, 0.0, np.ones((1, PIXELS)))).averaged()
        for far in (1e11, 1e306)
    ]
    np.testing.assert_array_equal(found[0].covariance, found[1].covariance)
    np.testing.assert_array_equal(found[0].spreads_mm, found[1].spreads_mm)
