"""Standard errors of ranges and shares, from the observed information of the mixture.

The information of all means, sigmas (unless they are tied) and shares together,
with p(c_r) and mu_0 held at their values. Overlapping surfaces share their
samples, so their errors are larger than sigma / sqrt(samples), by as much as the
data say.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.density import sigma_at
from tofmix.estimation.mixture import PRIOR_SAMPLES, Components, gaussian, sample_densities
from tofmix.estimation.settings import MODE_PRIOR, MODE_TIED
from tofmix.jit import jit

_SINGULAR = 1.0e-10
"""A pivot below this, of a matrix with a unit diagonal, is rounding."""

_LEAST_NO_RETURN = 0.5
"""With less than half a sample, p(c_0) sits at its bound 0 and has no curvature to invert."""


@jit
def _shapes(sample: float, mean: float, sigma: float) -> tuple[float, float, float, float, float, float]:
    """Density of a surface and its derivatives by mean (m) and log sigma (s): f, f_m, f_s, f_mm, f_ms, f_ss."""
    z = (sample - mean) / sigma
    f = gaussian(sample, mean, sigma)
    square = z * z - 1.0
    return (
        f,
        f * z / sigma,
        f * square,
        f * square / sigma**2,
        f * z * (z * z - 3.0) / sigma,
        f * (square * square - 2.0 * z * z),
    )


@jit
def _information(
    samples: FloatArray, k: int, fit: Components, beam: Beam, mode: int, with_no_return: bool
) -> FloatArray:
    """Observed information: minus the Hessian of the log likelihood, and of the sigmas' prior where there is one.

    Parameters in order: k means, k log sigmas unless they are tied, and all shares but the last, which is what the
    others leave. c_0 takes part as one more share where it has samples.
    """
    shares = k + 1 if with_no_return else k
    free = mode != MODE_TIED
    first_share = 2 * k if free else k
    size = first_share + shares - 1
    information, second, gradient = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size)
    terms = np.zeros(shares)
    for j in range(len(samples)):
        total = sample_densities(samples[j], k, fit, beam)[0]
        second[:] = 0.0
        if with_no_return:
            terms[k] = gaussian(samples[j], beam.range_max, beam.sigma_max)
        for i in range(k):
            f, f_m, f_s, f_mm, f_ms, f_ss = _shapes(samples[j], fit.mean[i], fit.sigma[i])
            terms[i] = f
            gradient[i] = fit.weight[i] * f_m / total
            second[i, i] = fit.weight[i] * f_mm
            if free:
                gradient[k + i] = fit.weight[i] * f_s / total
                second[i, k + i] = second[k + i, i] = fit.weight[i] * f_ms
                second[k + i, k + i] = fit.weight[i] * f_ss
            for b in range(shares - 1):
                # A share moves its own surface up and the last one down.
                sign = 1.0 if b == i else (-1.0 if i == shares - 1 else 0.0)
                second[i, first_share + b] = second[first_share + b, i] = sign * f_m
                if free:
                    second[k + i, first_share + b] = second[first_share + b, k + i] = sign * f_s
        for b in range(shares - 1):
            gradient[first_share + b] = (terms[b] - terms[shares - 1]) / total
        for a in range(size):
            for b in range(size):
                information[a, b] += gradient[a] * gradient[b] - second[a, b] / total
    if mode == MODE_PRIOR:
        for i in range(k):
            ratio = sigma_at(fit.mean[i], beam.curve_range, beam.curve_sigma) / fit.sigma[i]
            information[k + i, k + i] += 2.0 * PRIOR_SAMPLES * ratio * ratio
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
def standard_errors(
    samples: FloatArray, k: int, fit: Components, beam: Beam, mode: int, ranges: FloatArray, weights: FloatArray
) -> bool:
    """Fill ranges[:k], mm, and weights[:k] with the standard errors of means and shares.

    Return false where the information is singular; the errors are then those of surfaces that share nothing, and
    too small. A share that nothing competes with has the error 0: it is 1 - p(c_r).
    """
    n = len(samples)
    for i in range(k):
        share = fit.weight[i]
        ranges[i] = fit.sigma[i] / math.sqrt(max(fit.support[i], 1.0))
        weights[i] = math.sqrt(max(share * (1.0 - share), 0.0) / n)
    if k == 0:
        return True
    with_no_return = fit.no_return[1] > _LEAST_NO_RETURN
    if k == 1 and not with_no_return:
        weights[0] = 0.0
        if fit.support[0] > n - 0.01:
            return True
    information = _information(samples, k, fit, beam, mode, with_no_return)
    if not _invert(information):
        return False
    first_share = k if mode == MODE_TIED else 2 * k
    last = 0.0
    for a in range(first_share, len(information)):
        for b in range(first_share, len(information)):
            last += information[a, b]
    for i in range(k):
        ranges[i] = math.sqrt(information[i, i])
        place = first_share + i
        weights[i] = math.sqrt(max(information[place, place] if place < len(information) else last, 0.0))
    return True
