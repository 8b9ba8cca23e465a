"""How many surfaces one pixel's samples show, under the learnt noise: each must gain its threshold in likelihood.

A count starts without any surface: background, and c_0 where samples reach r_max. The first surface is tried where most
samples lie together; each further one where the likelihood rises most, and by splitting the most spread surface in
two. Where pixels have widths of their own, each trial starts from the pixel's width and from the common one too: a
pair of surfaces is otherwise taken for one wide surface. Then surfaces that are not missed are taken out. Gains are
differences of the objective (`fitting.objective`), priors included; `thresholds` says which of them noise reaches.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import log_of, product_of, total_of
from tofmix.estimation.beam import NO_RETURN_REACH, Beam, is_beyond
from tofmix.estimation.learnt.fitting import (
    BACKGROUND,
    DENSITY,
    DRIFT,
    GAIN,
    LOG_WIDTH,
    MEAN,
    NEW,
    OWN,
    ROWS,
    SCORES,
    SHARE,
    SIGMA,
    SUPPORT,
    TOTAL,
    WEIGHT,
    Samples,
    background_density,
    capacity_of,
    copy_fit,
    drifts,
    log_priors,
    maximise,
    mix,
    new_fit,
    new_scratch,
    objective,
    slope_row,
    still_row,
    value_of,
)
from tofmix.estimation.learnt.law import Law, at_table, precision_of_t
from tofmix.estimation.learnt.steps import value_of_jump
from tofmix.estimation.mixture.counting import COUNT_ITER, COUNT_TOL, LEAST_BOUND, MIN_SUPPORT, SPLIT_SIGMAS
from tofmix.estimation.mixture.false_alarms import least_gain
from tofmix.estimation.mixture.share_step import LARGEST_SHARE, LEAST_BEND, next_share
from tofmix.estimation.noise.kernel import sigma_at
from tofmix.learnt_noise import DRIFTS

CLOSE = 1.2
"""Half the width, in sigmas, of the window in which most samples lie together: it holds 77 % of a surface's."""

OWN_SIGMAS = 2.0
"""A width or a drift that is this many standard errors from none may stand for a further surface."""

CERTAIN_SUPPORT, CERTAIN_GAIN = 5.0, 40.0
"""A surface whose loss costs more nats than the second, told by its samples' share in p, is not taken out to see."""

NEAR_NO_RETURN = 5.0
"""Sigmas within which c_0 and a surface may stand for the same samples."""

_STEEPEST, _SPLIT, _PLAIN = 0, 1, 2  # starts of one surface more
_STEP = 0.5  # sigmas between the places where a new surface is tried
_QUICK_STEPS = 3  # Newton steps for the share of a new surface in a gain bound; twice as many before a fit
_LEAST_SHARE = 1.0e-9  # where less share is left, the other shares are not scaled up
_LEAST_INFORMATION = 1.0e-6  # least information by sample; less is rounding


class Thresholds(NamedTuple):
    """Gains, nat, that noise exceeds with each of `false_alarms.FALSE_ALARMS`.

    `more` (samples, background, chance) for a further surface, by the logarithm of the number of samples `log_n`
    (samples,) and the background's share `background` (background,); `first` (samples, chance) for the first surface
    beside background alone.
    """

    log_n: FloatArray
    background: FloatArray
    more: FloatArray
    first: FloatArray


class Rules(NamedTuple):
    """When a surface stands: the wanted chance of a false alarm, c_0's least gain beside a surface, the most layers."""

    false_alarm: float
    no_return_gain: float
    max_layers: int


class Workspace(NamedTuple):
    """Three fits (what stands, what is tried, the best of the tries), their common scratch, and a row of gains."""

    fit: FloatArray
    trial: FloatArray
    best: FloatArray
    scratch: FloatArray
    gains: FloatArray


@jit
def new_workspace(capacity: int, samples: int, chances: int) -> Workspace:
    """Make what the kernels work in, for pixels of up to so many surfaces and samples."""
    return Workspace(
        new_fit(capacity), new_fit(capacity), new_fit(capacity), new_scratch(capacity, samples), np.zeros(chances)
    )


@borrowing
def _place_in(x: float, known: FloatArray) -> tuple[int, float]:
    """Interval of ascending `known` that holds x, and where in it, 0 to 1; held past the ends."""
    last = len(known) - 1
    if last == 0 or x <= known[0]:
        return 0, 0.0
    if x >= known[last]:
        return last - 1, 1.0
    at = 0
    while known[at + 1] < x:
        at += 1
    return at, (x - known[at]) / (known[at + 1] - known[at])


@borrowing
def read_gains(n: float, background: float, first: bool, thresholds: Thresholds, out: FloatArray) -> None:
    """Fill `out` (chance,) with the gains of so many samples and this share of background."""
    a, s = _place_in(math.log(n), thresholds.log_n)
    above = min(a + 1, len(thresholds.log_n) - 1)
    if first:
        for c in range(len(out)):
            out[c] = (1.0 - s) * thresholds.first[a, c] + s * thresholds.first[above, c]
        return
    b, t = _place_in(background, thresholds.background)
    right = min(b + 1, len(thresholds.background) - 1)
    for c in range(len(out)):
        low = (1.0 - t) * thresholds.more[a, b, c] + t * thresholds.more[a, right, c]
        high = (1.0 - t) * thresholds.more[above, b, c] + t * thresholds.more[above, right, c]
        out[c] = (1.0 - s) * low + s * high


@borrowing
def _wanted(n: float, k: int, fit: FloatArray, work: Workspace, thresholds: Thresholds, rules: Rules) -> float:
    """Gain, nat, that a surface beside `k` others must have."""
    read_gains(n, fit[OWN, BACKGROUND], k == 0, thresholds, work.gains)
    return least_gain(rules.false_alarm, work.gains)


@borrowing
def _densest(y: FloatArray, n: int, beam: Beam) -> tuple[float, float]:
    """Where most of `n` ascending samples lie together: the mean and number of those in the window."""
    most, place, stop = 0.0, y[0], 0
    sum_inside, first = 0.0, 0
    for first in range(n):
        end = y[first] + 2.0 * CLOSE * sigma_at(y[first], beam.curve_range, beam.curve_sigma)
        while stop < n and y[stop] <= end:
            sum_inside += y[stop]
            stop += 1
        inside = float(stop - first)
        if inside > most and not is_beyond(sum_inside / inside, beam):
            most, place = inside, sum_inside / inside
        sum_inside -= y[first]
    return place, most


@borrowing
def start_empty(data: Samples, fit: FloatArray, beam: Beam) -> None:
    """Fill `fit` with no surface: background, and c_0 where samples reach r_max."""
    n = len(data.value)
    for row in range(ROWS):
        for i in range(len(fit[row])):
            fit[row, i] = 0.0
    near = 0.0
    if math.isfinite(beam.range_max):
        for j in range(n):
            if abs(data.value[j] - beam.range_max) < NO_RETURN_REACH * beam.sigma_max:
                near += 1.0
    share = near / n
    fit[OWN, BACKGROUND] = 1.0 if near == 0.0 else max(1.0 - share, 1.0 / n)
    fit[WEIGHT, -1] = 0.0 if near == 0.0 else 1.0 - fit[OWN, BACKGROUND]


@borrowing
def _add(k: int, place: float, share: float, fit: FloatArray, beam: Beam) -> int:
    """Add a surface with this share, all others and the background scaled down; return k + 1."""
    for i in range(k):
        fit[WEIGHT, i] *= 1.0 - share
    fit[WEIGHT, -1] *= 1.0 - share
    fit[OWN, BACKGROUND] *= 1.0 - share
    fit[MEAN, k], fit[WEIGHT, k] = place, share
    for d in range(DRIFTS):
        fit[DRIFT + d, k] = 0.0
    fit[SIGMA, k] = sigma_at(place, beam.curve_range, beam.curve_sigma)
    return k + 1


@borrowing
def remove(k: int, index: int, fit: FloatArray) -> int:
    """Close the gap that surface `index` leaves; its share goes to all others. Return k - 1."""
    weight = fit[WEIGHT, index]
    for row in range(OWN):
        for i in range(index, k - 1):
            fit[row, i] = fit[row, i + 1]
    left = 1.0 - weight
    if k == 1 and fit[WEIGHT, -1] == 0.0:
        fit[OWN, BACKGROUND] = 1.0
        _forget_own(fit)
    elif left > _LEAST_SHARE:
        for i in range(k - 1):
            fit[WEIGHT, i] /= left
        fit[WEIGHT, -1] /= left
        fit[OWN, BACKGROUND] /= left
    return k - 1


@borrowing
def settle(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Fit as far as a comparison of likelihoods needs; return the objective, nat."""
    maximise(data, k, fit, law, beam, COUNT_ITER, COUNT_TOL, scratch)
    return value_of(data, k, fit, law, beam, scratch)


@borrowing
def _scores_of(
    data: Samples, own: int, fit: FloatArray, law: Law, scratch: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Fill three rows from SCORES on with the scores of surface `own`'s mean, share and width; after `mix`.

    Row SHARE holds 1 / p. Return the factors of the Cholesky decomposition of their sums of products: l00, l10, l20,
    l11, l21, l22; 0 on the diagonal where a direction is none.
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
            c[j] = weight * ((y[j] - fit[MEAN, own]) * scale * slope[j] - density[j]) * share[j]
        s02, s12, s22 = product_of(a, c), product_of(b, c), product_of(c, c)
        s22 += precision_of_t(0.0, law.width_spread)
    else:
        for j in range(n):
            c[j] = 0.0
    least = _LEAST_INFORMATION * n
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
    """Distance to a surface, in its sigmas."""
    return float(abs(theta - fit[MEAN, i]) / fit[SIGMA, i])


@borrowing
def _nearest(theta: float, k: int, fit: FloatArray) -> int:
    """Surface nearest to a place, in its sigmas; -1 without any."""
    nearest = -1
    for i in range(k):
        if nearest < 0 or _sigmas_to(theta, i, fit) < _sigmas_to(theta, nearest, fit):
            nearest = i
    return nearest


@borrowing
def _best_share(ratio: FloatArray, outside: float, steps: int) -> float:
    """Share of a new surface that raises the likelihood most; `ratio` is its density by p at the samples near it.

    At `outside` other samples its density is 0. It starts from one sample's share. The kernels of `mixture` go their
    own way: they count equal samples once, and add in another order, which would change the last bits.
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
    """Gain, nat, of the best share of a new surface, of `n` samples of which `ratio` has those near it."""
    outside = n - len(ratio)
    part = _best_share(ratio, outside, _QUICK_STEPS)
    gain = outside * math.log(1.0 - part)
    for j in range(len(ratio)):
        gain += log_of(1.0 + part * (ratio[j] - 1.0))
    return gain


@borrowing
def steepest_place(
    data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray, least: float
) -> tuple[float, float, float]:
    """Largest slope D(theta) of the log likelihood by a new surface's share, nat, its place, the largest gain bound.

    A gain bound estimates the gain of a surface there: that of its best share, or, where it takes the place of an old
    one, half the squared score, less what the old one's mean, share and width explain, by its information. Bounds are
    computed while the largest is below `least`. `mix` has been called.

    References
    ----------
    Lindsay, Annals of Statistics 11(1), 1983, doi:10.1214/aos/1176346059; Cox and Hinkley, Theoretical Statistics,
    1974, section 9.3.
    """
    n = len(data.value)
    y, share, new = data.value, scratch[SHARE], scratch[NEW]
    for j in range(n):
        share[j] = 1.0 / scratch[TOTAL, j]
    width = math.exp(fit[OWN, LOG_WIDTH])
    most, place, bound, nearest = -float(n), y[0], 0.0, -1
    l00, l10, l20, l11, l21, l22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    near, past = 0, 0
    theta = y[0] - sigma_at(y[0], beam.curve_range, beam.curve_sigma)
    end = y[n - 1] + sigma_at(y[n - 1], beam.curve_range, beam.curve_sigma)
    if math.isinf(beam.no_return_to):
        end = min(end, beam.surface_end)
    while theta <= end:
        sigma = width * sigma_at(theta, beam.curve_range, beam.curve_sigma)
        while near < n and y[near] < theta + law.low * sigma:
            near += 1
        past = max(past, near)
        while past < n and y[past] <= theta + law.high * sigma:
            past += 1
        here, theta = theta, theta + _STEP * sigma
        if near == past and near < n:
            theta = max(theta, y[near] - sigma)  # nothing near: go to the next sample
            continue
        if is_beyond(here, beam):
            continue
        inside, scale = past - near, 1.0 / sigma
        seen, fresh = share[near:past], new[:inside]
        for j in range(inside):
            fresh[j] = at_table((y[near + j] - here) * scale, law.density) * scale * seen[j]
        overlap = total_of(fresh)
        slope = overlap - n
        if slope > most:
            most, place = slope, here
        if slope <= 0.0 or bound >= least:
            continue
        if slope >= least:
            bound = max(bound, _gain_of_share(fresh, float(n)))
        if bound < least and k > 0:
            own = _nearest(here, k, fit)
            if own != nearest:
                nearest = own
                l00, l10, l20, l11, l21, l22 = _scores_of(data, own, fit, law, scratch)
            p0 = product_of(fresh, scratch[SCORES, near:past])
            p1 = product_of(fresh, scratch[SCORES + 1, near:past])
            p2 = product_of(fresh, scratch[SCORES + 2, near:past]) if law.width_spread > 0.0 else 0.0
            information = product_of(fresh, fresh) - 2.0 * overlap + n
            q0 = p0 / l00 if l00 > 0.0 else 0.0
            q1 = (p1 - l10 * q0) / l11 if l11 > 0.0 else 0.0
            q2 = (p2 - l20 * q0 - l21 * q1) / l22 if l22 > 0.0 else 0.0
            information -= q0 * q0 + q1 * q1 + q2 * q2
            bound = max(bound, 0.5 * slope * slope / max(information, _LEAST_INFORMATION * n))
    return most, place, bound


@borrowing
def _share_at(data: Samples, place: float, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Share of a new surface at a place: the samples near it that others do not explain, at least one."""
    sigma = math.exp(fit[OWN, LOG_WIDTH]) * sigma_at(place, beam.curve_range, beam.curve_sigma)
    y, ratio = data.value, scratch[NEW, : len(data.value)]
    for j in range(len(ratio)):
        ratio[j] = at_table((y[j] - place) / sigma, law.density) / sigma / scratch[TOTAL, j]
    return _best_share(ratio, 0.0, _QUICK_STEPS + _QUICK_STEPS)


@borrowing
def _most_spread(data: Samples, k: int, fit: FloatArray, law: Law, scratch: FloatArray) -> int:
    """Surface whose samples spread most beyond its width, by the score of log width; after `mix`."""
    most, largest, slopes = 0, -math.inf, slope_row(fit)
    width = math.exp(fit[OWN, LOG_WIDTH])
    for i in range(k):
        excess, support = 0.0, 0.0
        y = scratch[still_row(fit) + i, : len(data.value)] if drifts(law) > 0 else data.value
        for j in range(len(data.value)):
            part = fit[WEIGHT, i] / scratch[TOTAL, j]
            support += part * scratch[DENSITY + i, j]
            excess += part * scratch[slopes + i, j] * (y[j] - fit[MEAN, i])
        excess = (excess / (width * fit[SIGMA, i]) - support) / math.sqrt(max(support, 1.0))
        if excess > largest:
            most, largest = i, excess
    return most


@borrowing
def _stands(k: int, fit: FloatArray, beam: Beam) -> bool:
    """Whether every surface may be one: within the working range, and of more than a sample."""
    for i in range(k):  # noqa: SIM110  numba compiles no generator expression
        if is_beyond(fit[MEAN, i], beam) or fit[SUPPORT, i] < MIN_SUPPORT:
            return False
    return True


@borrowing
def first_surface(data: Samples, work: Workspace, law: Law, beam: Beam) -> tuple[float, float]:
    """Fit one surface beside work.fit, which has none; return its gain and the objective without it, nat.

    The fit with the surface is in work.best.
    """
    fit, _, best, scratch, _ = work
    n = len(data.value)
    before = settle(data, 0, fit, law, beam, scratch)
    place, together = _densest(data.value, n, beam)
    copy_fit(fit, best)
    _add(0, place, min(together / n, LARGEST_SHARE), best, beam)
    found = settle(data, 1, best, law, beam, scratch)
    return (found - before if _stands(1, best, beam) else -math.inf), before


@borrowing
def _moves(i: int, fit: FloatArray, law: Law, n: float) -> bool:
    """Whether the drift of a surface of `n` samples stands out of chance."""
    sigma = math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, i]
    square = 0.0
    for d in range(DRIFTS):
        square += fit[DRIFT + d, i] ** 2 / (2.0 * d + 3.0)  # mean square of the polynomial
    return bool(square > (OWN_SIGMAS * sigma) ** 2 / (law.information * n))


@jit
def gain_of_jump(data: Samples, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Log likelihood, nat, that one jump gains over the drift of a fit of one surface; 0 where it does not drift."""
    if not _moves(0, fit, law, max(fit[SUPPORT, 0], 1.0)):
        return 0.0
    drifting = value_of(data, 1, fit, law, beam, scratch) - log_priors(1, fit, law)
    return value_of_jump(data, fit, law, beam) - drifting


@borrowing
def _may_hide_a_surface(k: int, fit: FloatArray, law: Law, n: int) -> bool:
    """Whether the pixel's own width or drift stands out of chance: it may be there for a surface that is not."""
    if law.width_spread > 0.0 and fit[OWN, LOG_WIDTH] > OWN_SIGMAS / math.sqrt(law.width_information * n):
        return True
    for i in range(k):  # noqa: SIM110  likewise
        if _moves(i, fit, law, max(fit[SUPPORT, i], 1.0)):
            return True
    return False


@borrowing
def _widest_plain(data: Samples, k: int, fit: FloatArray, trial: FloatArray, scratch: FloatArray) -> tuple[int, float]:
    """Move each surface of `trial` to the mean of its samples without drift; return the widest and half its split.

    Two equal surfaces at +-d about their mean have the variance sigma^2 + d^2.
    """
    n, chosen, apart = len(data.value), 0, 0.0
    for i in range(k):
        support, total, squares = 1.0e-12, 0.0, 0.0
        for j in range(n):
            part = fit[WEIGHT, i] * scratch[DENSITY + i, j] / scratch[TOTAL, j]
            support += part
            total += part * data.value[j]
        mean = total / support
        for j in range(n):
            part = fit[WEIGHT, i] * scratch[DENSITY + i, j] / scratch[TOTAL, j]
            squares += part * (data.value[j] - mean) ** 2
        trial[MEAN, i] = mean
        wider = math.sqrt(max(squares / support - fit[SIGMA, i] ** 2, (SPLIT_SIGMAS * fit[SIGMA, i]) ** 2))
        if wider > apart:
            chosen, apart = i, wider
    return chosen, apart


@borrowing
def _forget_own(fit: FloatArray) -> None:
    """Set the common width and no drift."""
    fit[OWN, LOG_WIDTH] = 0.0
    for d in range(DRIFTS):
        for i in range(len(fit[DRIFT])):
            fit[DRIFT + d, i] = 0.0


@borrowing
def try_one_more(data: Samples, k: int, work: Workspace, law: Law, beam: Beam, wanted: float) -> float:
    """Fit one more surface than work.fit has, k > 0; return its gain, nat, with the fit in work.best.

    The gain is 0 where its bound is below `LEAST_BOUND` of the wanted gain, or the new fit has something that is no
    surface.
    """
    fit, trial, best, scratch, _ = work
    if k + 1 > capacity_of(fit):
        return 0.0
    mix(data, k, fit, law, beam, scratch)
    before = objective(data, k, fit, law, scratch)
    slope, place, bound = steepest_place(data, k, fit, law, beam, scratch, LEAST_BOUND * wanted)
    may_gain = slope >= wanted and bound >= LEAST_BOUND * wanted
    plain = _may_hide_a_surface(k, fit, law, len(data.value))
    if not may_gain and not plain:
        return 0.0
    share = _share_at(data, place, fit, law, beam, scratch)
    spread = _most_spread(data, k, fit, law, scratch)
    gain = 0.0
    for start in (_STEEPEST, _SPLIT, _PLAIN):
        if (start == _PLAIN and not plain) or (start != _PLAIN and not may_gain):
            continue
        copy_fit(fit, trial)
        if start == _STEEPEST:
            _add(k, place, share, trial, beam)
        else:
            apart = SPLIT_SIGMAS * fit[SIGMA, spread] * math.exp(fit[OWN, LOG_WIDTH])
            if start == _PLAIN:
                spread, apart = _widest_plain(data, k, fit, trial, scratch)
                _forget_own(trial)
            _add(k, trial[MEAN, spread] + apart, 0.0, trial, beam)
            trial[MEAN, spread] -= apart
            trial[WEIGHT, spread] *= 0.5
            trial[WEIGHT, k] = trial[WEIGHT, spread]
        found = settle(data, k + 1, trial, law, beam, scratch) - before
        if found > gain and _stands(k + 1, trial, beam):
            gain = found
            copy_fit(trial, best)
    return gain


@borrowing
def _surely_missed(data: Samples, k: int, index: int, fit: FloatArray, beam: Beam, scratch: FloatArray) -> bool:
    """Whether a surface's loss costs many nats, told without a fit; after `mix`.

    Without it, its samples are left to the densities of all else where they stand, or of another surface that moves:
    only one with no other within 12 of the wider's sigmas, and no c_0, is judged.
    """
    if fit[SUPPORT, index] < CERTAIN_SUPPORT:
        return False
    width = math.exp(fit[OWN, LOG_WIDTH])
    apart = 12.0
    for i in range(k):
        if i != index and abs(fit[MEAN, i] - fit[MEAN, index]) < apart * width * max(fit[SIGMA, i], fit[SIGMA, index]):
            return False
    if k == 1 and fit[SUPPORT, index] < 0.5 * len(data.value):
        return False
    if math.isfinite(beam.range_max) and abs(beam.range_max - fit[MEAN, index]) < apart * beam.sigma_max:
        return False
    loss, rest = 0.0, background_density(beam)
    for j in range(len(data.value)):
        own = fit[WEIGHT, index] * scratch[DENSITY + index, j]
        if own > 0.5 * scratch[TOTAL, j]:
            loss += math.log(scratch[TOTAL, j] / max(scratch[TOTAL, j] - own, rest))
    return loss > CERTAIN_GAIN


@borrowing
def gain_of(data: Samples, k: int, index: int, full: float, work: Workspace, law: Law, beam: Beam) -> float:
    """Objective, nat, that work.fit loses without a surface; the fit without it is in work.trial. `full` is its own."""
    fit, trial, _, scratch, _ = work
    copy_fit(fit, trial)
    reach = abs(beam.range_max - fit[MEAN, index]) < NO_RETURN_REACH * beam.sigma_max
    if fit[WEIGHT, -1] == 0.0 and reach:
        trial[WEIGHT, -1] = fit[WEIGHT, index]
    remove(k, index, trial)
    if reach and trial[WEIGHT, -1] > 0.0 and k == 1:
        start_empty(data, trial, beam)
    return full - settle(data, k - 1, trial, law, beam, scratch)


@borrowing
def _without_no_return(data: Samples, k: int, work: Workspace, law: Law, beam: Beam, rules: Rules) -> None:
    """Take c_0 out of work.fit where a surface stands beside it and the samples do not need both."""
    fit, trial, _, scratch, _ = work
    beside = False
    for i in range(k):
        beside = beside or abs(beam.range_max - fit[MEAN, i]) < NEAR_NO_RETURN * beam.sigma_max
    if fit[WEIGHT, -1] == 0.0 or not beside:
        return
    copy_fit(fit, trial)
    left = 1.0 - fit[WEIGHT, -1]
    trial[WEIGHT, -1] = 0.0
    for i in range(k):
        trial[WEIGHT, i] /= left
    trial[OWN, BACKGROUND] /= left
    full = value_of(data, k, fit, law, beam, scratch)
    if full - settle(data, k, trial, law, beam, scratch) < rules.no_return_gain:
        copy_fit(trial, fit)


@borrowing
def _without_spare(
    data: Samples, k: int, work: Workspace, law: Law, beam: Beam, thresholds: Thresholds, rules: Rules
) -> int:
    """Take surfaces out of work.fit until each of several gains what it must; fill row GAIN; return how many stay."""
    fit, _, best, scratch, _ = work
    n = float(len(data.value))
    while k > 1:
        full = value_of(data, k, fit, law, beam, scratch)
        least, weakest = math.inf, -1
        for i in range(k):
            fit[GAIN, i] = math.inf
        for i in range(k):
            mix(data, k, fit, law, beam, scratch)
            if _surely_missed(data, k, i, fit, beam, scratch):
                continue
            fit[GAIN, i] = gain_of(data, k, i, full, work, law, beam)
            if fit[GAIN, i] < least:
                least, weakest = fit[GAIN, i], i
                copy_fit(work.trial, best)
        if weakest < 0 or least >= _wanted(n, k - 1, best, work, thresholds, rules):
            break
        k -= 1
        copy_fit(best, fit)
    return k


@jit
def count_surfaces(
    data: Samples, work: Workspace, laws: tuple[Law, Law], beam: Beam, thresholds: Thresholds, rules: Rules
) -> tuple[int, Law]:
    """Count the surfaces of a pixel; return how many, with their fit, as far as counting needs it, in work.fit.

    Of the two laws the second has no drift; the one that holds for the pixel is returned too. `fill_times` has been
    called. Row GAIN holds what each surface gains, nat; infinite where it is certain.
    """
    fit, best, scratch = work.fit, work.best, work.scratch
    law = laws[0]
    n = float(len(data.value))
    start_empty(data, fit, beam)
    gain, empty = first_surface(data, work, law, beam)
    if gain_of_jump(data, best, law, beam, scratch) > _wanted(n, 1, best, work, thresholds, rules):
        law = laws[1]
        start_empty(data, fit, beam)
        gain, empty = first_surface(data, work, law, beam)
    wanted = _wanted(n, 0, fit, work, thresholds, rules)
    copy_fit(best, fit)
    k = 1
    if gain < wanted:
        # Where background is rare, one surface that leaves others unexplained is no gain: two may be.
        more = _wanted(n, 1, fit, work, thresholds, rules)
        pair = -math.inf
        if fit[SUPPORT, 0] >= MIN_SUPPORT:
            pair = gain + try_one_more(data, 1, work, law, beam, more)
        if pair < wanted + more:
            start_empty(data, fit, beam)
            settle(data, 0, fit, law, beam, scratch)
            return 0, law
        copy_fit(best, fit)
        if rules.max_layers == 1:
            # Of the two, the weaker is left out; the other stands by what both gain.
            remove(2, 0 if fit[WEIGHT, 0] < fit[WEIGHT, 1] else 1, fit)
            settle(data, 1, fit, law, beam, scratch)
            fit[GAIN, 0] = pair - more
            return 1, law
        k = 2
    while k < rules.max_layers:
        wanted = _wanted(n, k, fit, work, thresholds, rules)
        gain = try_one_more(data, k, work, law, beam, wanted)
        if gain < wanted:
            break
        k += 1
        copy_fit(best, fit)
    _without_no_return(data, k, work, law, beam, rules)
    k = _without_spare(data, k, work, law, beam, thresholds, rules)
    if k == 1:
        fit[GAIN, 0] = value_of(data, 1, fit, law, beam, scratch) - empty
    return k, law
