"""Small linear algebra for kernels to call: vectors of three numbers, and least squares of a plane. Compiled.

Planes are v = a + b x + c y over the places of a small window, or solve normal equations that the caller has summed.
"""

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing


@borrowing
def dot(one: FloatArray, other: FloatArray) -> float:
    """Scalar product of two vectors (3,)."""
    return float(one[0] * other[0] + one[1] * other[1] + one[2] * other[2])


@borrowing
def solve(information: FloatArray, right: FloatArray, plane: FloatArray, covariance: FloatArray) -> None:
    """Fill the plane (3,) and its covariance (3, 3) from the normal equations, by cofactors."""
    a, b, c = information[0, 0], information[0, 1], information[0, 2]
    d, e, f = information[1, 1], information[1, 2], information[2, 2]
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    whole = a * co_a + b * co_b + c * co_c
    covariance[0, 0], covariance[0, 1], covariance[0, 2] = co_a / whole, co_b / whole, co_c / whole
    covariance[1, 1], covariance[1, 2] = (a * f - c * c) / whole, (b * c - a * e) / whole
    covariance[2, 2] = (a * d - b * b) / whole
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = covariance[0, 1], covariance[0, 2], covariance[1, 2]
    for i in range(3):
        plane[i] = covariance[i, 0] * right[0] + covariance[i, 1] * right[1] + covariance[i, 2] * right[2]


TINY = 1.0e-12
"""Part of the sum of weights that is added to the normal matrix: a window without slopes stays regular."""

_LEAST = float(np.finfo(np.float64).tiny)
"""Added besides: a window without weights stays regular, with coefficients 0."""


@borrowing
def fit_plane(
    x: FloatArray,
    y: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    slope_weight: float,
    normal: FloatArray,
    coefficients: FloatArray,
    covariance: FloatArray,
    residuals: FloatArray,
) -> None:
    """Fit one window.

    Parameters
    ----------
    x, y, values : (place,) float64
        Places and measured values.
    weights : (place,) float64
        One over the variances; 0 leaves a place out.
    slope_weight : float
        One over the variance of a Gaussian prior of mean 0 on b and on c; 0: none.
    normal : (4, 3) float64
        Scratch.
    coefficients, covariance, residuals : (3,), (3, 3), (place,) float64
        Filled: a, b and c, their covariance, and v - a - b x - c y.
    """
    information, right = normal[:3], normal[3]
    normal[:] = 0.0
    for k in range(len(x)):
        weight = weights[k]
        by_x, by_y = weight * x[k], weight * y[k]
        information[0, 0] += weight
        information[0, 1] += by_x
        information[0, 2] += by_y
        information[1, 1] += by_x * x[k]
        information[1, 2] += by_x * y[k]
        information[2, 2] += by_y * y[k]
        right[0] += weight * values[k]
        right[1] += by_x * values[k]
        right[2] += by_y * values[k]
    information[1, 1] += slope_weight
    information[2, 2] += slope_weight
    least = TINY * information[0, 0] + _LEAST
    for i in range(3):
        information[i, i] += least
    solve(information, right, coefficients, covariance)
    for k in range(len(x)):
        residuals[k] = values[k] - coefficients[0] - coefficients[1] * x[k] - coefficients[2] * y[k]
