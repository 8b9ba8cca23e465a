"""EM for a mixture of surfaces with one learnt shape, on a background whose share is the pixel's own.

The likelihood of sample j, y_j being its range less the pixel's drift, is

    p(y) = sum_i w_i f((y - mu_i) / (u sigma_i)) / (u sigma_i) + w_0 N(y; r_max, sigma_0) + b / L

with the learnt shape f, the pixel's width u, c_0's share w_0 and the background's share b. Shares are updated as in any
EM; means, log u and the drift by Fisher's scoring on the samples' responsibilities, which for a Gaussian is EM itself.
Priors of u, b and the drift are part of the objective (`objective`). Steps are accelerated as in
`tofmix.estimation.acceleration`.

References
----------
McLachlan and Krishnan, The EM Algorithm and Extensions, 2nd edition, 2008, sections 1.5 and 4.
Varadhan and Roland, Scandinavian J. Statistics 35(2), 2008, doi:10.1111/j.1467-9469.2007.00585.x: scheme S3.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.curve import sigma_at
from tofmix.estimation.learnt.law import MOST_LOG_WIDTH, REACH, STEPS, Law, log_prior_t, precision_of_t
from tofmix.estimation.mixture import gaussians
from tofmix.jit import borrowing, jit
from tofmix.learnt_noise import DRIFTS
from tofmix.vector import log_of

MEAN, SIGMA, WEIGHT, SUPPORT, GAIN, OWN, PLACE, FIRST, SECOND, THIRD = 0, 1, 2, 3, 4, 5, 6, 7, 10, 13
ROWS = 16
"""Rows of a fit: what each surface has, the pixel's own numbers, room to sort, and three vectors of three rows."""

LOG_WIDTH, BACKGROUND, DRIFT = 0, 1, 2
"""Columns of row OWN; from DRIFT on, `DRIFTS` coefficients, mm."""

OWN_NUMBERS = DRIFT + DRIFTS

Y, TOTAL, SHARE, TERM, NEW, TIME = 0, 1, 2, 3, 4, 5
ORDERED, SCORES = TIME + DRIFTS, TIME + DRIFTS + 2
DENSITY = SCORES + 3
"""Rows of the room: detrended samples, p(y_j), 1 / p, rows to work in, polynomials of time, and densities."""

LONGEST_STEP = 1.0
"""No mean moves by more than this, in sigmas, in one iteration: scoring may overshoot where a shape is not concave."""

_LONGEST_JUMP = 32.0
_LEAST_SHARE = 1.0e-9


class Samples(NamedTuple):
    """One pixel's samples: `value` (n,) ascending, mm, and `time` (n,) of each, -1 to 1 over the window."""

    value: FloatArray
    time: FloatArray


@jit
def new_fit(capacity: int) -> FloatArray:
    """Room for `capacity` surfaces, c_0 (the last column), and the pixel's own numbers."""
    return np.zeros((ROWS, max(capacity, OWN_NUMBERS) + 1))


@jit
def new_room(capacity: int, samples: int) -> FloatArray:
    """Room for pixels of up to so many samples."""
    return np.zeros((DENSITY + 2 * max(capacity, OWN_NUMBERS) + 1, samples))


@borrowing
def capacity_of(fit: FloatArray) -> int:
    """Most surfaces that fit."""
    return len(fit[MEAN]) - 1


@borrowing
def copy_fit(source: FloatArray, target: FloatArray) -> None:
    """Copy the surfaces, c_0 and the pixel's own numbers."""
    for row in range(OWN + 1):
        for i in range(len(source[row])):
            target[row, i] = source[row, i]


@borrowing
def fill_times(data: Samples, room: FloatArray) -> None:
    """Fill the rows of the polynomials of time: Legendre's of the degrees 1 to 3."""
    for j in range(len(data.value)):
        t = data.time[j]
        room[TIME, j] = t
        room[TIME + 1, j] = 1.5 * t * t - 0.5
        room[TIME + 2, j] = (2.5 * t * t - 1.5) * t


@borrowing
def detrend(data: Samples, fit: FloatArray, law: Law, room: FloatArray) -> None:
    """Fill row Y with the samples less the pixel's drift."""
    n = len(data.value)
    y = room[Y]
    for j in range(n):
        y[j] = data.value[j]
    for d in range(DRIFTS):
        coefficient = fit[OWN, DRIFT + d]
        if law.drift_mm[d] > 0.0 and coefficient != 0.0:
            basis = room[TIME + d]
            for j in range(n):
                y[j] -= coefficient * basis[j]


@borrowing
def lend(y: FloatArray, n: int, mean: float, width: float, law: Law, density: FloatArray, slope: FloatArray) -> None:
    """Fill `density` with f(z) / width, 1/mm, and `slope` with -f'(z) / width, at the first `n` of y."""
    scale = 1.0 / width
    last = float(len(law.density) - 1)
    for j in range(n):
        t = ((y[j] - mean) * scale + REACH) * STEPS
        if 0.0 <= t < last:
            at = int(t)
            part = t - at
            density[j] = scale * (law.density[at] + part * (law.density[at + 1] - law.density[at]))
            slope[j] = scale * (law.slope[at] + part * (law.slope[at + 1] - law.slope[at]))
        else:
            density[j], slope[j] = 0.0, 0.0


@borrowing
def mix(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, room: FloatArray) -> None:
    """Fill Y, the densities and slopes of the surfaces, and p(y)."""
    n = len(data.value)
    detrend(data, fit, law, room)
    total = room[TOTAL]
    uniform = fit[OWN, BACKGROUND] * background_density(beam) + 1.0e-30
    for j in range(n):
        total[j] = uniform
    if fit[WEIGHT, -1] > 0.0:
        row, weight = room[no_return_row(fit), :n], fit[WEIGHT, -1]
        gaussians(room[Y, :n], beam.range_max, beam.sigma_max, row)
        for j in range(n):
            total[j] += weight * row[j]
    width = math.exp(fit[OWN, LOG_WIDTH])
    for i in range(k):
        density, weight = room[DENSITY + i], fit[WEIGHT, i]
        lend(room[Y], n, fit[MEAN, i], width * fit[SIGMA, i], law, density, room[slope_row(fit) + i])
        for j in range(n):
            total[j] += weight * density[j]


@borrowing
def no_return_row(fit: FloatArray) -> int:
    """Row of the densities of c_0."""
    return DENSITY + capacity_of(fit)


@borrowing
def slope_row(fit: FloatArray) -> int:
    """First row of the slopes."""
    return DENSITY + capacity_of(fit) + 1


@borrowing
def background_density(beam: Beam) -> float:
    """Density of background, 1/mm: uniform over the working range."""
    return 1.0 / (beam.range_top - beam.range_min)


@borrowing
def objective(data: Samples, k: int, fit: FloatArray, law: Law, room: FloatArray) -> float:
    """Log likelihood of what `mix` left, nat, and the log priors of the pixel's own numbers."""
    total, value = room[TOTAL], 0.0
    for j in range(len(data.value)):
        value += log_of(total[j])
    if k == 0 and fit[WEIGHT, -1] == 0.0:
        return value
    return value + log_priors(fit, law)


@borrowing
def log_priors(fit: FloatArray, law: Law) -> float:
    """Logarithm of the priors of width, drift and background share, each over its value at its peak or constant."""
    value = log_prior_t(fit[OWN, LOG_WIDTH], law.width_spread)
    for d in range(DRIFTS):
        value += log_prior_t(fit[OWN, DRIFT + d], law.drift_mm[d])
    b = min(max(fit[OWN, BACKGROUND], 1.0e-12), 1.0 - 1.0e-12)
    return value + law.background_near * math.log(b) + law.background_far * math.log(1.0 - b)


@borrowing
def em_step(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, room: FloatArray) -> float:
    """One iteration; return the objective at the values that it started from."""
    n = len(data.value)
    mix(data, k, fit, law, beam, room)
    before = objective(data, k, fit, law, room)
    total, share = room[TOTAL], room[SHARE]
    sum_share = 0.0
    for j in range(n):
        share[j] = 1.0 / total[j]
        sum_share += share[j]
    width = math.exp(fit[OWN, LOG_WIDTH])
    slopes = slope_row(fit)
    held, wide = 0.0, 0.0
    for i in range(k):
        density, slope = room[DENSITY + i], room[slopes + i]
        support, push, stretch = 0.0, 0.0, 0.0
        mean = fit[MEAN, i]
        for j in range(n):
            support += share[j] * density[j]
            rise = share[j] * slope[j]
            push += rise
            stretch += rise * (room[Y, j] - mean)
        own_width = width * fit[SIGMA, i]
        support *= fit[WEIGHT, i]
        push *= fit[WEIGHT, i]
        stretch = fit[WEIGHT, i] * stretch / own_width - support
        fit[SUPPORT, i] = support
        held += support
        wide += stretch
        fit[PLACE, i] = push / (law.information * support) if support > 0.0 else 0.0
    _move_drift(data, k, fit, law, room, width, held)
    for i in range(k):
        step = min(max(fit[PLACE, i], -LONGEST_STEP), LONGEST_STEP)
        fit[MEAN, i] += step * width * fit[SIGMA, i]
        fit[SIGMA, i] = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
    if law.width_spread > 0.0 and held > 0.0:
        v = fit[OWN, LOG_WIDTH]
        precision = precision_of_t(v, law.width_spread)
        v += (wide - precision * v) / (law.width_information * held + precision)
        fit[OWN, LOG_WIDTH] = min(max(v, -MOST_LOG_WIDTH), MOST_LOG_WIDTH)
    _move_shares(n, k, fit, law, beam, room, sum_share, held)
    return before


@borrowing
def _move_shares(
    n: int,
    k: int,
    fit: FloatArray,
    law: Law,
    beam: Beam,
    room: FloatArray,
    sum_share: float,
    held: float,
) -> None:
    """Update the shares of surfaces, c_0 and background."""
    no_return = 0.0
    if fit[WEIGHT, -1] > 0.0:
        row, share = room[no_return_row(fit)], room[SHARE]
        for j in range(n):
            no_return += share[j] * row[j]
        no_return *= fit[WEIGHT, -1]
    held += no_return
    random = fit[OWN, BACKGROUND] * background_density(beam) * sum_share
    background = (random + law.background_near) / (n + law.background_near + law.background_far)
    if held <= 0.0:
        background = 1.0
    scale = (1.0 - background) / held if held > 0.0 else 0.0
    for i in range(k):
        fit[WEIGHT, i] = scale * fit[SUPPORT, i]
    fit[WEIGHT, -1], fit[SUPPORT, -1] = scale * no_return, no_return
    fit[OWN, BACKGROUND] = background


@borrowing
def _move_drift(
    data: Samples, k: int, fit: FloatArray, law: Law, room: FloatArray, width: float, held: float
) -> None:
    """Update the coefficients of the drift, together with what it leaves to the means, by one step of scoring."""
    active = 0
    for d in range(DRIFTS):
        if law.drift_mm[d] > 0.0:
            active = d + 1
    if active == 0 or held <= 0.0:
        return
    n, slopes = len(data.value), slope_row(fit)
    rise, weight = room[TERM], room[NEW]
    for j in range(n):
        rise[j], weight[j] = 0.0, 0.0
    for i in range(k):
        density, slope, factor = room[DENSITY + i], room[slopes + i], fit[WEIGHT, i] / (width * fit[SIGMA, i])
        for j in range(n):
            rise[j] += factor * room[SHARE, j] * slope[j]
            weight[j] += factor / (width * fit[SIGMA, i]) * room[SHARE, j] * density[j]
    # Means move with the drift: what a polynomial and the constant share is left to the means.
    mass, push = 0.0, 0.0
    for j in range(n):
        mass += weight[j]
        push += rise[j]
    m00, m01, m02, m11, m12, m22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    c0, c1, c2, g0, g1, g2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        b0, b1, b2, w = room[TIME, j], room[TIME + 1, j], room[TIME + 2, j], weight[j]
        m00 += w * b0 * b0
        m01 += w * b0 * b1
        m02 += w * b0 * b2
        m11 += w * b1 * b1
        m12 += w * b1 * b2
        m22 += w * b2 * b2
        c0 += w * b0
        c1 += w * b1
        c2 += w * b2
        g0 += rise[j] * b0
        g1 += rise[j] * b1
        g2 += rise[j] * b2
    info = law.information
    inverse = 1.0 / mass if mass > 0.0 else 0.0
    a00 = info * (m00 - c0 * c0 * inverse)
    a01 = info * (m01 - c0 * c1 * inverse)
    a02 = info * (m02 - c0 * c2 * inverse)
    a11 = info * (m11 - c1 * c1 * inverse)
    a12 = info * (m12 - c1 * c2 * inverse)
    a22 = info * (m22 - c2 * c2 * inverse)
    g0 -= push * c0 * inverse
    g1 -= push * c1 * inverse
    g2 -= push * c2 * inverse
    g0, a00 = _with_prior(g0, a00, fit[OWN, DRIFT], law.drift_mm[0])
    g1, a11 = _with_prior(g1, a11, fit[OWN, DRIFT + 1], law.drift_mm[1])
    g2, a22 = _with_prior(g2, a22, fit[OWN, DRIFT + 2], law.drift_mm[2])
    # Cholesky of the 3 x 3 matrix; a polynomial that is not there has an infinite precision.
    l00 = math.sqrt(a00)
    l10, l20 = a01 / l00, a02 / l00
    l11 = math.sqrt(max(a11 - l10 * l10, 1.0e-12 * a11))
    l21 = (a12 - l10 * l20) / l11
    l22 = math.sqrt(max(a22 - l20 * l20 - l21 * l21, 1.0e-12 * a22))
    y0 = g0 / l00
    y1 = (g1 - l10 * y0) / l11
    y2 = (g2 - l20 * y0 - l21 * y1) / l22
    s2 = y2 / l22
    s1 = (y1 - l21 * s2) / l11
    s0 = (y0 - l10 * s1 - l20 * s2) / l00
    fit[OWN, DRIFT] += s0
    fit[OWN, DRIFT + 1] += s1
    fit[OWN, DRIFT + 2] += s2
    # The means were to move by their own push: take off what the drift now does for them.
    shift = (s0 * c0 + s1 * c1 + s2 * c2) * inverse
    for i in range(k):
        fit[PLACE, i] -= shift / (width * fit[SIGMA, i])


_INFINITE = 1.0e30


@borrowing
def _with_prior(slope: float, information: float, value: float, scale: float) -> tuple[float, float]:
    """Slope and information with the prior's; no step where there is no such polynomial."""
    if scale <= 0.0:
        return 0.0, _INFINITE
    precision = precision_of_t(value, scale)
    return slope - precision * value, information + precision


@borrowing
def _pack(k: int, fit: FloatArray, row: int) -> None:
    """Write means (in sigmas), shares, and the pixel's own numbers to three rows from `row` on."""
    width = fit[PLACE, -1]
    for i in range(k):
        fit[row, i] = fit[MEAN, i] / width
        fit[row + 1, i] = fit[WEIGHT, i]
    fit[row + 1, -1] = fit[WEIGHT, -1]
    fit[row + 2, LOG_WIDTH] = fit[OWN, LOG_WIDTH]
    fit[row + 2, BACKGROUND] = fit[OWN, BACKGROUND]
    for d in range(DRIFTS):
        fit[row + 2, DRIFT + d] = fit[OWN, DRIFT + d] / width


@borrowing
def _unpack(k: int, fit: FloatArray, row: int, beam: Beam) -> bool:
    """Set the fit from what `_pack` writes; false, and nothing is set, where a share is not above 0."""
    width, no_return, total = fit[PLACE, -1], fit[row + 1, -1], 0.0
    background = fit[row + 2, BACKGROUND]
    for i in range(k):
        if fit[row + 1, i] < _LEAST_SHARE:
            return False
        total += fit[row + 1, i]
    if no_return < 0.0 or (no_return < _LEAST_SHARE < fit[WEIGHT, -1]) or not 0.0 <= background < 1.0:
        return False
    scale = (1.0 - background) / (total + no_return)
    for i in range(k):
        fit[MEAN, i] = fit[row, i] * width
        fit[SIGMA, i] = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
        fit[WEIGHT, i] = fit[row + 1, i] * scale
    fit[WEIGHT, -1] = no_return * scale
    fit[OWN, LOG_WIDTH] = min(max(fit[row + 2, LOG_WIDTH], -MOST_LOG_WIDTH), MOST_LOG_WIDTH)
    fit[OWN, BACKGROUND] = background
    for d in range(DRIFTS):
        fit[OWN, DRIFT + d] = fit[row + 2, DRIFT + d] * width
    return True


@borrowing
def maximise(
    data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, max_iter: int, tol: float, room: FloatArray
) -> int:
    """Run accelerated EM on `k` surfaces from the values in `fit`; return iterations, negative if not converged."""
    if k == 0 and fit[WEIGHT, -1] == 0.0:
        fit[OWN, BACKGROUND] = 1.0
        return 0
    iterations = 0
    fit[PLACE, -1] = fit[SIGMA, 0] if k > 0 else beam.sigma_max
    while iterations + 2 <= max_iter:
        _pack(k, fit, FIRST)
        em_step(data, k, fit, law, beam, room)
        _pack(k, fit, SECOND)
        before = em_step(data, k, fit, law, beam, room)
        _pack(k, fit, THIRD)
        iterations += 2
        step2, bend2, last = 0.0, 0.0, 0.0
        for row in range(3):
            for i in range(len(fit[FIRST])):
                step = fit[SECOND + row, i] - fit[FIRST + row, i]
                after = fit[THIRD + row, i] - fit[SECOND + row, i]
                step2 += step * step
                bend2 += (after - step) ** 2
                last = max(last, abs(after))
        jump = min(math.sqrt(step2 / bend2), _LONGEST_JUMP) if bend2 > 0.0 else 1.0
        if last * max(jump, 1.0) < tol:
            return iterations
        if jump <= 1.0 or iterations >= max_iter:
            continue
        for row in range(3):
            for i in range(len(fit[FIRST])):
                step = fit[SECOND + row, i] - fit[FIRST + row, i]
                bend = fit[THIRD + row, i] - fit[SECOND + row, i] - step
                fit[FIRST + row, i] += 2.0 * jump * step + jump * jump * bend
        if _unpack(k, fit, FIRST, beam):
            iterations += 1
            if em_step(data, k, fit, law, beam, room) < before:
                _unpack(k, fit, THIRD, beam)
    return -iterations


@borrowing
def value_of(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, room: FloatArray) -> float:
    """Objective of a fit, nat."""
    mix(data, k, fit, law, beam, room)
    return objective(data, k, fit, law, room)
