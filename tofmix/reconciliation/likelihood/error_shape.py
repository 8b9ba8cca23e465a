"""Errors that are not Gaussian in the panel: their shape as a table, and Hermite polynomials of scores.

The shape of the error as a table of even steps for kernels, and its effect on the panel's statistics.

Normalised Hermite polynomials of orders 1 to 4, and their slopes.

Of a standard normal z their means are 0, their variances 1, and their covariances 0.
"""

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from scipy.special import ndtr

from tofmix.arrays import Float32Array, FloatArray
from tofmix.noise_shape import NoiseShape


def hermite(z: Float32Array) -> Iterator[Float32Array]:
    """Yield the polynomials of orders 1 to 4 at z."""
    square = z * z
    yield z
    yield ((square - 1) / np.sqrt(2)).astype(np.float32)
    yield ((square - 3) * z / np.sqrt(6)).astype(np.float32)
    yield ((square * (square - 6) + 3) / np.sqrt(24)).astype(np.float32)


def hermite_slopes(z: FloatArray) -> Iterator[FloatArray]:
    """Yield the derivatives of the polynomials of orders 1 to 4 at z."""
    yield np.ones_like(z)
    yield 2 * z / np.sqrt(2.0)
    yield 3 * (z**2 - 1) / np.sqrt(6.0)
    yield 4 * (z**3 - 3 * z) / np.sqrt(24.0)


ShapeTable: TypeAlias = tuple[float, float, FloatArray, FloatArray, float]
"""First z, step, density at each point, probability below each point, and information of one sample about its location
in units of that of a Gaussian one. Both arrays are empty for a Gaussian."""

GAUSSIAN: ShapeTable = (0.0, 1.0, np.zeros(0), np.zeros(0), 1.0)

_STEP = 0.005
"""In sigma: linear interpolation within a step is right to 1e-5 of the density's peak."""

_LEAST_POINTS, _MOST_POINTS = 256, 65_536  # of a table

Moves: TypeAlias = tuple[float, float, float, float]
"""Of the four statistics of `tofmix.reconciliation.comparison.panel.SHAPES`."""


def shape_table(shape: NoiseShape | None) -> ShapeTable:
    """The table of a shape; None for a Gaussian.

    The information is the integral of f'^2 / f over the table's steps. Where a density begins with a slope it has no
    finite value; steps of a table give one.
    """
    if shape is None:
        return GAUSSIAN
    first, last = float(shape.z[0]), float(shape.z[-1])
    points = int(np.clip(np.ceil((last - first) / _STEP) + 1, _LEAST_POINTS, _MOST_POINTS))
    step = (last - first) / (points - 1)
    density = shape.pdf(first + step * np.arange(points))
    below = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * step)])
    density, below = density / below[-1], below / below[-1]
    height = 0.5 * (density[1:] + density[:-1])
    change = np.diff(density)
    information = float((change[height > 0] ** 2 / height[height > 0]).sum() / step)
    return first, step, density, below, information


def moves(shape: NoiseShape | None) -> tuple[Moves, Moves]:
    """Changes of the means of the four Hermite polynomials of scores, for a bias and for a wider pixel.

    The changes are for a bias of 1 sigma, and for a log width larger by 1. Let q be the quantile of the shape with the
    probability of the score z. The score changes by f(q) / phi(z) for each sigma, and by q f(q) / phi(z) for each unit
    of the log width. For a Gaussian these are 1 and z, so the means change by 1, 0, 0, 0 and by 0, sqrt 2, 0, 0.
    """
    if shape is None:
        return (1.0, 0.0, 0.0, 0.0), (0.0, 2.0**0.5, 0.0, 0.0)
    z = np.linspace(-4.0, 4.0, 1601)
    weight = np.exp(-0.5 * z**2)
    q = shape.quantile(ndtr(z))
    off = shape.pdf(q) / (weight / np.sqrt(2 * np.pi))
    weight /= weight.sum()
    slopes = tuple(hermite_slopes(z))

    def means(move: FloatArray) -> Moves:
        one, two, three, four = (float((weight * slope * move).sum()) for slope in slopes)
        return one, two, three, four

    return means(off), means(q * off)
