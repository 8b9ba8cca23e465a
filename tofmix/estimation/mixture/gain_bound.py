"""Whether one more surface is worth a fit: its place, its share, and two bounds of its gain.

Use `gain_bound_of_clear` before `steepest_place`, which looks everywhere and at every overlap, and costs far
more. Most pixels see one surface, or a few far apart: there, the densities of a surface moved by delta sigma and of the
fitted one differ by the factor exp(delta z - delta^2 / 2), with z = (r - mu) / sigma. The powers of exp(3 z / 4) give
them all. The bound neglects the slope of the noise curve and c_r, a few per cent; it decides which places are tried,
not which surfaces are found.

One step of Newton's search for the share of a new surface, all else held.

The log likelihood is concave in the share. The step is kept between half of the share and
half of the way to `LARGEST_SHARE`, so that no step leaves (0, 1).

Four kernels have a loop around this step: those of a place's bound, of a trial's place, and of surfaces far apart
here, and one in `tofmix.estimation.learnt.gain_bound`. One loop for all would need the ratio of the new density
to p(r_j) in a row, which costs the first a division and a row more for each place. And each forms slope and bend by
other operations: with or without samples outside, from ratios or differences, with or without counts. One loop would
change the last bits of shares and gains, and with them which trials are made.

Place of one more surface of a mixture, and a bound of its gain.

D(theta) = sum_j p(r_j | surface at theta) / p(r_j) - N is the slope of the log likelihood as share moves to a surface
at theta. No mixture of the same kind, with any number of surfaces, gains more than max D. If max D is below the
threshold of a surface, none needs to be tried. Its place is also where to try one.

max D is far above the gain where a single sample lies in a surface's tail. The gain bound of a place is closer to the
gain, and still cheap: the gain of the best share there, with all else fixed; or, where the new surface replaces an old
one, the score statistic, corrected for the part that the mean and share of the old one explain.

References
----------
Lindsay, The geometry of mixture likelihoods, Annals of Statistics 11(1), 1983, doi:10.1214/aos/1176346059.
Rao's score statistic with nuisance parameters: Cox and Hinkley, Theoretical Statistics, 1974, section 9.3.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.vector import exp_minus, log_of, product_of, total_of
from tofmix.estimation.beam import Beam, is_beyond, is_uniform, sigma_at
from tofmix.estimation.mixture.em import (
    DENSITY,
    MEAN,
    MEAN_SCORE,
    OTHER,
    RANDOM,
    ROOT_TWO_PI,
    SHARE,
    SHARE_SCORE,
    SIGMA,
    SPARE,
    TOTAL,
    WEIGHT,
    Components,
    Scratch,
    gaussians,
    mix,
)
from tofmix.estimation.samples import Readings, whole_lanes, within_reach

LARGEST_SHARE = 0.9
"""A new surface is given at most this share: the rest stays with the surfaces that are there."""

LEAST_BEND = 1.0e-12
"""Least negative second derivative, nat: a surface that changes no sample's density has none."""


@borrowing
def next_share(share: float, slope: float, bend: float) -> float:
    """Share after one step, from the likelihood's slope and negative second derivative at `share`, in nat."""
    return min(max(share + slope / bend, 0.5 * share), 0.5 * (share + LARGEST_SHARE))


SEARCH_STEP = 0.5
"""Step of the search in sigmas: a quarter of a sigma off the best place, a surface gains 3 % less."""


LAST_STEPS = 6
"""Newton steps of the best share at the place that is taken: the share is then exact to rounding."""

QUICK_STEPS = 3
"""Newton steps of the best share at each place that is compared: the order of places needs no more."""

LEAST_INFORMATION = 1.0e-6
"""Below this, by sample, a direction is no direction: its information is rounding."""


@borrowing
def steepest_place(
    data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch, least: float
) -> tuple[float, float, float]:
    """Largest D(theta), nat, its place, mm, and the largest gain bound of all places.

    Where random values are not uniform, the place is that of the largest gain of the best share, all else held. Gain
    bounds are computed only while the largest one is below `least`.
    """
    mix(data, k, fit, beam, scratch)
    values, n, m = data.value, data.total, len(data.value)
    for j in range(m):
        scratch[SHARE, j] = data.times[j] / scratch[TOTAL, j]
    outliers = beam.outlier_density * total_of(scratch[SHARE, :m])
    if not is_uniform(beam):
        outliers = product_of(scratch[RANDOM, :m], scratch[SHARE, :m])
    most, place, bound, nearest, norms = -n, values[0], 0.0, -1, (0.0, 0.0, 0.0)
    uniform, largest = is_uniform(beam), 0.0
    near, past = 0, 0
    theta = values[0] - sigma_at(values[0], beam.curve_range, beam.curve_sigma)
    end = values[-1] + sigma_at(values[-1], beam.curve_range, beam.curve_sigma)
    if math.isinf(beam.no_return_to):
        end = min(end, beam.surface_end)
    reach = 5.0  # a surface lends samples farther away than this, in sigmas, less than 4e-6 of its peak
    while theta <= end:
        sigma = sigma_at(theta, beam.curve_range, beam.curve_sigma)
        near, past = within_reach(values, near, past, theta - reach * sigma, theta + reach * sigma)
        next_theta = theta + SEARCH_STEP * sigma
        if near == past and near < m:
            next_theta = max(next_theta, values[near] - sigma)  # nothing near: go to the next sample
        first, stop = whole_lanes(near, past, m)
        value, new = values[first:stop], scratch[SPARE, : stop - first]
        scale, height = 1.0 / sigma, (1.0 - beam.p_outlier) / (sigma * ROOT_TWO_PI)
        for j in range(len(value)):
            z = (value[j] - theta) * scale
            new[j] = height * exp_minus(0.5 * z * z)  # p(r_j | surface at theta), but for c_r
        slope = product_of(new, scratch[SHARE, first:stop]) + outliers - n
        is_place = not is_beyond(theta, beam)
        if uniform and is_place and slope > most:
            most, place = slope, theta
        if not uniform and is_place and slope >= least and past - near > 1:
            # The slope is largest where background is rarest, and a single sample, as background, is no surface.
            gain = _gain_of_place(data, first, stop, scratch)
            most, bound = max(most, slope), max(bound, gain)
            if gain > largest:
                largest, place = gain, theta
        if is_place and slope > 0.0 and bound < least:
            if uniform and slope >= least:
                bound = max(bound, _gain_of_place(data, first, stop, scratch))
            if bound < least and k > 0:
                old = _nearest(theta, k, fit)
                if old != nearest:
                    nearest = old
                    norms = _scores(data, old, fit, beam, scratch)
                bound = max(bound, _score_statistic(data, first, stop, slope, norms, scratch))
        theta = next_theta
    return most, place, bound


@borrowing
def _nearest(theta: float, k: int, fit: Components) -> int:
    """Surface nearest to a place, in its sigmas."""
    nearest = 0
    for i in range(1, k):
        if abs(theta - fit[MEAN, i]) / fit[SIGMA, i] < abs(theta - fit[MEAN, nearest]) / fit[SIGMA, nearest]:
            nearest = i
    return nearest


@borrowing
def _gain_of_place(data: Readings, first: int, stop: int, scratch: Scratch) -> float:
    """Gain, nat, of the best share of a new surface whose densities at values [first, stop) are in scratch[SPARE]."""
    count, total = data.times[first:stop], scratch[TOTAL, first:stop]
    new, term = scratch[SPARE, : stop - first], scratch[OTHER, : stop - first]
    outside, share = data.total - total_of(count), 1.0 / data.total
    for _ in range(QUICK_STEPS):
        for j in range(len(count)):
            excess = new[j] - total[j]
            term[j] = excess / (total[j] + share * excess)
        lost = 1.0 / (1.0 - share)
        slope = product_of(term, count) - outside * lost
        for j in range(len(count)):
            term[j] *= term[j]
        bend = product_of(term, count) + outside * lost * lost
        share = next_share(share, slope, bend)
    for j in range(len(count)):
        term[j] = log_of(1.0 + share * (new[j] / total[j] - 1.0))
    return float(product_of(term, count) + outside * math.log(1.0 - share))


@borrowing
def _scores(data: Readings, i: int, fit: Components, beam: Beam, scratch: Scratch) -> tuple[float, float, float]:
    """Fill rows MEAN_SCORE and SHARE_SCORE with the derivatives of log p(r_j) by the mean and share of surface i.

    Return the sums of their squares and of their product.
    """
    m = len(data.value)
    by_mean, by_share, density = scratch[MEAN_SCORE, :m], scratch[SHARE_SCORE, :m], scratch[DENSITY + i]
    total, term = scratch[TOTAL], scratch[OTHER, :m]
    scale, weight = 1.0 / fit[SIGMA, i], fit[WEIGHT, i]
    for j in range(m):
        ratio = density[j] / total[j]
        by_mean[j] = weight * ratio * (data.value[j] - fit[MEAN, i]) * scale
        by_share[j] = (1.0 - beam.p_outlier) * ratio - 1.0
    for j in range(m):
        term[j] = data.times[j] * by_mean[j]
    squares, cross = product_of(term, by_mean), product_of(term, by_share)
    for j in range(m):
        term[j] = data.times[j] * by_share[j]
    return squares, product_of(term, by_share), cross


@borrowing
def _score_statistic(
    data: Readings, first: int, stop: int, slope: float, norms: tuple[float, float, float], scratch: Scratch
) -> float:
    """Half the squared score of a new surface's share, over its information minus the part that `_scores` explains."""
    share, total = scratch[SHARE, first:stop], scratch[TOTAL, first:stop]
    new, term = scratch[SPARE, : stop - first], scratch[OTHER, : stop - first]
    for j in range(len(share)):
        term[j] = new[j] * share[j]
    overlap = total_of(term)
    by_mean = product_of(term, scratch[MEAN_SCORE, first:stop])
    by_share = product_of(term, scratch[SHARE_SCORE, first:stop])
    for j in range(len(share)):
        term[j] *= new[j] / total[j]
    information = total_of(term) - 2.0 * overlap + data.total
    mean_norm, share_norm, cross = norms
    if mean_norm > LEAST_INFORMATION * data.total:
        information -= by_mean * by_mean / mean_norm
        share_norm -= cross * cross / mean_norm
        by_share -= cross * by_mean / mean_norm
    if share_norm > LEAST_INFORMATION * data.total:
        information -= by_share * by_share / share_norm
    return 0.5 * slope * slope / max(information, LEAST_INFORMATION * data.total)


@borrowing
def best_share(data: Readings, place: float, beam: Beam, scratch: Scratch) -> float:
    """Share of a new surface at `place` that raises the likelihood most, all else scaled down; by Newton's steps.

    scratch[TOTAL] holds p(r_j), as `steepest_place` leaves it.
    """
    sigma = sigma_at(place, beam.curve_range, beam.curve_sigma)
    m = len(data.value)
    term, share = scratch[OTHER, :m], 1.0 / data.total
    uniform = is_uniform(beam)
    gaussians(data.value, place, sigma, scratch[SPARE])
    for _ in range(LAST_STEPS):
        for j in range(m):
            new = scratch[SPARE, j] + (beam.outlier_density if uniform else scratch[RANDOM, j])
            term[j] = (new - scratch[TOTAL, j]) / ((1.0 - share) * scratch[TOTAL, j] + share * new)
        slope = product_of(term, data.times)
        for j in range(m):
            term[j] *= term[j]
        bend = product_of(term, data.times) + LEAST_BEND
        share = next_share(share, slope, bend)
    return share


SURFACE_SIGMAS = 4.0
"""Samples this near to a surface belong to it alone, where no other surface is within twice that distance."""

_STEP = 0.75
"""Distance between the places of a trial surface, in sigmas."""


_ROOT = math.exp(_STEP * SURFACE_SIGMAS)


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
    steps = 6  # places on either side: up to 4.5 sigma
    # Where one sample has such a part in a new surface, the score statistic falls short, and the gain is worked out.
    heavy = 0.5
    for side in range(2):
        for j in range(m):
            power[j] = 1.0
        if side == 1:
            for j in range(m):
                base[j] = 1.0 / base[j]
        farthest = z[m - 1] if side == 0 else -z[0]
        for step in range(1, steps + 1):
            delta = _STEP * step
            scale = math.exp(-0.5 * delta * delta)
            new, by_mean, square = _next_power(power, base, z, count)
            slope = scale * new - own.total  # D
            if slope <= 0.0:
                continue
            information = scale * scale * square - 2.0 * scale * new + own.total
            if squares > 0.0 and free_mean > 0.0:
                information -= scale * scale * by_mean * by_mean / squares
            information = max(information, LEAST_INFORMATION * own.total)
            bound = max(bound, 0.5 * slope * slope / information)
            if bound < least and slope * scale * math.exp(delta * farthest) > heavy * information:
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
    for _ in range(QUICK_STEPS):
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
