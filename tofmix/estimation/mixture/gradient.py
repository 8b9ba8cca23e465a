"""Place of one more surface of a mixture, and a bound of its gain.

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

from tofmix.compiled.jit import borrowing
from tofmix.compiled.vector import exp_minus, log_of, product_of, total_of
from tofmix.estimation.beam import Beam, is_beyond, is_uniform
from tofmix.estimation.mixture.components import (
    DENSITY,
    MEAN,
    MEAN_SCORE,
    OTHER,
    RANDOM,
    SHARE,
    SHARE_SCORE,
    SIGMA,
    SPARE,
    TOTAL,
    WEIGHT,
    Components,
    Scratch,
)
from tofmix.estimation.mixture.em import ROOT_TWO_PI, gaussians, mix
from tofmix.estimation.mixture.share_step import LEAST_BEND, next_share
from tofmix.estimation.noise.kernel import sigma_at
from tofmix.estimation.reach import whole_lanes, within_reach
from tofmix.estimation.samples import Readings

_STEP = 0.5
"""Step of the search in sigmas: a quarter of a sigma off the best place, a surface gains 3 % less."""

_REACH = 5.0
"""A surface lends samples farther away than this, in sigmas, less than 4e-6 of its peak."""

_NEWTON_STEPS = 6
"""Newton steps of the best share at the place that is taken: the share is then exact to rounding."""

_QUICK_STEPS = 3
"""Newton steps of the best share at each place that is compared: the order of places needs no more."""

_LEAST_NORM = 1.0e-6
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
    while theta <= end:
        sigma = sigma_at(theta, beam.curve_range, beam.curve_sigma)
        near, past = within_reach(values, near, past, theta - _REACH * sigma, theta + _REACH * sigma)
        next_theta = theta + _STEP * sigma
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
            gain = _gain_of_best_share(data, first, stop, scratch)
            most, bound = max(most, slope), max(bound, gain)
            if gain > largest:
                largest, place = gain, theta
        if is_place and slope > 0.0 and bound < least:
            if uniform and slope >= least:
                bound = max(bound, _gain_of_best_share(data, first, stop, scratch))
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
def _gain_of_best_share(data: Readings, first: int, stop: int, scratch: Scratch) -> float:
    """Gain, nat, of the best share of a new surface whose densities at values [first, stop) are in scratch[SPARE]."""
    count, total = data.times[first:stop], scratch[TOTAL, first:stop]
    new, term = scratch[SPARE, : stop - first], scratch[OTHER, : stop - first]
    outside, share = data.total - total_of(count), 1.0 / data.total
    for _ in range(_QUICK_STEPS):
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
    if mean_norm > _LEAST_NORM * data.total:
        information -= by_mean * by_mean / mean_norm
        share_norm -= cross * cross / mean_norm
        by_share -= cross * by_mean / mean_norm
    if share_norm > _LEAST_NORM * data.total:
        information -= by_share * by_share / share_norm
    return 0.5 * slope * slope / max(information, _LEAST_NORM * data.total)


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
    for _ in range(_NEWTON_STEPS):
        for j in range(m):
            new = scratch[SPARE, j] + (beam.outlier_density if uniform else scratch[RANDOM, j])
            term[j] = (new - scratch[TOTAL, j]) / ((1.0 - share) * scratch[TOTAL, j] + share * new)
        slope = product_of(term, data.times)
        for j in range(m):
            term[j] *= term[j]
        bend = product_of(term, data.times) + LEAST_BEND
        share = next_share(share, slope, bend)
    return share
