"""Which of the mixture's surfaces stand: each must earn its place in likelihood.

The density's peaks are where a count starts. Some of them are noise: a hundred
samples of one surface often have two peaks, or a bump in the tail. Here every
surface is taken out in turn, the rest is fitted again with the noise curve, and
the surface that is missed least goes, until each one left is missed by at least
`MIN_GAIN_NATS`.

The peaks also miss some: the few samples of a weak surface may not pile up into
a peak. So before anything is taken out, samples that only c_r explains are
gathered into surfaces where two or more lie together; they too must earn their
place.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.density import sigma_at, within_reach
from tofmix.estimation.mixture import Components, expectation_maximisation, log_likelihood, sample_densities
from tofmix.estimation.settings import MODE_TIED, Knobs
from tofmix.jit import jit

MIN_GAIN_NATS = 6.0
"""Likelihood that a surface must add. Under one surface, twice the gain of a second one behaves
like a chi-square of about two degrees (its range and its share): P(chi2_2 > 12) = 0.0025."""

MIN_SUPPORT = 1.5
"""Samples that a surface must hold: less is one sample and what others lend it, and one sample is c_r's."""

CERTAIN_SUPPORT = 5.0
CERTAIN_SIGMAS = 5.0
"""A surface of 5 samples, 5 sigma from all else, is missed by more than 50 nats: no need to try."""


ORPHAN_SIGMAS = 3.0
"""Samples that only c_r explains are gathered when they lie within this many sigma of one of them."""


@jit
def _most_orphans(samples: FloatArray, k: int, fit: Components, beam: Beam, orphans: FloatArray) -> tuple[int, float]:
    """Find where most samples lie together that only c_r explains; return their number and mean.

    `orphans` is room for as many samples as there are.
    """
    n = 0
    for j in range(len(samples)):
        density = sample_densities(samples[j], k, fit, beam)[0]
        if beam.outlier_density > 0.5 * density and samples[j] <= beam.no_return_from:
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
def adopt_orphans(
    samples: FloatArray, k: int, fit: Components, beam: Beam, knobs: Knobs, orphans: FloatArray
) -> tuple[int, int]:
    """Add surfaces for samples that only c_r explains, and fit again; return the surfaces and the EM iterations."""
    n_iter = 0
    while k < len(fit.mean):
        together, place = _most_orphans(samples, k, fit, beam, orphans)
        if together < MIN_SUPPORT:
            break
        fit.mean[k] = place
        fit.sigma[k] = sigma_at(place, beam.curve_range, beam.curve_sigma)
        fit.weight[k] = together / len(samples)
        k += 1
        n_iter = expectation_maximisation(samples, k, fit, beam, MODE_TIED, knobs.max_iter, knobs.tol)
        if fit.support[k - 1] < MIN_SUPPORT:
            break
    return k, n_iter


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
def drop_unsupported(k: int, fit: Components, beam: Beam) -> int:
    """Take out what is no surface: the weakest one below `MIN_SUPPORT`, and those that belong to c_0."""
    for i in range(k - 1, -1, -1):
        if fit.mean[i] > beam.no_return_from:
            fit.no_return[0] += fit.weight[i]
            k = remove_surface(k, i, fit)
    weakest = 0
    for i in range(1, k):
        if fit.support[i] < fit.support[weakest]:
            weakest = i
    if k > 0 and fit.support[weakest] < MIN_SUPPORT:
        k = remove_surface(k, weakest, fit)
    return k


@jit
def _certain(k: int, index: int, fit: Components, beam: Beam) -> bool:
    """Whether a surface stands so clear of all others that its loss need not be computed."""
    if fit.support[index] < CERTAIN_SUPPORT:
        return False
    nearest = math.inf
    for i in range(k):
        if i != index:
            nearest = min(nearest, abs(fit.mean[i] - fit.mean[index]) / max(fit.sigma[i], fit.sigma[index]))
    if fit.no_return[0] > 0.0:
        nearest = min(nearest, abs(beam.range_max - fit.mean[index]) / beam.sigma_max)
    return nearest > CERTAIN_SIGMAS


@jit
def count_surfaces(
    samples: FloatArray,
    k: int,
    work: tuple[Components, Components, Components],
    orphans: FloatArray,
    beam: Beam,
    knobs: Knobs,
) -> tuple[int, int]:
    """Fit `k` surfaces with tied sigmas, adopt orphans, and take out those that are not missed.

    Return how many are left and the EM iterations of their fit. work[0] holds the start and then the result;
    the rest of `work`, and `orphans`, are room to work in.
    """
    fit, trial, best = work
    n_iter = expectation_maximisation(samples, k, fit, beam, MODE_TIED, knobs.max_iter, knobs.tol)
    found, more_iter = adopt_orphans(samples, k, fit, beam, knobs, orphans)
    if found > k:
        k, n_iter = found, more_iter
    while k > 0:
        left = drop_unsupported(k, fit, beam)
        if left < k:
            k = left
            n_iter = expectation_maximisation(samples, k, fit, beam, MODE_TIED, knobs.max_iter, knobs.tol)
            continue
        full = log_likelihood(samples, k, fit, beam)
        least, least_iter = math.inf, 0
        for i in range(k):
            if k <= knobs.max_layers and _certain(k, i, fit, beam):
                continue
            copy_components(k, fit, trial)
            remove_surface(k, i, trial)
            trial_iter = expectation_maximisation(samples, k - 1, trial, beam, MODE_TIED, knobs.max_iter, knobs.tol)
            gain = full - log_likelihood(samples, k - 1, trial, beam)
            if gain < least:
                least, least_iter = gain, trial_iter
                copy_components(k - 1, trial, best)
        if least >= MIN_GAIN_NATS and k <= knobs.max_layers:
            break
        k, n_iter = k - 1, least_iter
        copy_components(k, best, fit)
    return k, abs(n_iter)
