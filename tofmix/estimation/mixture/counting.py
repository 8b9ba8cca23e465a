"""How many surfaces the samples show: each must earn its place in likelihood.

The density's peaks are where a count starts. From there, with the noise curve's
sigmas: samples that only c_r explains are gathered into surfaces; surfaces that
are not missed are taken out, the least missed first; and new ones are tried where
the likelihood rises most, until none gains enough. "Enough" is the threshold for a wanted chance of
false alarms, the same for taking out and putting in.

Where a pixel sees one surface, a second one in the fit still gains some likelihood
by following the noise. How much depends on the number of samples, slowly. The
table of `gain_table` holds the gains that were exceeded with each chance, drawn with the package's
own search by ``python tests/benchmarks/calibrate.py``; in between it is read off
linearly in the logarithms of both.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import product_of, total_of
from tofmix.estimation.beam import (
    NO_RETURN_REACH,
    Beam,
    is_beyond,
    is_no_return,
    is_uniform,
    near_no_return,
    outlier_density_at,
    sigma_at,
)
from tofmix.estimation.mixture.em import (
    GAIN,
    MEAN,
    MOMENT_2,
    OTHER,
    RANDOM,
    ROOT_TWO_PI,
    SHARE,
    SIGMA,
    SPARE,
    SUPPORT,
    TOTAL,
    WEIGHT,
    Components,
    Scratch,
    capacity_of,
    copy_components,
    expect,
    log_likelihood,
    maximise_likelihood,
    mix,
    new_components,
    new_scratch,
    no_return_row,
    remove_surface,
)
from tofmix.estimation.mixture.gain_bound import best_share, gain_bound_of_clear, steepest_place
from tofmix.estimation.samples import Readings, within_reach
from tofmix.estimation.settings import MODE_TIED

FALSE_ALARMS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0001)
"""Chances of a false alarm, a column each."""

SAMPLES = (5, 10, 15, 30, 60, 100, 200, 500, 1000)
"""Samples in the pixel, a row each."""

_GAINS = np.array(
    [
        (0.00, 0.51, 1.30, 1.91, 2.55, 3.53, 4.18, 6.44),  # 5
        (0.53, 1.12, 1.94, 2.58, 3.27, 4.14, 4.70, 6.82),  # 10
        (0.71, 1.31, 2.15, 2.79, 3.45, 4.36, 4.89, 6.99),  # 15
        (0.97, 1.61, 2.49, 3.21, 3.94, 4.83, 5.49, 7.77),  # 30
        (1.14, 1.79, 2.67, 3.38, 4.04, 5.00, 5.69, 8.01),  # 60
        (1.25, 1.91, 2.78, 3.45, 4.11, 5.04, 5.83, 8.21),  # 100
        (1.36, 2.02, 2.91, 3.57, 4.26, 5.23, 6.00, 8.43),  # 200
        (1.48, 2.15, 3.06, 3.70, 4.43, 5.45, 6.12, 8.54),  # 500
        (1.55, 2.24, 3.16, 3.81, 4.52, 5.37, 6.08, 8.34),  # 1000
    ]
)

_NATS_OF_CHANCE = -np.log(np.array(FALSE_ALARMS))


def gain_table(most_samples: int) -> FloatArray:
    """Gains that noise exceeds with each of `FALSE_ALARMS`, for each number of samples.

    Parameters
    ----------
    most_samples : int
        Most samples in a pixel.

    Returns
    -------
    (most_samples + 1, len(FALSE_ALARMS)) float64
        Gains in nat; row n is for n samples. Below 5 samples those of 5 hold, above 1000 those of 1000.
    """
    log_n = np.log(np.maximum(np.arange(most_samples + 1, dtype=np.float64), 1.0))
    columns = [np.interp(log_n, np.log(np.array(SAMPLES)), column) for column in _GAINS.T]
    return np.ascontiguousarray(np.stack(columns, axis=1), dtype=np.float64)


@borrowing
def _read_off(x: float, known: FloatArray, values: FloatArray) -> float:
    """Interpolate linearly; past the last point, go on as between the last two."""
    last = len(known) - 1
    k = 1
    while k < last and known[k] < x:
        k += 1
    slope = (values[k] - values[k - 1]) / (known[k] - known[k - 1])
    return float(values[k] + slope * (x - known[k]))


@borrowing
def least_gain(false_alarm: float, gains: FloatArray) -> float:
    """Gain, nat, that noise exceeds with the chance `false_alarm`; `gains` is the pixel's row of `gain_table`."""
    return _read_off(-math.log(false_alarm), _NATS_OF_CHANCE, gains)


@borrowing
def chance_of(gain: float, gains: FloatArray) -> float:
    """Chance that noise gains as much: the inverse of `least_gain`, at most 1."""
    if gain <= 0.0:
        return 1.0
    if gain < gains[0]:
        return float(1.0 - (1.0 - FALSE_ALARMS[0]) * gain / gains[0])
    return float(math.exp(-_read_off(gain, gains, _NATS_OF_CHANCE)))


COUNT_ITER = 60
"""Most EM iterations of one trial: counting compares likelihoods, which settle long before the means."""

COUNT_TOL = 1.0e-2
"""A trial may stop this far, in sigmas, from its end: the likelihood is flat there."""

MIN_SUPPORT = 1.5
"""Least support of a surface, samples: a single sample counts as an outlier (c_r)."""

CERTAIN_SUPPORT, CERTAIN_GAIN = 5.0, 40.0
"""Least samples of a surface that needs no trial, and least loss, nat, without it: its probability rounds to 1."""


CERTAIN_SIGMAS = 5.0
"""Distance of such a surface from all others, in sigmas."""


SPLIT_SIGMAS = 0.8
"""Half the distance, in sigmas, at which a trial splits one surface in two equal ones."""


_STEEPEST, _SPLIT, _MOVED = 0, 1, 2  # starts of one surface more


LEAST_BOUND = 0.4
"""One more surface is tried where its gain bound (`mixture.gain_bound`) is this part of the least gain."""


class Rules(NamedTuple):
    """Rules for a surface: the least gain, nat, the requested false-alarm probability, and the most layers.

    `no_return_gain`, nat, is the gain that c_0 needs in the presence of a surface.
    """

    least_gain: float
    false_alarm: float
    max_layers: int
    no_return_gain: float


class Workspace(NamedTuple):
    """Three fits and their common scratch: `fit` is current, `trial` the present trial, `best` the best trial."""

    fit: Components
    trial: Components
    best: Components
    scratch: Scratch


@jit
def new_workspace(capacity: int, values: int) -> Workspace:
    """Make a workspace for pixels of up to `values` different values and `capacity` surfaces."""
    return Workspace(
        new_components(capacity), new_components(capacity), new_components(capacity), new_scratch(capacity, values)
    )


@borrowing
def _most_unexplained(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> tuple[float, float]:
    """Find where most samples lie together that only c_r explains; return their number and mean."""
    mix(data, k, fit, beam, scratch)
    unexplained, counts, n = scratch[SPARE], scratch[OTHER], 0
    uniform = is_uniform(beam)
    for j in range(len(data.value)):
        random = beam.outlier_density if uniform else scratch[RANDOM, j]
        if random > 0.5 * scratch[TOTAL, j] and not is_beyond(data.value[j], beam):
            unexplained[n], counts[n] = data.value[j], data.times[j]
            n += 1
    most, place, first, stop = 0.0, 0.0, 0, 0
    # Samples that only c_r explains are gathered when they lie within this many sigma of one of them.
    unexplained_sigmas = 3.0
    for centre in unexplained[:n]:
        reach = unexplained_sigmas * sigma_at(centre, beam.curve_range, beam.curve_sigma)
        first, stop = within_reach(unexplained[:n], first, stop, centre - reach, centre + reach)
        group_size = total_of(counts[first:stop])
        if group_size > most:
            most, place = group_size, product_of(unexplained[first:stop], counts[first:stop]) / group_size
    return most, place


@borrowing
def _add_surface(k: int, place: float, share: float, fit: Components, beam: Beam) -> int:
    """Add a surface with this share, all others scaled down; return k + 1."""
    for i in range(k):
        fit[WEIGHT, i] *= 1.0 - share
    fit[WEIGHT, -1] *= 1.0 - share
    fit[MEAN, k] = place
    fit[SIGMA, k] = sigma_at(place, beam.curve_range, beam.curve_sigma)
    fit[WEIGHT, k] = share * (1.0 - beam.p_outlier)
    return k + 1


@borrowing
def _settle(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> int:
    """Fit with tied sigmas, as far as a comparison of likelihoods needs; return the EM iterations."""
    return abs(maximise_likelihood(data, k, fit, beam, MODE_TIED, COUNT_ITER, COUNT_TOL, scratch))


@borrowing
def _add_unexplained(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> int:
    """Add surfaces for samples that only c_r explains; return the surfaces."""
    while k < capacity_of(fit):
        group_size, place = _most_unexplained(data, k, fit, beam, scratch)
        if group_size < MIN_SUPPORT:
            break
        k = _add_surface(k, place, group_size / data.total, fit, beam)
        _settle(data, k, fit, beam, scratch)
        if fit[SUPPORT, k - 1] < MIN_SUPPORT:
            break
    return k


@borrowing
def _gap_sigmas(k: int, index: int, fit: Components, beam: Beam) -> float:
    """Distance from a surface to the nearest other, or to c_0, in sigmas of the wider of the two."""
    nearest = math.inf
    for i in range(k):
        if i != index:
            nearest = min(nearest, abs(fit[MEAN, i] - fit[MEAN, index]) / max(fit[SIGMA, i], fit[SIGMA, index]))
    if fit[WEIGHT, -1] > 0.0:
        nearest = min(nearest, abs(beam.range_max - fit[MEAN, index]) / beam.sigma_max)
    return nearest


@borrowing
def _by_chance(n: float, k: int, index: int, fit: Components, beam: Beam, rules: Rules) -> bool:
    """Whether outliers alone would give such a surface too often.

    Of N p(c_r) outliers, spread evenly over these samples, each finds m - 1 or more others in the four sigmas after
    it with the chance of a Poisson variable; times the number of outliers, this bounds the probability of one such
    group.
    """
    support = fit[SUPPORT, index]
    most_by_chance = 12.0  # samples from which a surface is no chance group of outliers
    # Distance from all other surfaces, in sigmas, from which a surface may be a chance group of outliers.
    alone_sigmas = 4.0
    if support > most_by_chance or _gap_sigmas(k, index, fit, beam) < alone_sigmas:
        return False
    # four sigmas, within which the samples of such a surface are counted
    expected = n * outlier_density_at(fit[MEAN, index], beam) * 4.0 * fit[SIGMA, index]
    fewer, term = 0.0, math.exp(-expected)
    for m in range(round(support) - 1):
        fewer += term
        term *= expected / (m + 1)
    by_chance = 0.1  # part of the wanted false alarms that heaps of outliers may add: `gain_table` has used up the rest
    return n * beam.p_outlier * (1.0 - fewer) > by_chance * rules.false_alarm


@borrowing
def drop_unsupported(n: float, k: int, fit: Components, beam: Beam, rules: Rules) -> int:
    """Remove false surfaces: those beyond the working range, the weakest without support, and groups of outliers.

    Where peaks are surfaces, the rule for peaks separates c_0; else the likelihood does.
    """
    for i in range(k - 1, -1, -1):
        by_likelihood = rules.false_alarm < 1.0
        if is_beyond(fit[MEAN, i], beam) or (is_no_return(fit[MEAN, i], beam) and not by_likelihood):
            fit[WEIGHT, -1] += fit[WEIGHT, i]
            k = remove_surface(k, i, fit)
    weakest = 0
    for i in range(1, k):
        if fit[SUPPORT, i] < fit[SUPPORT, weakest]:
            weakest = i
    if k > 0 and (fit[SUPPORT, weakest] < MIN_SUPPORT or _by_chance(n, k, weakest, fit, beam, rules)):
        k = remove_surface(k, weakest, fit)
    return k


@borrowing
def _certain(k: int, index: int, fit: Components, beam: Beam) -> bool:
    """Whether a surface far from all others, and from c_0, surely gains more than `CERTAIN_GAIN` over c_r alone."""
    if fit[SUPPORT, index] < CERTAIN_SUPPORT or near_no_return(fit[MEAN, index], CERTAIN_SIGMAS, beam):
        return False
    if _gap_sigmas(k, index, fit, beam) <= CERTAIN_SIGMAS:
        return False
    peak = fit[WEIGHT, index] / (ROOT_TWO_PI * fit[SIGMA, index])
    # What a sample's density falls short of its surface's peak, nat: 0.5 by its error, 1 at most by the share that
    # others gain without the surface, and 0.5 to spare.
    lost_by_sample = 2.0
    by_sample = math.log(peak / outlier_density_at(fit[MEAN, index], beam)) - lost_by_sample
    return bool(fit[SUPPORT, index] * by_sample > CERTAIN_GAIN)


@borrowing
def _leave_out(k: int, index: int, fit: Components, trial: Components, beam: Beam) -> None:
    """Fill `trial` with the fit without one surface, as a start; c_0 may take its place where it is near."""
    copy_components(k, fit, trial)
    if fit[WEIGHT, -1] == 0.0 and near_no_return(fit[MEAN, index], NO_RETURN_REACH, beam):
        trial[WEIGHT, -1] = fit[WEIGHT, index]
    remove_surface(k, index, trial)


@borrowing
def weigh_no_return(data: Readings, k: int, work: Workspace, beam: Beam, rules: Rules) -> bool:
    """Remove c_0 from work.fit if a surface is near it and the samples do not need both; return whether it is gone."""
    fit, trial, _, scratch = work
    if k == 0 or fit[WEIGHT, -1] == 0.0:
        return False
    near = False
    for i in range(k):
        near = near or near_no_return(fit[MEAN, i], CERTAIN_SIGMAS, beam)
    if not near:
        return False
    copy_components(k, fit, trial)
    scale = (1.0 - beam.p_outlier) / (1.0 - beam.p_outlier - fit[WEIGHT, -1])
    trial[WEIGHT, -1] = 0.0
    for i in range(k):
        trial[WEIGHT, i] *= scale
    _settle(data, k, trial, beam, scratch)
    if (
        log_likelihood(data, k, fit, beam, scratch) - log_likelihood(data, k, trial, beam, scratch)
        >= rules.no_return_gain
    ):
        return False
    copy_components(k, trial, fit)
    return True


@borrowing
def prune(
    data: Readings,
    k: int,
    work: Workspace,
    beam: Beam,
    rules: Rules,
) -> int:
    """Take out the surfaces of work.fit that are not missed, the least missed first; return how many are left."""
    fit, trial, best, scratch = work
    while k > 0:
        left = drop_unsupported(data.total, k, fit, beam, rules)
        if left < k:
            k = left
            _settle(data, k, fit, beam, scratch)
            continue
        full, least = math.nan, math.inf
        for i in range(k):
            if k <= rules.max_layers and _certain(k, i, fit, beam):
                continue
            if math.isnan(full):
                full = log_likelihood(data, k, fit, beam, scratch)
            _leave_out(k, i, fit, trial, beam)
            _settle(data, k - 1, trial, beam, scratch)
            gain = full - log_likelihood(data, k - 1, trial, beam, scratch)
            if gain < least:
                least = gain
                copy_components(k - 1, trial, best)
        if least >= rules.least_gain and k <= rules.max_layers:
            break
        k -= 1
        copy_components(k, best, fit)
    return k


@borrowing
def _most_spread(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> int:
    """Return the surface whose samples spread most beyond its sigma, by the score test of its variance."""
    expect(data, k, fit, beam, scratch)
    most, largest = 0, -math.inf
    for i in range(k):
        excess = fit[MOMENT_2, i] / fit[SIGMA, i] ** 2 - fit[SUPPORT, i]
        excess /= math.sqrt(max(fit[SUPPORT, i], 1.0))
        if excess > largest:
            most, largest = i, excess
    return most


@borrowing
def _supported(n: float, k: int, fit: Components, beam: Beam, rules: Rules) -> bool:
    """Whether every surface is one: none lies beyond the working range, lacks support or may be outliers."""
    for i in range(k):
        if is_beyond(fit[MEAN, i], beam) or fit[SUPPORT, i] < MIN_SUPPORT:
            return False
        if _by_chance(n, k, i, fit, beam, rules):
            return False
    return True


@borrowing
def may_gain_more(data: Readings, k: int, work: Workspace, beam: Beam, rules: Rules) -> bool:
    """Whether one more surface than in work.fit could gain enough: a quick bound, true if it is inconclusive."""
    wanted = LEAST_BOUND * rules.least_gain
    return bool(gain_bound_of_clear(data, k, work.fit, beam, work.scratch, wanted) >= wanted)


@borrowing
def try_one_more(data: Readings, k: int, work: Workspace, beam: Beam, rules: Rules) -> float:
    """Fit one more surface than work.fit has; return its gain, nat, with the fit in work.best.

    Three starts: where the likelihood rises most, the most spread surface split in two, and a surface that takes the
    samples of c_0. The gain is 0 where it cannot reach the least gain, or its bound is too low, or the new fit has
    something that is no surface.
    """
    fit, trial, best, scratch = work
    wanted = LEAST_BOUND * rules.least_gain
    if k + 1 > capacity_of(fit):
        return 0.0
    slope, place, bound = steepest_place(data, k, fit, beam, scratch, wanted)
    if slope < rules.least_gain or bound < wanted:
        return 0.0
    share = best_share(data, place, beam, scratch)
    before, gain = log_likelihood(data, k, fit, beam, scratch), 0.0
    for start in (_STEEPEST, _SPLIT, _MOVED):
        copy_components(k, fit, trial)
        if start == _STEEPEST:
            _add_surface(k, place, share, trial, beam)
        elif start == _MOVED:
            if not _move_no_return(data, k, trial, beam, scratch):
                continue
        elif k > 0:
            i = _most_spread(data, k, fit, beam, scratch)
            _add_surface(k, fit[MEAN, i] + SPLIT_SIGMAS * fit[SIGMA, i], 0.0, trial, beam)
            trial[MEAN, i] -= SPLIT_SIGMAS * fit[SIGMA, i]
            trial[WEIGHT, i] *= 0.5
            trial[WEIGHT, k] = trial[WEIGHT, i]
        else:
            continue
        _settle(data, k + 1, trial, beam, scratch)
        found = log_likelihood(data, k + 1, trial, beam, scratch) - before
        if found > gain and _supported(data.total, k + 1, trial, beam, rules):
            gain = found
            copy_components(k + 1, trial, best)
    return gain


@borrowing
def _move_no_return(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch) -> bool:
    """Add a surface at the mean of c_0's samples, and give it most of them; return whether there is such a place."""
    weight = fit[WEIGHT, -1]
    if weight == 0.0:
        return False
    expect(data, k, fit, beam, scratch)
    own, term = scratch[no_return_row(fit)], scratch[SPARE, : len(data.value)]
    for j in range(len(data.value)):
        term[j] = scratch[SHARE, j] * own[j]
    support = total_of(term)
    if weight * support < MIN_SUPPORT:
        return False
    place = product_of(term, data.value) / support
    if is_beyond(place, beam):
        return False
    _add_surface(k, place, 0.0, fit, beam)
    moved_share = 0.9  # part of c_0 that a trial gives to a surface in its place: EM moves a share of 0 no more
    fit[WEIGHT, k], fit[WEIGHT, -1] = moved_share * weight, (1.0 - moved_share) * weight
    return True


@borrowing
def grow(data: Readings, k: int, work: Workspace, beam: Beam, rules: Rules) -> int:
    """Add surfaces to work.fit while one more gains enough; return how many there are."""
    while k < rules.max_layers and may_gain_more(data, k, work, beam, rules):
        if try_one_more(data, k, work, beam, rules) < rules.least_gain:
            break
        k += 1
        copy_components(k, work.best, work.fit)
    return k


@borrowing
def count_surfaces(data: Readings, k: int, work: Workspace, beam: Beam, rules: Rules) -> int:
    """Count the surfaces from a start of `k` in work.fit; return how many there are, with their tied fit there."""
    _settle(data, k, work.fit, beam, work.scratch)
    k = _add_unexplained(data, k, work.fit, beam, work.scratch)
    k = prune(data, k, work, beam, rules)
    k = grow(data, k, work, beam, rules)
    if weigh_no_return(data, k, work, beam, rules):
        k = prune(data, k, work, beam, rules)  # what stood beside c_0 may not be needed beside what took its place
    return k


@borrowing
def surface_gains(data: Readings, k: int, work: Workspace, beam: Beam) -> None:
    """Set the gain of each surface of work.fit: the likelihood, nat, lost without it; infinite where it is certain.

    With tied sigmas, as in counting, for any sigmas of work.fit.
    """
    fit, trial, tied, scratch = work
    full = math.nan
    for i in range(k):
        fit[GAIN, i] = math.inf
        if _certain(k, i, fit, beam):
            continue
        if math.isnan(full):
            copy_components(k, fit, tied)
            _settle(data, k, tied, beam, scratch)
            full = log_likelihood(data, k, tied, beam, scratch)
        _leave_out(k, i, tied, trial, beam)
        _settle(data, k - 1, trial, beam, scratch)
        fit[GAIN, i] = full - log_likelihood(data, k - 1, trial, beam, scratch)
