"""How many surfaces the samples show: each must earn its place in likelihood.

The density's peaks are where a count starts. From there, with the noise curve's
sigmas: samples that only c_r explains are gathered into surfaces; surfaces that
are not missed are taken out, the least missed first; and new ones are tried where
the likelihood rises most, until none gains enough. "Enough" is the threshold of
`false_alarms`, the same for taking out and putting in.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.acceleration import maximise_likelihood
from tofmix.estimation.beam import Beam, is_no_return
from tofmix.estimation.density import sigma_at, within_reach
from tofmix.estimation.gradient import best_share, steepest_place
from tofmix.estimation.mixture import Components, log_likelihood, sample_densities
from tofmix.estimation.settings import MODE_TIED
from tofmix.jit import jit

COUNT_ITER = 60
"""Most EM iterations of one trial: counting compares likelihoods, which settle long before the means."""

COUNT_TOL = 1.0e-2
"""A trial may stop this far, in sigmas, from its end: the likelihood is flat there."""

MIN_SUPPORT = 1.5
"""Samples that a surface must hold: less is one sample and what others lend it, and one sample is c_r's."""

CERTAIN_SUPPORT = 5.0
CERTAIN_SIGMAS = 5.0
"""A surface of 5 samples, 5 sigma from all else, is missed by more than 50 nats: no need to try."""

ORPHAN_SIGMAS = 3.0
"""Samples that only c_r explains are gathered when they lie within this many sigma of one of them."""

SPLIT_SIGMAS = 0.8
"""Half the distance, in sigmas, at which a trial splits one surface in two equal ones."""

ALONE_SIGMAS = 4.0
SCAN_SIGMAS = 4.0
MOST_BY_CHANCE = 12.0
"""A surface this far from all others may be outliers that fell together, if it holds fewer samples than that;
those of one surface lie within `SCAN_SIGMAS`."""


class Rules(NamedTuple):
    """When a surface stands: the least gain, nat, the wanted chance of a false alarm, and the most layers."""

    least_gain: float
    false_alarm: float
    max_layers: int


@jit
def _most_orphans(samples: FloatArray, k: int, fit: Components, beam: Beam, orphans: FloatArray) -> tuple[int, float]:
    """Find where most samples lie together that only c_r explains; return their number and mean.

    `orphans` is room for as many samples as there are.
    """
    n = 0
    for j in range(len(samples)):
        density = sample_densities(samples[j], k, fit, beam)[0]
        if beam.outlier_density > 0.5 * density and not is_no_return(samples[j], beam):
            orphans[n] = samples[j]
            n += 1
    most, place, first, stop = 0, 0.0, 0, 0
    for centre in orphans[:n]:
        reach = ORPHAN_SIGMAS * sigma_at(centre, beam.curve_range, beam.curve_sigma)
        first, stop = within_reach(orphans[:n], first, stop, centre - reach, centre + reach)
        if stop - first > most:
            most, place = stop - first, np.sum(orphans[first:stop]) / (stop - first)
    return most, place


@jit
def _add_surface(k: int, place: float, share: float, fit: Components, beam: Beam) -> int:
    """Add a surface with this share, all others scaled down; return k + 1."""
    for i in range(k):
        fit.weight[i] *= 1.0 - share
    fit.no_return[0] *= 1.0 - share
    fit.mean[k] = place
    fit.sigma[k] = sigma_at(place, beam.curve_range, beam.curve_sigma)
    fit.weight[k] = share * (1.0 - beam.p_outlier)
    return k + 1


@jit
def _settle(samples: FloatArray, k: int, fit: Components, beam: Beam) -> int:
    """Fit with tied sigmas, as far as a comparison of likelihoods needs; return the EM iterations."""
    return abs(maximise_likelihood(samples, k, fit, beam, MODE_TIED, COUNT_ITER, COUNT_TOL))


@jit
def _adopt_orphans(samples: FloatArray, k: int, fit: Components, beam: Beam, orphans: FloatArray) -> int:
    """Add surfaces for samples that only c_r explains; return the surfaces."""
    while k < len(fit.mean):
        together, place = _most_orphans(samples, k, fit, beam, orphans)
        if together < MIN_SUPPORT:
            break
        k = _add_surface(k, place, together / len(samples), fit, beam)
        _settle(samples, k, fit, beam)
        if fit.support[k - 1] < MIN_SUPPORT:
            break
    return k


@jit
def remove_surface(k: int, index: int, fit: Components) -> int:
    """Close the gap that surface `index` leaves; return k - 1."""
    for i in range(index, k - 1):
        fit.mean[i] = fit.mean[i + 1]
        fit.sigma[i] = fit.sigma[i + 1]
        fit.weight[i] = fit.weight[i + 1]
        fit.support[i] = fit.support[i + 1]
    return k - 1


@jit
def copy_components(k: int, source: Components, target: Components) -> None:
    """Copy the state of `k` surfaces."""
    for i in range(k):
        target.mean[i] = source.mean[i]
        target.sigma[i] = source.sigma[i]
        target.weight[i] = source.weight[i]
        target.support[i] = source.support[i]
    target.no_return[0] = source.no_return[0]
    target.no_return[1] = source.no_return[1]


@jit
def _gap_sigmas(k: int, index: int, fit: Components, beam: Beam) -> float:
    """Distance from a surface to the nearest other, or to c_0, in sigmas of the wider of the two."""
    nearest = math.inf
    for i in range(k):
        if i != index:
            nearest = min(nearest, abs(fit.mean[i] - fit.mean[index]) / max(fit.sigma[i], fit.sigma[index]))
    if fit.no_return[0] > 0.0:
        nearest = min(nearest, abs(beam.range_max - fit.mean[index]) / beam.sigma_max)
    return nearest


@jit
def _by_chance(n: int, k: int, index: int, fit: Components, beam: Beam, rules: Rules) -> bool:
    """Whether outliers alone would give such a surface too often.

    Of N p(c_r) outliers, spread evenly, each finds m - 1 or more others in the `SCAN_SIGMAS` after it with the
    chance of a Poisson variable; that many times the number of outliers bounds the chance of one such heap.
    """
    support = fit.support[index]
    if support > MOST_BY_CHANCE or _gap_sigmas(k, index, fit, beam) < ALONE_SIGMAS:
        return False
    expected = n * beam.outlier_density * SCAN_SIGMAS * fit.sigma[index]
    fewer, term = 0.0, math.exp(-expected)
    for m in range(round(support) - 1):
        fewer += term
        term *= expected / (m + 1)
    return n * beam.p_outlier * (1.0 - fewer) > 0.5 * rules.false_alarm


@jit
def drop_unsupported(n: int, k: int, fit: Components, beam: Beam, rules: Rules) -> int:
    """Take out what is no surface: those that belong to c_0, the weakest without support, outliers by chance."""
    for i in range(k - 1, -1, -1):
        if is_no_return(fit.mean[i], beam):
            fit.no_return[0] += fit.weight[i]
            k = remove_surface(k, i, fit)
    weakest = 0
    for i in range(1, k):
        if fit.support[i] < fit.support[weakest]:
            weakest = i
    if k > 0 and (fit.support[weakest] < MIN_SUPPORT or _by_chance(n, k, weakest, fit, beam, rules)):
        k = remove_surface(k, weakest, fit)
    return k


@jit
def _certain(k: int, index: int, fit: Components, beam: Beam) -> bool:
    """Whether a surface stands so clear of all others that its loss need not be computed."""
    return fit.support[index] >= CERTAIN_SUPPORT and _gap_sigmas(k, index, fit, beam) > CERTAIN_SIGMAS


@jit
def prune(
    samples: FloatArray,
    k: int,
    work: tuple[Components, Components, Components],
    beam: Beam,
    rules: Rules,
) -> int:
    """Take out the surfaces of work[0] that are not missed, the least missed first; return how many are left."""
    fit, trial, best = work
    while k > 0:
        left = drop_unsupported(len(samples), k, fit, beam, rules)
        if left < k:
            k = left
            _settle(samples, k, fit, beam)
            continue
        full = log_likelihood(samples, k, fit, beam)
        least = math.inf
        for i in range(k):
            if k <= rules.max_layers and _certain(k, i, fit, beam):
                continue
            copy_components(k, fit, trial)
            remove_surface(k, i, trial)
            _settle(samples, k - 1, trial, beam)
            gain = full - log_likelihood(samples, k - 1, trial, beam)
            if gain < least:
                least = gain
                copy_components(k - 1, trial, best)
        if least >= rules.least_gain and k <= rules.max_layers:
            break
        k -= 1
        copy_components(k, best, fit)
    return k


@jit
def _most_spread(samples: FloatArray, k: int, fit: Components, beam: Beam) -> int:
    """Return the surface whose samples spread most beyond its sigma, by the score test of its variance."""
    excess = np.zeros(k)
    for j in range(len(samples)):
        total = sample_densities(samples[j], k, fit, beam)[0]
        for i in range(k):
            z = (samples[j] - fit.mean[i]) / fit.sigma[i]
            excess[i] += fit.scratch[0, i] / total * (z * z - 1.0)
    most = 0
    for i in range(k):
        excess[i] /= math.sqrt(max(fit.support[i], 1.0))
        if excess[i] > excess[most]:
            most = i
    return most


@jit
def _supported(n: int, k: int, fit: Components, beam: Beam, rules: Rules) -> bool:
    """Whether every surface is one: none belongs to c_0, lacks support or may be outliers."""
    for i in range(k):
        if is_no_return(fit.mean[i], beam) or fit.support[i] < MIN_SUPPORT:
            return False
        if _by_chance(n, k, i, fit, beam, rules):
            return False
    return True


@jit
def try_one_more(
    samples: FloatArray,
    k: int,
    work: tuple[Components, Components, Components],
    beam: Beam,
    rules: Rules,
    densities: FloatArray,
) -> float:
    """Fit one more surface than work[0] has; return its gain, nat, with the fit in work[2].

    Two starts: where the likelihood rises most, and the most spread surface split in two. The gain is 0 where it
    cannot reach the least gain, or the new fit has something that is no surface.
    """
    fit, trial, best = work
    slope, place = steepest_place(samples, k, fit, beam, densities)
    if slope < rules.least_gain or k + 1 > len(fit.mean):
        return 0.0
    share = best_share(samples, place, beam, densities)
    before, gain = log_likelihood(samples, k, fit, beam), 0.0
    for start in range(2):
        copy_components(k, fit, trial)
        if start == 0:
            _add_surface(k, place, share, trial, beam)
        elif k > 0:
            i = _most_spread(samples, k, fit, beam)
            _add_surface(k, fit.mean[i] + SPLIT_SIGMAS * fit.sigma[i], 0.0, trial, beam)
            trial.mean[i] -= SPLIT_SIGMAS * fit.sigma[i]
            trial.weight[i] *= 0.5
            trial.weight[k] = trial.weight[i]
        else:
            continue
        _settle(samples, k + 1, trial, beam)
        found = log_likelihood(samples, k + 1, trial, beam) - before
        if found > gain and _supported(len(samples), k + 1, trial, beam, rules):
            gain = found
            copy_components(k + 1, trial, best)
    return gain


@jit
def grow(
    samples: FloatArray,
    k: int,
    work: tuple[Components, Components, Components],
    beam: Beam,
    rules: Rules,
    densities: FloatArray,
) -> int:
    """Add surfaces to work[0] while one more gains enough; return how many there are."""
    while k < rules.max_layers:
        if try_one_more(samples, k, work, beam, rules, densities) < rules.least_gain:
            break
        k += 1
        copy_components(k, work[2], work[0])
    return k


@jit
def count_surfaces(
    samples: FloatArray,
    k: int,
    work: tuple[Components, Components, Components],
    room: FloatArray,
    beam: Beam,
    rules: Rules,
) -> int:
    """Count the surfaces from a start of `k` in work[0]; return how many there are, with their tied fit in work[0].

    `room` holds as many numbers as there are samples.
    """
    fit = work[0]
    _settle(samples, k, fit, beam)
    k = _adopt_orphans(samples, k, fit, beam, room)
    k = prune(samples, k, work, beam, rules)
    return grow(samples, k, work, beam, rules, room)


@jit
def surface_gains(samples: FloatArray, k: int, work: tuple[Components, Components, Components], beam: Beam) -> None:
    """Set the gain of each surface of work[0]: the likelihood, nat, lost without it; infinite where it is certain.

    With tied sigmas, as in counting, whatever the sigmas of work[0] are.
    """
    fit, trial, tied = work
    copy_components(k, fit, tied)
    _settle(samples, k, tied, beam)
    full = log_likelihood(samples, k, tied, beam)
    for i in range(k):
        fit.gain[i] = math.inf
        if _certain(k, i, fit, beam):
            continue
        copy_components(k, tied, trial)
        remove_surface(k, i, trial)
        _settle(samples, k - 1, trial, beam)
        fit.gain[i] = full - log_likelihood(samples, k - 1, trial, beam)
