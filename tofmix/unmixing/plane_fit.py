"""Weighted least squares of v = a + b x + c y, for many small windows at once."""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray

_TINY = 1.0e-12
"""Part of the sum of weights that is added to the normal matrix: a window without slopes stays regular."""


class PlaneFits(NamedTuple):
    """Coefficients (n, 3), their covariances (n, 3, 3) and residuals (n, place)."""

    coefficients: FloatArray
    covariance: FloatArray
    residuals: FloatArray


def fit_planes(
    x: FloatArray, y: FloatArray, values: FloatArray, weights: FloatArray, slope_weight: FloatArray
) -> PlaneFits:
    """Fit each window.

    Parameters
    ----------
    x, y, values : (n, place) float64
        Places and what was measured there.
    weights : (n, place) float64
        One over the variances; 0 leaves a place out.
    slope_weight : (n,) float64
        One over the variance of a Gaussian prior of mean 0 on b and on c; 0: none.

    Returns
    -------
    PlaneFits
        A window without weights has coefficients 0.
    """
    weighted_x, weighted_y = weights * x, weights * y
    normal = np.empty((len(x), 3, 3))
    normal[:, 0, 0] = weights.sum(axis=1)
    normal[:, 0, 1] = normal[:, 1, 0] = weighted_x.sum(axis=1)
    normal[:, 0, 2] = normal[:, 2, 0] = weighted_y.sum(axis=1)
    normal[:, 1, 2] = normal[:, 2, 1] = (weighted_x * y).sum(axis=1)
    normal[:, 1, 1] = (weighted_x * x).sum(axis=1) + slope_weight
    normal[:, 2, 2] = (weighted_y * y).sum(axis=1) + slope_weight
    normal += (_TINY * normal[:, :1, :1] + np.finfo(float).tiny) * np.eye(3)
    covariance = np.asarray(np.linalg.inv(normal), np.float64)
    right: FloatArray = np.stack([(part * values).sum(axis=1) for part in (weights, weighted_x, weighted_y)], axis=-1)
    coefficients = np.asarray((covariance * right[:, np.newaxis]).sum(axis=-1), np.float64)
    at, across, down = (coefficients[:, k, np.newaxis] for k in range(3))
    return PlaneFits(coefficients, covariance, np.asarray(values - at - across * x - down * y))
