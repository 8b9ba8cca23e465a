"""Place of one more surface under the learnt noise, and a bound of its gain: whether a trial is worth a fit.

The twin of `tofmix.estimation.mixture.gain_bound` for any shape of the error, with a background and a width of the
pixel. D(theta) = sum_j f(r_j | surface at theta) / p(r_j) - n is the slope of the log likelihood as share moves to a
surface at theta. No surface gains more than max D, so that none needs to be tried where max D is below the threshold.

max D is far above the gain where a single sample lies in a surface's tail. The gain bound of a place is nearer to the
gain: the gain of the best share there, all else held; or, where the new surface replaces an old one, the score
statistic, less the part that mean, share and width of the old one explain.

References
----------
Lindsay, The geometry of mixture likelihoods, Annals of Statistics 11(1), 1983, doi:10.1214/aos/1176346059.
Rao's score statistic with nuisance parameters: Cox and Hinkley, Theoretical Statistics, 1974, section 9.3.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.vector import log_of, product_of, total_of
from tofmix.estimation.beam import Beam, is_beyond, is_uniform, sigma_at
from tofmix.estimation.learnt.components import (
    CELL,
    DENSITY,
    LOG_WIDTH,
    MEAN,
    NEW,
    OWN,
    SCORES,
    SHARE,
    SIGMA,
    TOTAL,
    WEIGHT,
    Samples,
    slope_row,
    still_row,
)
from tofmix.estimation.learnt.em import drifts
from tofmix.estimation.learnt.law import Law, density_at, fill_edges, has_steps, precision_of_t, step_at
from tofmix.estimation.mixture.gain_bound import (
    LAST_STEPS,
    LEAST_BEND,
    LEAST_INFORMATION,
    QUICK_STEPS,
    SEARCH_STEP,
    next_share,
)


@borrowing
def _best_share(ratio: FloatArray, outside: float, steps: int) -> float:
    """Share of a new surface that raises the likelihood most, all else held.

    Newton's method, from the share of one sample; `mixture.share_step` says why this loop is not that of others.
    `ratio` (m,) is the density of the new surface by p(r_j) at the samples near it; at `outside` other samples its
    density is 0.
    """
    part = 1.0 / (len(ratio) + outside)
    for _ in range(steps):
        slope, bend = 0.0, LEAST_BEND
        for j in range(len(ratio)):
            excess = ratio[j] - 1.0
            term = excess / (1.0 + part * excess)
            slope += term
            bend += term * term
        lost = 1.0 / (1.0 - part)
        slope -= outside * lost
        bend += outside * lost * lost
        part = next_share(part, slope, bend)
    return part


@borrowing
def _gain_of_share(ratio: FloatArray, n: float) -> float:
    """Gain, nat, of the best share of a new surface in `n` samples; `ratio` as for `_best_share`."""
    outside = n - len(ratio)
    part = _best_share(ratio, outside, QUICK_STEPS)
    gain = outside * math.log(1.0 - part)
    for j in range(len(ratio)):
        gain += log_of(1.0 + part * (ratio[j] - 1.0))
    return gain


@borrowing
def _fill_scores(
    data: Samples, own: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Fill three rows from SCORES on with each sample's score for the mean, share and width of surface `own`.

    `mix` has been called, and row SHARE holds 1 / p. Return the Cholesky factor of the scores' sums of products: l00,
    l10, l20, l11, l21, l22, with 0 on the diagonal where a direction has no information.
    """
    n, own_width = len(data.value), math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, own]
    weight, share = fit[WEIGHT, own], scratch[SHARE, :n]
    density, slope = scratch[DENSITY + own], scratch[slope_row(fit) + own]
    y = scratch[still_row(fit) + own, :n] if drifts(law) > 0 else data.value
    a, b, c = scratch[SCORES, :n], scratch[SCORES + 1, :n], scratch[SCORES + 2, :n]
    for j in range(n):
        a[j] = weight * slope[j] * share[j]
        b[j] = density[j] * share[j] - 1.0
    s00, s01, s11 = product_of(a, a), product_of(a, b), product_of(b, b)
    s02, s12, s22 = 0.0, 0.0, 0.0
    if law.width_spread > 0.0:
        scale = 1.0 / own_width
        for j in range(n):
            c[j] = density[j]
        if has_steps(beam):
            fill_edges(y, scratch[CELL], fit[MEAN, own], own_width, law, c)
        for j in range(n):
            c[j] = weight * ((y[j] - fit[MEAN, own]) * scale * slope[j] - c[j]) * share[j]
        s02, s12, s22 = product_of(a, c), product_of(b, c), product_of(c, c)
        s22 += precision_of_t(0.0, law.width_spread)
    else:
        for j in range(n):
            c[j] = 0.0
    least = LEAST_INFORMATION * n
    l00 = math.sqrt(s00) if s00 > least else 0.0
    l10, l20 = (s01 / l00, s02 / l00) if l00 > 0.0 else (0.0, 0.0)
    s11 -= l10 * l10
    l11 = math.sqrt(s11) if s11 > least else 0.0
    l21 = (s12 - l10 * l20) / l11 if l11 > 0.0 else 0.0
    s22 -= l20 * l20 + l21 * l21
    l22 = math.sqrt(s22) if s22 > least else 0.0
    return l00, l10, l20, l11, l21, l22


@borrowing
def _sigmas_to(theta: float, i: int, fit: FloatArray) -> float:
    """Distance of a place, mm, from a surface, in sigmas of the surface."""
    return float(abs(theta - fit[MEAN, i]) / fit[SIGMA, i])


@borrowing
def _nearest(theta: float, k: int, fit: FloatArray) -> int:
    """Index of the surface nearest to a place, mm, in sigmas of each; -1 without surfaces."""
    nearest = -1
    for i in range(k):
        if nearest < 0 or _sigmas_to(theta, i, fit) < _sigmas_to(theta, nearest, fit):
            nearest = i
    return nearest


@borrowing
def steepest_place(  # noqa: PLR0915  one pass over the places
    data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray, least: float
) -> tuple[float, float, float]:
    """Return the largest slope D(theta), nat, its place, mm, and the largest gain bound of all places, nat.

    Where background is not uniform, the place is that of the largest gain of the best share, all else held. Bounds are
    computed while the largest is below `least`, nat. `mix` has been called.
    """
    n = len(data.value)
    y, share, new = data.value, scratch[SHARE], scratch[NEW]
    for j in range(n):
        share[j] = 1.0 / scratch[TOTAL, j]
    width = math.exp(fit[OWN, LOG_WIDTH])
    most, place, bound, nearest = -float(n), y[0], 0.0, -1
    l00, l10, l20, l11, l21, l22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    uniform, largest = is_uniform(beam), 0.0
    near, past = 0, 0
    theta = y[0] - sigma_at(y[0], beam.curve_range, beam.curve_sigma)
    end = y[n - 1] + sigma_at(y[n - 1], beam.curve_range, beam.curve_sigma)
    if math.isinf(beam.no_return_to):
        end = min(end, beam.surface_end)
    while theta <= end:
        sigma = width * sigma_at(theta, beam.curve_range, beam.curve_sigma)
        half = 0.5 * step_at(theta, beam)
        while near < n and y[near] < theta + law.low * sigma - half:
            near += 1
        past = max(past, near)
        while past < n and y[past] <= theta + law.high * sigma + half:
            past += 1
        here, theta = theta, theta + SEARCH_STEP * sigma
        if near == past and near < n:
            theta = max(theta, y[near] - sigma)  # no sample near: go on to the next one
            continue
        if is_beyond(here, beam):
            continue
        inside, scale = past - near, 1.0 / sigma
        seen, fresh = share[near:past], new[:inside]
        for j in range(inside):
            fresh[j] = density_at((y[near + j] - here) * scale, half * scale, law) * scale * seen[j]
        overlap = total_of(fresh)
        slope = overlap - n
        if uniform:
            if slope > most:
                most, place = slope, here
        elif slope >= least and inside > 1:
            # The slope is largest where background is rarest, and a single sample, as background, is no surface.
            gain = _gain_of_share(fresh, float(n))
            most, bound = max(most, slope), max(bound, gain)
            if gain > largest:
                largest, place = gain, here
        if slope <= 0.0 or bound >= least:
            continue
        if uniform and slope >= least:
            bound = max(bound, _gain_of_share(fresh, float(n)))
        if bound < least and k > 0:
            own = _nearest(here, k, fit)
            if own != nearest:
                nearest = own
                l00, l10, l20, l11, l21, l22 = _fill_scores(data, own, fit, law, beam, scratch)
            p0 = product_of(fresh, scratch[SCORES, near:past])
            p1 = product_of(fresh, scratch[SCORES + 1, near:past])
            p2 = product_of(fresh, scratch[SCORES + 2, near:past]) if law.width_spread > 0.0 else 0.0
            information = product_of(fresh, fresh) - 2.0 * overlap + n
            q0 = p0 / l00 if l00 > 0.0 else 0.0
            q1 = (p1 - l10 * q0) / l11 if l11 > 0.0 else 0.0
            q2 = (p2 - l20 * q0 - l21 * q1) / l22 if l22 > 0.0 else 0.0
            information -= q0 * q0 + q1 * q1 + q2 * q2
            bound = max(bound, 0.5 * slope * slope / max(information, LEAST_INFORMATION * n))
    return most, place, bound


@borrowing
def best_share_at(data: Samples, place: float, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Best share of a new surface at a place, mm, all else held. `mix` has been called."""
    sigma = math.exp(fit[OWN, LOG_WIDTH]) * sigma_at(place, beam.curve_range, beam.curve_sigma)
    half = 0.5 * step_at(place, beam) / sigma
    y, ratio = data.value, scratch[NEW, : len(data.value)]
    for j in range(len(ratio)):
        ratio[j] = density_at((y[j] - place) / sigma, half, law) / sigma / scratch[TOTAL, j]
    return _best_share(ratio, 0.0, LAST_STEPS)
