"""Standard errors of ranges and shares, from the observed information of the mixture.

The information of all means, sigmas (unless they are tied) and shares together, with p(c_r) and mu_0 held at their
values. Overlapping surfaces share their samples, so their errors are larger than sigma / sqrt(samples); the information
matrix gives the factor.

The Cholesky factor of an information matrix, which both kinds of fit take standard errors from.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import product_of
from tofmix.estimation.beam import Beam, sigma_at
from tofmix.estimation.mixture.em import (
    DENSITY,
    MEAN,
    PRIOR_SAMPLES,
    SHARE,
    SIGMA,
    SPARE,
    SUPPORT,
    TOTAL,
    WEIGHT,
    Components,
    Scratch,
    expect,
    gradient_row,
    no_return_row,
)
from tofmix.estimation.samples import Readings
from tofmix.estimation.settings import MODE_PRIOR, MODE_TIED


@borrowing
def scaled_cholesky(matrix: FloatArray, scale: FloatArray, lower: FloatArray) -> bool:
    """Fill `lower` (n, n) with the factor of S M S, S = diag(`scale`), whose diagonal is 1; false if M has none.

    Means and shares have other units: S makes their pivots comparable. `lower` holds zeros before; of `matrix` (n, n),
    symmetric, the lower half is read.
    """
    n = len(matrix)
    for i in range(n):
        if not matrix[i, i] > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(matrix[i, i])
    singular = 1.0e-10  # a pivot below this, of a matrix with a unit diagonal, is rounding
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j] * scale[i] * scale[j]
            for m in range(j):
                value -= lower[i, m] * lower[j, m]
            if i == j:
                if not value > singular:
                    return False
                lower[i, i] = math.sqrt(value)
            else:
                lower[i, j] = value / lower[j, j]
    return True


@borrowing
def _moments(
    data: Readings, density: FloatArray, share: FloatArray, mean: float, scale: float
) -> tuple[float, float, float, float, float]:
    """Sums of share * density * z^p for p = 0..4, z = (value - mean) * scale."""
    m0, m1, m2, m3, m4 = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(len(data.value)):
        term, z = share[j] * density[j], (data.value[j] - mean) * scale
        m0 += term
        term *= z
        m1 += term
        term *= z
        m2 += term
        term *= z
        m3 += term
        m4 += term * z
    return m0, m1, m2, m3, m4


@borrowing
def _fill_gradient(data: Readings, k: int, fit: Components, mode: int, shares: int, scratch: Scratch) -> None:
    """Fill the gradient's rows: log p(r_j) by k means, k log sigmas unless tied, and all shares but the last.

    The densities are those of the fit, as `expect` leaves them.
    """
    m, free, rows = len(data.value), mode != MODE_TIED, scratch[gradient_row(fit) :]
    total = scratch[TOTAL]
    first_share = 2 * k if free else k
    for i in range(k):
        scale, weight, density = 1.0 / fit[SIGMA, i], fit[WEIGHT, i], scratch[DENSITY + i]
        by_mean, by_sigma = rows[i], rows[k + i]
        for j in range(m):
            by_mean[j] = weight * density[j] * (data.value[j] - fit[MEAN, i]) * scale * scale / total[j]
        if free:
            for j in range(m):
                z = (data.value[j] - fit[MEAN, i]) * scale
                by_sigma[j] = weight * density[j] * (z * z - 1.0) / total[j]
    # c_0 is the last share where it takes part; its densities stand in the last row.
    last = scratch[DENSITY + k - 1] if shares == k else scratch[no_return_row(fit)]
    for b in range(shares - 1):
        by_share, density = rows[first_share + b], scratch[DENSITY + b]
        for j in range(m):
            by_share[j] = (density[j] - last[j]) / total[j]


@jit
def _information(
    data: Readings, k: int, fit: Components, beam: Beam, mode: int, with_no_return: bool, scratch: Scratch
) -> FloatArray:
    """Observed information: minus the Hessian of the log likelihood, and of the sigmas' prior where there is one.

    Parameters in order: k means, k log sigmas unless they are tied, and all shares but the last, which is the
    remainder. Where c_0 has samples, its share is the last one; else that of the last surface.
    """
    shares = k + 1 if with_no_return else k
    free, m = mode != MODE_TIED, len(data.value)
    first_share = 2 * k if free else k
    size = first_share + shares - 1
    information = np.zeros((size, size))
    expect(data, k, fit, beam, scratch)
    _fill_gradient(data, k, fit, mode, shares, scratch)
    rows, term = scratch[gradient_row(fit) :], scratch[SPARE, :m]
    for a in range(size):
        for j in range(m):
            term[j] = data.times[j] * rows[a, j]
        for b in range(a, size):
            information[a, b] = information[b, a] = product_of(term, rows[b])
    for i in range(k):
        weight, scale = fit[WEIGHT, i], 1.0 / fit[SIGMA, i]
        m0, m1, m2, m3, m4 = _moments(data, scratch[DENSITY + i], scratch[SHARE], fit[MEAN, i], scale)
        information[i, i] -= weight * (m2 - m0) * scale * scale
        if free:
            information[i, k + i] -= weight * (m3 - 3.0 * m1) * scale
            information[k + i, i] = information[i, k + i]
            information[k + i, k + i] -= weight * (m4 - 4.0 * m2 + m0)
        for b in range(shares - 1):
            # A share moves its own surface up and the last one down.
            sign = 1.0 if b == i else (-1.0 if i == shares - 1 else 0.0)
            place = first_share + b
            information[i, place] -= sign * m1 * scale
            information[place, i] = information[i, place]
            if free:
                information[k + i, place] -= sign * (m2 - m0)
                information[place, k + i] = information[k + i, place]
    if mode == MODE_PRIOR:
        for i in range(k):
            ratio = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma) / fit[SIGMA, i]
            information[k + i, k + i] += 2.0 * PRIOR_SAMPLES * ratio * ratio
    return information


@jit
def _invert(matrix: FloatArray) -> bool:
    """Invert a symmetric positive definite matrix in place; false if it is not one."""
    n = len(matrix)
    scale, lower = np.zeros(n), np.zeros((n, n))
    if not scaled_cholesky(matrix, scale, lower):
        return False
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
    data: Readings,
    k: int,
    fit: Components,
    beam: Beam,
    mode: int,
    scratch: Scratch,
    ranges: FloatArray,
    weights: FloatArray,
) -> bool:
    """Fill ranges[:k], mm, and weights[:k] with the standard errors of means and shares.

    Return false where the information is singular; the errors are then those of surfaces that share nothing, and
    too small. A share that nothing competes with has the error 0: it is 1 - p(c_r).
    """
    n = data.total
    for i in range(k):
        share = fit[WEIGHT, i]
        ranges[i] = fit[SIGMA, i] / math.sqrt(max(fit[SUPPORT, i], 1.0))
        weights[i] = math.sqrt(max(share * (1.0 - share), 0.0) / n)
    if k == 0:
        return True
    least_no_return = 0.5  # with less than half a sample, p(c_0) sits at its bound 0 and has no curvature to invert
    with_no_return = fit[SUPPORT, -1] > least_no_return
    if k == 1 and not with_no_return:
        weights[0] = 0.0
        if fit[SUPPORT, 0] > n - 0.01:
            return True
    information = _information(data, k, fit, beam, mode, with_no_return, scratch)
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
