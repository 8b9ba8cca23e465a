"""Standard errors of the ranges, from the observed information of the mixture.

The information of all means and shares together, with p(c_r), mu_0 and the
sigmas held at their values. Overlapping surfaces share their samples, so their
errors are larger than sigma / sqrt(samples), by as much as the data say.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.mixture import Components, gaussian
from tofmix.jit import jit

_SINGULAR = 1.0e-10
"""A pivot below this, of a matrix with a unit diagonal, is rounding."""

_LEAST_NO_RETURN = 0.5
"""With less than half a sample, p(c_0) sits at its bound 0 and has no curvature to invert."""


@jit
def _information(samples: FloatArray, k: int, fit: Components, beam: Beam, with_no_return: bool) -> FloatArray:
    """Observed information of (mu_1..mu_k, shares without the last), minus the Hessian of the log likelihood.

    The last share is what the others leave. c_0 takes part as one more share where it has samples.
    """
    shares = k + 1 if with_no_return else k
    size = k + shares - 1
    information = np.zeros((size, size))
    terms = np.zeros(shares)
    gradient = np.zeros(size)
    for j in range(len(samples)):
        total = beam.outlier_density
        for i in range(k):
            terms[i] = gaussian(samples[j], fit.mean[i], fit.sigma[i])
            total += fit.weight[i] * terms[i]
        if with_no_return:
            terms[k] = gaussian(samples[j], beam.range_max, beam.sigma_max)
            total += fit.no_return[0] * terms[k]
        last = terms[shares - 1]
        for i in range(k):
            gradient[i] = fit.weight[i] * terms[i] * (samples[j] - fit.mean[i]) / fit.sigma[i] ** 2 / total
        for i in range(shares - 1):
            gradient[k + i] = (terms[i] - last) / total
        for a in range(size):
            for b in range(size):
                information[a, b] += gradient[a] * gradient[b]
        for i in range(k):
            z = (samples[j] - fit.mean[i]) / fit.sigma[i]
            slope = terms[i] * z / fit.sigma[i] / total  # d terms / d mu
            information[i, i] -= fit.weight[i] * terms[i] * (z * z - 1.0) / fit.sigma[i] ** 2 / total
            if i < shares - 1:
                information[i, k + i] -= slope
                information[k + i, i] -= slope
            else:
                for b in range(shares - 1):
                    information[i, k + b] += slope
                    information[k + b, i] += slope
    return information


@jit
def _invert(matrix: FloatArray) -> bool:
    """Invert a symmetric positive definite matrix in place by Cholesky; false if it is not one.

    Rows are scaled to a unit diagonal first: means and shares have other units.
    """
    n = matrix.shape[0]
    scale = np.zeros(n)
    for i in range(n):
        if not matrix[i, i] > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(matrix[i, i])
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j] * scale[i] * scale[j]
            for m in range(j):
                value -= lower[i, m] * lower[j, m]
            if i == j:
                if not value > _SINGULAR:
                    return False
                lower[i, i] = math.sqrt(value)
            else:
                lower[i, j] = value / lower[j, j]
    inverse = np.zeros((n, n))
    for i in range(n):
        inverse[i, i] = 1.0 / lower[i, i]
        for j in range(i):
            value = 0.0
            for m in range(j, i):
                value -= lower[i, m] * inverse[m, j]
            inverse[i, j] = value / lower[i, i]
    for a in range(n):
        for b in range(n):
            value = 0.0
            for m in range(max(a, b), n):
                value += inverse[m, a] * inverse[m, b]
            matrix[a, b] = value * scale[a] * scale[b]
    return True


@jit
def range_errors(samples: FloatArray, k: int, fit: Components, beam: Beam, out: FloatArray) -> bool:
    """Fill out[:k] with the standard errors of the means, mm.

    Return false where the information is singular; the errors are then those of
    surfaces that share nothing, sigma / sqrt(support), and too small.
    """
    for i in range(k):
        out[i] = fit.sigma[i] / math.sqrt(max(fit.support[i], 1.0))
    if k == 0:
        return True
    if k == 1 and fit.support[0] > len(samples) - 0.01:
        return True
    information = _information(samples, k, fit, beam, fit.no_return[1] > _LEAST_NO_RETURN)
    if not _invert(information):
        return False
    for i in range(k):
        out[i] = math.sqrt(information[i, i])
    return True
