"""Whether one more surface could gain enough: a quick bound for well-separated surfaces.

Use `gain_bound_of_clear` before `gradient.steepest_place`, which looks everywhere and at every overlap, and costs far
more. Most pixels see one surface, or a few far apart: there, the densities of a surface moved by delta sigma and of the
fitted one differ by the factor exp(delta z - delta^2 / 2), with z = (r - mu) / sigma. The powers of exp(3 z / 4) give
them all. The bound neglects the slope of the noise curve and c_r, a few per cent; it decides which places are tried,
not which surfaces are found.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.vector import exp_minus, log_of, product_of, total_of
from tofmix.estimation.beam import Beam
from tofmix.estimation.mixture.components import MEAN, OTHER, SHARE, SIGMA, SPARE, TOTAL, WEIGHT, Components, Scratch
from tofmix.estimation.mixture.share_step import LEAST_BEND, next_share
from tofmix.estimation.noise.kernel import sigma_at
from tofmix.estimation.samples import Readings

SURFACE_SIGMAS = 4.0
"""Samples this near to a surface belong to it alone, where no other surface is within twice that distance."""

_STEP = 0.75
"""Distance between the places of a trial surface, in sigmas."""

_STEPS = 6
"""Places on either side: up to 4.5 sigma."""

_HEAVY = 0.5
"""Where one sample has such a part in a new surface, the score statistic falls short, and the gain is worked out."""

_LEAST_INFORMATION = 1.0e-6
"""Least information by sample: less is rounding."""

_ROOT = math.exp(_STEP * SURFACE_SIGMAS)
_NEWTON_STEPS = 3
"""Newton steps for the best share in a gain bound."""


@borrowing
def gain_bound_of_clear(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch, least: float) -> float:
    """Largest gain bound of all places, nat; infinite if surfaces overlap, or samples lie elsewhere.

    It is worked out until it reaches `least`.
    """
    values = data.value
    bound, owned = 0.0, 0.0
    if fit[WEIGHT, -1] > 0.0:
        for i in range(k):
            if abs(beam.range_max - fit[MEAN, i]) < 2.0 * SURFACE_SIGMAS * max(fit[SIGMA, i], beam.sigma_max):
                return math.inf
        first = _first_from(values, beam.range_max - SURFACE_SIGMAS * beam.sigma_max)
        stop = _first_from(values, beam.range_max + SURFACE_SIGMAS * beam.sigma_max)
        own = Readings(values[first:stop], data.times[first:stop], total_of(data.times[first:stop]))
        owned = own.total
        if first < stop:
            bound = _gain_bound_near(own, beam.range_max, beam.sigma_max, scratch, least, 0.0)
            if bound >= least:
                return bound
    for i in range(k):
        for other in range(i):
            if abs(fit[MEAN, i] - fit[MEAN, other]) < 2.0 * SURFACE_SIGMAS * max(fit[SIGMA, i], fit[SIGMA, other]):
                return math.inf
        sigma = sigma_at(fit[MEAN, i], beam.curve_range, beam.curve_sigma)
        first = _first_from(values, fit[MEAN, i] - SURFACE_SIGMAS * sigma)
        stop = _first_from(values, fit[MEAN, i] + SURFACE_SIGMAS * sigma)
        if first == stop:
            return math.inf
        own = Readings(values[first:stop], data.times[first:stop], total_of(data.times[first:stop]))
        owned += own.total
        bound = max(bound, _gain_bound_near(own, fit[MEAN, i], sigma, scratch, least, 1.0))
        if bound >= least:
            return bound
    return bound if owned > data.total - 0.5 else math.inf


@borrowing
def _first_from(values: FloatArray, low: float) -> int:
    """Index of the first of ascending values that is not below `low`."""
    first, stop = 0, len(values)
    while first < stop:
        middle = (first + stop) // 2
        if values[middle] < low:
            first = middle + 1
        else:
            stop = middle
    return first


@borrowing
def _gain_bound_near(
    own: Readings, mean: float, sigma: float, scratch: Scratch, least: float, free_mean: float
) -> float:
    """Largest gain bound of the places around one surface, from its own samples; the mean of c_0 is not free."""
    value, count, m = own.value, own.times, len(own.value)
    z, base, power = scratch[SPARE, :m], scratch[OTHER, :m], scratch[SHARE, :m]
    for j in range(m):
        z[j] = (value[j] - mean) / sigma
    for j in range(m):
        base[j] = _ROOT * exp_minus(_STEP * (SURFACE_SIGMAS - z[j]))  # exp(_STEP z)
        power[j] = count[j] * z[j] * z[j]
    bound, squares = 0.0, total_of(power)
    for side in range(2):
        for j in range(m):
            power[j] = 1.0
        if side == 1:
            for j in range(m):
                base[j] = 1.0 / base[j]
        farthest = z[m - 1] if side == 0 else -z[0]
        for step in range(1, _STEPS + 1):
            delta = _STEP * step
            scale = math.exp(-0.5 * delta * delta)
            new, by_mean, square = _next_power(power, base, z, count)
            slope = scale * new - own.total  # D
            if slope <= 0.0:
                continue
            information = scale * scale * square - 2.0 * scale * new + own.total
            if squares > 0.0 and free_mean > 0.0:
                information -= scale * scale * by_mean * by_mean / squares
            information = max(information, _LEAST_INFORMATION * own.total)
            bound = max(bound, 0.5 * slope * slope / information)
            if bound < least and slope * scale * math.exp(delta * farthest) > _HEAVY * information:
                bound = max(bound, _gain_of_best_share(power, scale, own, scratch[TOTAL, :m]))
            if bound >= least:
                return bound
    return bound


@borrowing
def _next_power(power: FloatArray, base: FloatArray, z: FloatArray, count: FloatArray) -> tuple[float, float, float]:
    """Multiply the powers by the base; return the sums of them, of them times z, and of their squares."""
    a0, b0, c0, d0 = 0.0, 0.0, 0.0, 0.0
    a1, b1, c1, d1 = 0.0, 0.0, 0.0, 0.0
    a2, b2, c2, d2 = 0.0, 0.0, 0.0, 0.0
    m = len(power)
    for j in range(m):
        power[j] *= base[j]
    for part in range(m >> 2):
        j = part << 2
        term = count[j] * power[j]
        a0 += term
        a1 += term * z[j]
        a2 += term * power[j]
        term = count[j + 1] * power[j + 1]
        b0 += term
        b1 += term * z[j + 1]
        b2 += term * power[j + 1]
        term = count[j + 2] * power[j + 2]
        c0 += term
        c1 += term * z[j + 2]
        c2 += term * power[j + 2]
        term = count[j + 3] * power[j + 3]
        d0 += term
        d1 += term * z[j + 3]
        d2 += term * power[j + 3]
    for j in range(m - m % 4, m):
        term = count[j] * power[j]
        a0 += term
        a1 += term * z[j]
        a2 += term * power[j]
    return (a0 + b0) + (c0 + d0), (a1 + b1) + (c1 + d1), (a2 + b2) + (c2 + d2)


@borrowing
def _gain_of_best_share(power: FloatArray, scale: float, own: Readings, term: FloatArray) -> float:
    """Gain, nat, of the best share of a new surface with density ratios scale * power, all else held."""
    count, share = own.times, 1.0 / own.total
    for _ in range(_NEWTON_STEPS):
        for j in range(len(count)):
            excess = scale * power[j] - 1.0
            term[j] = excess / (1.0 + share * excess)
        slope = product_of(count, term)
        for j in range(len(count)):
            term[j] *= term[j]
        bend = product_of(count, term) + LEAST_BEND
        share = next_share(share, slope, bend)
    for j in range(len(count)):
        term[j] = log_of(1.0 + share * (scale * power[j] - 1.0))
    return product_of(count, term)
