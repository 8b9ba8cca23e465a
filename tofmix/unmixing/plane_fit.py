"""Weighted least squares of v = a + b x + c y, for many small windows at once."""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray

_TINY = 1.0e-12


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
    design = np.stack([np.ones_like(x), x, y], axis=-1)
    weighted = design * weights[..., np.newaxis]
    normal = np.einsum("npi,npk->nik", weighted, design)
    normal[:, 1, 1] += slope_weight
    normal[:, 2, 2] += slope_weight
    normal += (_TINY * normal[:, :1, :1] + np.finfo(float).tiny) * np.eye(3)
    covariance = np.linalg.inv(normal)
    right = np.einsum("npi,np->ni", weighted, values)
    coefficients = np.einsum("nik,nk->ni", covariance, right)
    residuals = values - np.einsum("npi,ni->np", design, coefficients)
    return PlaneFits(coefficients, covariance, residuals)
