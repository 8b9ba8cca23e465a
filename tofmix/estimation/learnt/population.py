"""A population of clusters: whether their spread is that of the pixels' widths, or some are pairs of surfaces.

A pair of surfaces 2 sigma apart and one surface of 1.4 times the width differ by half a nat in 100 samples: no pixel
tells one from the other. All pixels together do. Pairs have a common sigma and are never narrower; widths are narrower
as often as wider. So `spread_beside_pairs` compares populations by their likelihood: of each cluster under one surface
of every width, and under two surfaces of every distance and share, averaged over where they stand, with the cells of a
step. The shares of the pairs follow by EM, without a form of their distribution.

References
----------
Laird, Journal of the American Statistical Association 73(364), 1978, pages 805 to 811: a mixing distribution by maximum
likelihood.
"""

import math
from functools import cache
from itertools import product

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.learnt.law import Law, distribution_at
from tofmix.noise_shape import TAIL_DEGREES

BIN = 0.25
"""Samples are put into cells of so many sigmas where their step is finer: that costs 0.5 % of their information."""

SAME_LEVEL = 0.25
"""Samples closer than this part of a step are in one cell."""


LOG_WIDTHS = np.linspace(-1.2, 1.5, 28)
"""Log widths under which one surface is fitted."""

PAIR_LOG_WIDTHS = np.linspace(-0.4, 0.4, 9)
"""Those of pairs: log widths beyond are rare where they may be pairs."""

PAIRS = np.array(list(product((1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0), (0.15, 0.3, 0.5, 0.7, 0.85))))
"""Distance in sigmas, and share of the nearer surface, of pairs (pair, 2): surfaces farther apart are two clusters."""

ONE_SURFACE = np.array([[0.0, 1.0]])
"""One surface, as a pair."""

PLACES = 15
"""Places over which a likelihood is averaged."""


SCALES = np.geomspace(0.025, 0.8, 11)
"""Scales of log width that are tried."""

SHIFTS = np.linspace(-0.24, 0.09, 12)
"""Log widths of the population's sigma by that of the curve, which a few pairs make too large."""


DECISIVE = math.log(1.0e3)
"""Difference, nat, from which one population is preferred: the other has such a ratio once in 1000 times."""

_FINE = 0.01  # step of log width in sums over widths
_LEAST_SCALE = 0.5 * _FINE  # of equal widths


@jit
def population_likelihoods(
    error: FloatArray,
    half: FloatArray,
    rest: FloatArray,
    span: FloatArray,
    law: Law,
    pairs: FloatArray,
    log_widths: FloatArray,
) -> FloatArray:
    """Log likelihood of each cluster under pairs of surfaces of each width, averaged over where they stand.

    Parameters
    ----------
    error : (cluster, frame) float64
        Samples less the fitted surface, in sigmas of the curve, NaN where a frame has none.
    half, rest, span : (cluster,) float64
        Half the step, in sigmas, 0 without one; the share of background; and the length of the window, in sigmas.
    law : Law
        The noise: its shape is used.
    pairs : (pair, 2) float64
        Distance, in sigmas, and share of the nearer surface; a distance of 0 is one surface.
    log_widths : (width,) float64
        Log widths of the surfaces.

    Returns
    -------
    (cluster, pair, width) float64
        nat, up to a number of the cluster.
    """
    count, frames = error.shape
    out = np.zeros((count, len(pairs), len(log_widths)))
    value, level, times = np.empty(frames), np.empty(frames), np.empty(frames)
    for c in range(count):
        n = 0
        for frame in range(frames):
            if not np.isnan(error[c, frame]):
                value[n] = error[c, frame]
                n += 1
        value[:n].sort()
        own_half, levels = _levels(value, n, half[c], level, times)
        uniform = rest[c] / span[c]
        for p in range(len(pairs)):
            for u in range(len(log_widths)):
                out[c, p, u] = _mean_over_places(
                    level,
                    times,
                    levels,
                    n,
                    own_half,
                    math.exp(log_widths[u]),
                    pairs[p, 0],
                    pairs[p, 1],
                    rest[c],
                    uniform,
                    law,
                )
    return out


@jit
def _levels(value: FloatArray, n: int, half: float, level: FloatArray, times: FloatArray) -> tuple[float, int]:
    """Fill `level` and `times` with the cells of the first `n` values, ascending, and how many are in each.

    Return half a cell, in sigmas, and the number of cells.
    """
    fine = half < 0.5 * BIN
    count = 0
    for j in range(n):
        at = BIN * round(value[j] / BIN) if fine else value[j]
        near = 0.5 * BIN if fine else 2.0 * SAME_LEVEL * half
        if count > 0 and at - level[count - 1] < near:
            times[count - 1] += 1.0
        else:
            level[count], times[count] = at, 1.0
            count += 1
    return max(half, 0.5 * BIN), count


@jit
def _mean_over_places(
    level: FloatArray,
    times: FloatArray,
    levels: int,
    n: int,
    half: float,
    width: float,
    apart: float,
    share: float,
    rest: float,
    uniform: float,
    law: Law,
) -> float:
    """Log of the mean likelihood, nat, over the places of a pair's mean, all equally probable."""
    variance = width * width + half * half / 3.0 + share * (1.0 - share) * apart * apart
    off_centre = 0.1  # further reach, by the distance of a pair: the fitted surface of a skewed pair is not at its mean
    off_step = 0.5  # further reach, by half the step: within a coarse step, samples hardly tell where the surface is
    # standard errors from the mean of the fitted surface
    reach = 4.0 * math.sqrt(variance / max(n, 1)) + off_centre * apart + off_step * half
    scale = 1.0 / width
    near = (1.0 - rest) * share / (2.0 * half)
    far = (1.0 - rest) * (1.0 - share) / (2.0 * half)
    best, total = -math.inf, 0.0
    same_edge = 1e-6  # ends of two cells closer than this part of half a cell are one
    for m in range(PLACES):
        first = reach * (2.0 * (m + 0.5) / PLACES - 1.0) - (1.0 - share) * apart
        log, edge, below, below_far = 0.0, -math.inf, 0.0, 0.0
        for j in range(levels):
            if level[j] - half - edge > same_edge * half:  # else the cell begins where the last one ends
                edge = level[j] - half
                below = distribution_at((edge - first) * scale, law)
                if apart > 0.0:
                    below_far = distribution_at((edge - first - apart) * scale, law)
            edge = level[j] + half
            above = distribution_at((edge - first) * scale, law)
            density = uniform + near * (above - below)
            below = above
            if apart > 0.0:
                above = distribution_at((edge - first - apart) * scale, law)
                density += far * (above - below_far)
                below_far = above
            log += times[j] * math.log(density)
        if log > best:
            total = total * math.exp(best - log) + 1.0
            best = log
        else:
            total += math.exp(log - best)
    return best + math.log(total * reach)


def spread_beside_pairs(
    error: FloatArray, *, half: FloatArray, rest: FloatArray, span: FloatArray, law: Law, scale: float
) -> float | None:
    """Scale of log width where some clusters may be pairs of surfaces.

    Parameters
    ----------
    error : (cluster, frame) float64
        Samples less the fitted surface, in sigmas of the curve, NaN where a frame has none.
    half, rest, span : (cluster,) float64
        Half the step, in sigmas, 0 without one; the share of background; and the length of the window, in sigmas.
    law : Law
        The noise: its shape is used.
    scale : float
        Scale of log width of the clusters if each is of one surface.

    Returns
    -------
    float or None
        `scale` where pairs do not raise the likelihood by `DECISIVE`. None where with pairs equal widths are as likely.
    """
    most_clusters = 400  # most clusters that are compared, evenly chosen
    some = np.unique(np.linspace(0, len(error) - 1, most_clusters).astype(int))
    most_samples = 100  # about the most samples of a cluster that are compared, of frames evenly chosen
    every = max(1, round(float(np.median(np.isfinite(error[some]).sum(axis=1))) / most_samples))
    thinned = np.ascontiguousarray(error[some, ::every])

    def likelihoods(pairs: FloatArray, log_widths: FloatArray) -> FloatArray:
        return population_likelihoods(thinned, half[some], rest[some], span[some], law, pairs, log_widths)

    one = likelihoods(ONE_SURFACE, LOG_WIDTHS)[:, 0]
    singles = _Population(one)
    of_widths = max(map(singles.best, SCALES))
    if of_widths - singles.best(_LEAST_SCALE) < DECISIVE:
        return scale
    population = _Population(one, likelihoods(PAIRS, PAIR_LOG_WIDTHS))
    of_pairs = population.best(_LEAST_SCALE)
    both = [population.best(trial) for trial in SCALES]
    if max(of_pairs, *both) - of_widths < DECISIVE:
        return scale
    return float(SCALES[int(np.argmax(both))]) if max(both) - of_pairs >= DECISIVE else None


class _Population:
    """Likelihoods of clusters at fine steps of log width."""

    def __init__(self, one: FloatArray, two: FloatArray | None = None) -> None:
        most = one.max(axis=1) if two is None else np.maximum(one.max(axis=1), two.max(axis=(1, 2)))
        self._most = float(most.sum())
        self._one = np.exp(one @ _cubic(LOG_WIDTHS, _fine_widths(LOG_WIDTHS)) - most[:, None])
        self._two = None
        if two is not None:
            self._two = np.exp(two @ _cubic(PAIR_LOG_WIDTHS, _fine_widths(PAIR_LOG_WIDTHS)) - most[:, None, None])

    def best(self, scale: float) -> float:
        """Log likelihood, nat, at the most likely of `SHIFTS`, with the most likely shares of pairs."""
        found = np.array([self._value(*masses) for masses in zip(*_masses(float(scale)), strict=True)])
        at = int(np.argmax(found))
        if not 0 < at < len(SHIFTS) - 1:
            return float(found[at])
        below, here, above = found[at - 1 : at + 2]
        bend = below - 2.0 * here + above
        return float(here - (0.125 * (below - above) ** 2 / bend if bend < 0.0 else 0.0))

    def _value(self, of_one: FloatArray, of_pairs: FloatArray) -> float:
        """Log likelihood, nat, with probabilities (n,) of the log widths of one surface and of pairs."""
        part = np.maximum(self._one @ of_one, np.finfo(np.float64).tiny)
        if self._two is None:
            return self._most + float(np.log(part).sum())
        pairs = np.maximum(self._two @ of_pairs, np.finfo(np.float64).tiny)
        parts = np.hstack([part[:, None], pairs])
        share = np.full(parts.shape[1], 0.5 / pairs.shape[1])
        share[0] = 0.5
        iterations = 60  # iterations of EM for the shares of pairs
        for _ in range(iterations):
            share *= (1.0 / (parts @ share)) @ parts / len(parts)
        return self._most + float(np.log(parts @ share).sum())


def _fine_widths(log_widths: FloatArray) -> FloatArray:
    """Log widths (n,), `_FINE` apart, from the first to the last of others."""
    return np.arange(log_widths[0], log_widths[-1] + 0.5 * _FINE, _FINE)


@cache
def _masses(scale: float) -> tuple[FloatArray, FloatArray]:
    """Probability (shift, n) of the nearest of `_fine_widths`, of those of one surface and of pairs.

    Log widths have a Student t density of a scale about each of `SHIFTS`.
    """
    from scipy.special import stdtr

    out = []
    for at in map(_fine_widths, (LOG_WIDTHS, PAIR_LOG_WIDTHS)):
        edge = np.append(at - 0.5 * _FINE, at[-1] + 0.5 * _FINE)
        out.append(np.asarray(np.diff(stdtr(TAIL_DEGREES, (edge - SHIFTS[:, None]) / scale), axis=1), np.float64))
    return out[0], out[1]


def _cubic(at: FloatArray, fine: FloatArray) -> FloatArray:
    """Weights (n, m) of values at `at` (n,), equally spaced, in cubic interpolation at `fine` (m,)."""
    first = np.clip(np.floor((fine - at[0]) / (at[1] - at[0])).astype(int) - 1, 0, len(at) - 4)
    t = (fine - at[0]) / (at[1] - at[0]) - first
    out = np.zeros((len(at), len(fine)))
    for k in range(4):
        others = [m for m in range(4) if m != k]
        out[first + k, np.arange(len(fine))] = np.prod([(t - m) / (k - m) for m in others], axis=0)
    return out
