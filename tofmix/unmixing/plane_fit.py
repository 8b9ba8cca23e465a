"""Weighted least squares of v = a + b x + c y over the places of a small window. Compiled, for kernels to call."""

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.plane import solve

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
