"""Trials of one pixel under the learnt noise: a fit with one surface more or less, and its gain.

A gain is a difference of the objective (`em.objective`), priors included, nat. `counting` decides by gains which
surfaces stay; `bootstrap` and `clusters` make the same trials on drawn pixels and on clusters.

A slow drift of a pixel's range is one surface, a jump within the window is two. A polynomial follows a jump well enough
to have a larger likelihood than two surfaces, whose samples may come in any order. So the drift is compared with one
jump at the best of all times, which has as many free numbers. Where the jump gains as much as a further surface must,
the surfaces of the pixel are counted without drift.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.estimation.beam import NO_RETURN_REACH, Beam, background_at, is_beyond, near_no_return
from tofmix.estimation.learnt.acceleration import maximise, value_of
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    DENSITY,
    DRIFT,
    LOG_WIDTH,
    MEAN,
    OWN,
    RANDOM,
    SIGMA,
    SUPPORT,
    TOTAL,
    WEIGHT,
    Samples,
    add_surface,
    capacity_of,
    clear_width_and_drift,
    copy_fit,
    new_fit,
    new_scratch,
    remove_surface,
    slope_row,
    start_without_surface,
    still_row,
)
from tofmix.estimation.learnt.em import drifts, log_priors, mix, objective
from tofmix.estimation.learnt.gain_bound import best_share_at, steepest_place
from tofmix.estimation.learnt.law import Law, density_at, has_steps, slope_at, spread_at, step_at
from tofmix.estimation.mixture.counting import COUNT_ITER, COUNT_TOL, LEAST_BOUND, MIN_SUPPORT, SPLIT_SIGMAS
from tofmix.estimation.mixture.gain_bound import LARGEST_SHARE
from tofmix.estimation.noise.isolated_clusters import CLOSE
from tofmix.noise_shape import DRIFTS

SIGNIFICANT = 2.0
"""Standard errors from which on a width or a drift exceeds noise, and may stand for a further surface."""


@borrowing
def _side(
    value: FloatArray, start: float, weight: float, background: FloatArray, width: float, half: float, law: Law
) -> float:
    """Log likelihood, nat, of the samples on one side of the jump, at the best range there, from `start`, mm, on.

    `background` is its share times density at each sample, 1/mm, and `half` the half of the step of stored ranges, in
    widths.
    """
    place, total = start, 0.0
    rounds = 8  # steps of scoring for the range on one side of a jump
    for _ in range(rounds):
        push, held, total = 0.0, 0.0, 0.0
        for j in range(len(value)):
            z = (value[j] - place) / width
            density = density_at(z, half, law) / width
            p = weight * density + background[j]
            push += weight * slope_at(z, half, law) / (width * p)
            held += weight * density / p
            total += math.log(p)
        if held < 1.0:
            break
        place += min(max(push / (law.information * held), -1.0), 1.0) * width
    return total


@jit
def value_of_jump(data: Samples, fit: FloatArray, law: Law, beam: Beam) -> float:
    """Log likelihood, nat, of one surface with a jump at the best time, instead of the drift of `fit`.

    Minus infinity where the samples are too few for two sides.
    """
    n = len(data.value)
    width = math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, 0]
    reach = 0.0
    for d in range(DRIFTS):
        reach += abs(fit[DRIFT + d, 0])
    # Samples this near to the drifting surface, in sigmas beyond its drift, determine the time of the jump.
    near_sigmas = 5.0
    reach += near_sigmas * width
    order = np.argsort(data.time)
    value, background = np.empty(n), np.empty(n)
    for j in range(n):
        value[j] = data.value[order[j]]
        background[j] = fit[OWN, BACKGROUND] * background_at(value[j], beam) + 1.0e-30
    inside, total = 0, 0.0
    for j in range(n):
        if abs(value[j] - fit[MEAN, 0]) <= reach:
            inside += 1
            total += value[j]
    before, below, best, at = 0, 0.0, -1.0, -1
    first_mean, second_mean = 0.0, 0.0
    least_after = 2  # least samples on either side of a jump
    for j in range(n):
        if abs(value[j] - fit[MEAN, 0]) > reach:
            continue
        before += 1
        below += value[j]
        after = inside - before
        if before < least_after or after < least_after:
            continue
        between = below * below / before + (total - below) ** 2 / after
        if between > best or at < 0:
            best, at = between, j
            first_mean, second_mean = below / before, (total - below) / after
    if at < 0:
        return -math.inf
    weight = fit[WEIGHT, 0]
    half = 0.5 * step_at(fit[MEAN, 0], beam) / width
    jump = _side(value[: at + 1], first_mean, weight, background[: at + 1], width, half, law)
    jump += _side(value[at + 1 :], second_mean, weight, background[at + 1 :], width, half, law)
    return jump


@borrowing
def drift_exceeds_noise(i: int, fit: FloatArray, law: Law, n: float) -> bool:
    """Whether the drift of a surface of `n` samples exceeds noise: its root mean square over the standard error."""
    sigma = math.exp(fit[OWN, LOG_WIDTH]) * fit[SIGMA, i]
    square = 0.0
    for d in range(DRIFTS):
        square += fit[DRIFT + d, i] ** 2 / (2.0 * d + 3.0)  # mean square of the polynomial
    return bool(square > (SIGNIFICANT * sigma) ** 2 / (law.information * n))


@jit
def gain_of_jump(data: Samples, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Gain in log likelihood, nat, of one jump over the drift in a fit of one surface; 0 where it does not drift."""
    if not drift_exceeds_noise(0, fit, law, max(fit[SUPPORT, 0], 1.0)):
        return 0.0
    drifting = value_of(data, 1, fit, law, beam, scratch) - log_priors(1, fit, law)
    return value_of_jump(data, fit, law, beam) - drifting


CERTAIN_SUPPORT, CERTAIN_GAIN = 5.0, 40.0
"""Least samples of a surface that is kept without a trial, and least loss, nat, without it."""

CERTAIN_SIGMAS = 12.0
"""Distance of such a surface from all others and from c_0, in sigmas of the wider: none can take over its samples."""

_STEEPEST, _SPLIT, _COMMON_NOISE = range(3)  # starts of one surface more


class LearntWorkspace(NamedTuple):
    """Three fits and their common scratch: `fit` is current, `trial` the present trial, `best` the best trial.

    `gains` (probability,) is room for the thresholds of a pixel, nat.
    """

    fit: FloatArray
    trial: FloatArray
    best: FloatArray
    scratch: FloatArray
    gains: FloatArray


@jit
def new_workspace(capacity: int, samples: int, probabilities: int) -> LearntWorkspace:
    """Make a workspace for pixels of up to `capacity` surfaces and `samples` samples."""
    return LearntWorkspace(
        new_fit(capacity), new_fit(capacity), new_fit(capacity), new_scratch(capacity, samples), np.zeros(probabilities)
    )


@borrowing
def settle(data: Samples, k: int, fit: FloatArray, law: Law, beam: Beam, scratch: FloatArray) -> float:
    """Fit as exactly as a comparison of likelihoods needs; return the objective, nat."""
    maximise(data, k, fit, law, beam, COUNT_ITER, COUNT_TOL, scratch)
    return value_of(data, k, fit, law, beam, scratch)


@borrowing
def densest_place(y: FloatArray, n: int, beam: Beam, everywhere: bool) -> tuple[float, float]:
    """Find the window of 2 `CLOSE` sigmas with most of the first `n` samples, ascending, mm.

    Return the mean of its samples, mm, and their number. Without `everywhere`, only means within the working range
    count.
    """
    most, place, stop, sum_inside = 0.0, y[0], 0, 0.0
    for first in range(n):
        end = y[first] + 2.0 * CLOSE * spread_at(y[first], beam)
        while stop < n and y[stop] <= end:
            sum_inside += y[stop]
            stop += 1
        inside = float(stop - first)
        if inside > most and (everywhere or not is_beyond(sum_inside / inside, beam)):
            most, place = inside, sum_inside / inside
        sum_inside -= y[first]
    return place, most


@borrowing
def first_surface(data: Samples, work: LearntWorkspace, law: Law, beam: Beam) -> tuple[float, float]:
    """Fit the first surface; return its gain and the objective without it, nat.

    work.fit has no surface and is fitted too; the fit with the surface is in work.best. The gain is minus infinity
    where the surface has no support, or lies beyond the working range.
    """
    fit, _, best, scratch, _ = work
    n = len(data.value)
    before = settle(data, 0, fit, law, beam, scratch)
    place, together = densest_place(data.value, n, beam, False)  # noqa: FBT003  a kernel's flag
    copy_fit(fit, best)
    add_surface(0, place, min(together / n, LARGEST_SHARE), best, beam)
    found = settle(data, 1, best, law, beam, scratch)
    return (found - before if _all_supported(1, best, beam) else -math.inf), before


@borrowing
def _most_spread(data: Samples, k: int, fit: FloatArray, law: Law, scratch: FloatArray) -> int:
    """Surface whose samples spread most beyond its width, by the score test of log width; `mix` has been called."""
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
def _all_supported(k: int, fit: FloatArray, beam: Beam) -> bool:
    """Whether every surface lies within the working range and has more than one sample."""
    for i in range(k):  # noqa: SIM110  numba compiles no generator expression
        if is_beyond(fit[MEAN, i], beam) or fit[SUPPORT, i] < MIN_SUPPORT:
            return False
    return True


@borrowing
def _may_hide_surface(k: int, fit: FloatArray, law: Law, n: int) -> bool:
    """Whether the pixel's width or a drift exceeds noise: it may stand for a further surface."""
    if law.width_spread > 0.0 and fit[OWN, LOG_WIDTH] > SIGNIFICANT / math.sqrt(law.width_information * n):
        return True
    for i in range(k):  # noqa: SIM110  likewise
        if drift_exceeds_noise(i, fit, law, max(fit[SUPPORT, i], 1.0)):
            return True
    return False


@borrowing
def _widest_without_drift(
    data: Samples, k: int, fit: FloatArray, trial: FloatArray, scratch: FloatArray
) -> tuple[int, float]:
    """Move each surface of `trial` to the mean of its samples without drift; return the widest, and half its split, mm.

    Two equal surfaces at +-d about their mean have the variance sigma^2 + d^2. `mix` has been called for `fit`.
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
def try_one_more(data: Samples, k: int, work: LearntWorkspace, law: Law, beam: Beam, wanted: float) -> float:
    """Fit one more surface than work.fit has, k > 0; return its gain, nat, with the fit in work.best.

    Three starts: at the place where the likelihood rises most; the most spread surface split in two; and, where the
    pixel's width or a drift exceeds noise, the widest surface split in two of the common width without drift. The gain
    is 0 where its bound is below `LEAST_BOUND` of `wanted`, nat, or where no fit has support for all its surfaces.
    """
    fit, trial, best, scratch, _ = work
    if k + 1 > capacity_of(fit):
        return 0.0
    mix(data, k, fit, law, beam, scratch)
    before = objective(data, k, fit, law, scratch)
    slope, place, bound = steepest_place(data, k, fit, law, beam, scratch, LEAST_BOUND * wanted)
    may_gain = slope >= wanted and bound >= LEAST_BOUND * wanted
    hides = _may_hide_surface(k, fit, law, len(data.value))
    if not may_gain and not hides:
        return 0.0
    share = best_share_at(data, place, fit, law, beam, scratch)
    spread = _most_spread(data, k, fit, law, scratch)
    gain = 0.0
    for start in (_STEEPEST, _SPLIT, _COMMON_NOISE):
        if (start == _COMMON_NOISE and not hides) or (start != _COMMON_NOISE and not may_gain):
            continue
        copy_fit(fit, trial)
        if start == _STEEPEST:
            add_surface(k, place, share, trial, beam)
        else:
            apart = SPLIT_SIGMAS * fit[SIGMA, spread] * math.exp(fit[OWN, LOG_WIDTH])
            if start == _COMMON_NOISE:
                spread, apart = _widest_without_drift(data, k, fit, trial, scratch)
                clear_width_and_drift(trial)
            add_surface(k, trial[MEAN, spread] + apart, 0.0, trial, beam)
            trial[MEAN, spread] -= apart
            trial[WEIGHT, spread] *= 0.5
            trial[WEIGHT, k] = trial[WEIGHT, spread]
        found = settle(data, k + 1, trial, law, beam, scratch) - before
        if found > gain and _all_supported(k + 1, trial, beam):
            gain = found
            copy_fit(trial, best)
    return gain


@borrowing
def surely_needed(data: Samples, k: int, index: int, fit: FloatArray, beam: Beam, scratch: FloatArray) -> bool:
    """Whether a surface gains more than `CERTAIN_GAIN` nats, without a fit. `mix` has been called.

    Where no other surface and no c_0 is within `CERTAIN_SIGMAS`, a fit without the surface leaves its samples to the
    densities of all else as these stand: the loss of likelihood is known.
    """
    if fit[SUPPORT, index] < CERTAIN_SUPPORT:
        return False
    width = math.exp(fit[OWN, LOG_WIDTH])
    for i in range(k):
        wider = max(fit[SIGMA, i], fit[SIGMA, index])
        if has_steps(beam):
            wider = max(wider, spread_at(fit[MEAN, index], beam))
        if i != index and abs(fit[MEAN, i] - fit[MEAN, index]) < CERTAIN_SIGMAS * width * wider:
            return False
    if k == 1 and fit[SUPPORT, index] < 0.5 * len(data.value):
        return False
    if math.isfinite(beam.range_max) and near_no_return(fit[MEAN, index], CERTAIN_SIGMAS, beam):
        return False
    loss = 0.0
    for j in range(len(data.value)):
        own = fit[WEIGHT, index] * scratch[DENSITY + index, j]
        if own > 0.5 * scratch[TOTAL, j]:
            loss += math.log(scratch[TOTAL, j] / max(scratch[TOTAL, j] - own, scratch[RANDOM, j]))
    return loss > CERTAIN_GAIN


@borrowing
def _take_over(data: Samples, k: int, index: int, work: LearntWorkspace, law: Law, beam: Beam) -> None:
    """Move the nearest surface of work.trial to the middle of itself and the removed one, where that is likelier.

    A surface on the edge of two wide steps shows both values. From one of them it does not move: the other is so
    unlikely there that background explains its samples.
    """
    fit, trial, _, scratch, _ = work
    nearest, away = 0, math.inf
    for i in range(k - 1):
        apart = abs(trial[MEAN, i] - fit[MEAN, index])
        if apart < away:
            nearest, away = i, apart
    before, left = value_of(data, k - 1, trial, law, beam, scratch), 1.0 - fit[WEIGHT, index]
    for i in range(k - 1):
        trial[WEIGHT, i] *= left
    trial[WEIGHT, -1] *= left
    trial[OWN, BACKGROUND] *= left
    trial[WEIGHT, nearest] += fit[WEIGHT, index]
    trial[MEAN, nearest] = 0.5 * (trial[MEAN, nearest] + fit[MEAN, index])
    if value_of(data, k - 1, trial, law, beam, scratch) <= before:
        copy_fit(fit, trial)
        remove_surface(k, index, trial)


@borrowing
def gain_of_surface(
    data: Samples, k: int, index: int, full: float, work: LearntWorkspace, law: Law, beam: Beam
) -> float:
    """Gain, nat, of one of the `k` surfaces of work.fit, whose objective is `full`, nat.

    The fit without the surface is in work.trial. c_0 may take its samples where it is near r_max.
    """
    fit, trial, _, scratch, _ = work
    copy_fit(fit, trial)
    near = near_no_return(fit[MEAN, index], NO_RETURN_REACH, beam)
    if fit[WEIGHT, -1] == 0.0 and near:
        trial[WEIGHT, -1] = fit[WEIGHT, index]
    remove_surface(k, index, trial)
    if has_steps(beam) and k > 1 and not near:
        _take_over(data, k, index, work, law, beam)
    if near and trial[WEIGHT, -1] > 0.0 and k == 1:
        start_without_surface(data.value, trial, beam)
    return full - settle(data, k - 1, trial, law, beam, scratch)
