"""Where the search of `plain` starts: partitions of the sorted samples, and changes of a mixture at hand.

All starts are arrays (3, k): means, log sigmas, log weights. Nothing is random.
"""

from itertools import combinations, pairwise

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.compiled.jit import jit

MOST_POINTS = 400
"""More samples than this are thinned for the search for partitions, evenly in rank."""

PARTITION_FLOORS = (0.0, 0.05, 0.15, 0.4)
"""Least sigmas of a part, in standard deviations of the samples, that shape one partition each."""

BANDWIDTHS = (0.05, 0.08, 0.12, 0.2, 0.3, 0.45)
"""Bandwidths of densities whose peaks make a start, in standard deviations of the samples."""

MOST_FOR_ALL_PAIRS = 8
"""With more components than this, only neighbours are merged."""

_GRID = 400


@jit
def _best_cuts(samples: FloatArray, k: int, floor: float, equal: bool) -> IntArray:
    """First samples of the k parts of sorted samples that have the greatest classification likelihood.

    By dynamic programming. With `equal`, that of one common sigma: the parts with the least squares about their means.
    """
    n = len(samples)
    sum1, sum2 = np.zeros(n + 1), np.zeros(n + 1)
    for j in range(n):
        sum1[j + 1] = sum1[j] + samples[j]
        sum2[j + 1] = sum2[j] + samples[j] * samples[j]
    best, before = np.full((k + 1, n + 1), np.inf), np.zeros((k + 1, n + 1), dtype=np.int64)
    best[0, 0] = 0.0
    for part in range(1, k + 1):
        for stop in range(part, n + 1):
            for start in range(part - 1, stop):
                size = stop - start
                mean = (sum1[stop] - sum1[start]) / size
                squares = max(sum2[stop] - sum2[start] - size * mean * mean, 0.0)
                cost = squares
                if not equal:
                    variance = max(squares / size, floor * floor)
                    cost = 0.5 * size * np.log(variance) + 0.5 * squares / variance - size * np.log(size / n)
                cost += best[part - 1, start]
                if cost < best[part, stop]:
                    best[part, stop], before[part, stop] = cost, start
    cuts = np.zeros(k, dtype=np.int64)
    stop = n
    for part in range(k, 0, -1):
        stop = before[part, stop]
        cuts[part - 1] = stop
    return cuts


def _density_peaks(samples: FloatArray, h: float) -> tuple[FloatArray, FloatArray]:
    """Places and heights of the peaks of a kernel density with a fixed bandwidth."""
    low, high = samples[0] - h, samples[-1] + h
    at = low + (high - low) * np.arange(_GRID) / (_GRID - 1)
    p = np.exp(-0.5 * ((at[:, np.newaxis] - samples) / h) ** 2).sum(axis=1)
    inside = np.flatnonzero((p[1:-1] >= p[:-2]) & (p[1:-1] > p[2:])) + 1
    return at[inside], p[inside]


def partitions(samples: FloatArray, k: int, floor: float) -> list[FloatArray]:
    """Starts from cutting the sorted samples, of standard deviation 1, into k parts.

    Equal parts; the parts of the least squares; those of the greatest classification likelihood with several least
    sigmas; and those nearest to each of the highest peaks of densities with several bandwidths.

    `samples` (n,) float64: sorted samples, n at least k.
    `k`: parts.
    `floor`: least sigma.
    Returns list of (3, k) float64: starts without doubles.
    """
    n = len(samples)
    rank = np.unique(np.linspace(0, n - 1, min(n, max(MOST_POINTS, k))).astype(np.int64))
    thin = samples[rank]
    cuts = [np.arange(k) * n // k, rank[_best_cuts(thin, k, floor, equal=True)]]
    cuts += [rank[_best_cuts(thin, k, max(least, floor), equal=False)] for least in PARTITION_FLOORS]
    for h in BANDWIDTHS:
        place, height = _density_peaks(samples, h)
        if len(place) >= k:
            highest = np.sort(place[np.argsort(-height, kind="stable")[:k]])
            cuts.append(np.searchsorted(samples, [-np.inf, *((highest[1:] + highest[:-1]) / 2)]))
    distinct = {tuple(c.tolist()): None for c in cuts if len(set(c.tolist())) == k}
    return [_from_cuts(samples, list(c), floor) for c in distinct]


def _from_cuts(samples: FloatArray, cuts: list[int], floor: float) -> FloatArray:
    parts = [samples[a:b] for a, b in pairwise([*cuts, len(samples)])]
    sigma = np.maximum([part.std() for part in parts], floor)
    share = np.array([len(part) for part in parts]) / len(samples)
    return np.stack([np.array([part.mean() for part in parts]), np.log(sigma), np.log(share)])


def split(theta: FloatArray, floor: float) -> list[FloatArray]:
    """Starts with one component more: each in turn is split side by side, or a narrow one is taken out of it."""
    return [start for i in range(theta.shape[1]) for start in _splits(theta, i, floor)]


def _splits(theta: FloatArray, i: int, floor: float) -> list[FloatArray]:
    """Split component i in several ways: (offset, sigma, weight) of the two halves, in its own units."""
    ways = (
        ((-0.8, 0.6, 0.5), (0.8, 0.6, 0.5)),
        ((0.0, 0.3, 0.4), (0.0, 1.3, 0.6)),
        ((-1.5, 0.5, 0.15), (0.2, 0.9, 0.85)),
        ((1.5, 0.5, 0.15), (-0.2, 0.9, 0.85)),
    )
    mean, log_sigma, log_weight = theta[:, i]
    out = []
    for way in ways:
        halves = [
            (mean + offset * np.exp(log_sigma), max(log_sigma + np.log(factor), np.log(floor)), log_weight + np.log(w))
            for offset, factor, w in way
        ]
        start = np.concatenate([theta, np.array(halves[1])[:, np.newaxis]], axis=1)
        start[:, i] = halves[0]
        out.append(start)
    return out


def merged_and_split(theta: FloatArray, floor: float) -> list[FloatArray]:
    """Starts with as many components: two are merged, and another, or the merged one, is split."""
    k = theta.shape[1]
    by_mean = np.argsort(theta[0], kind="stable").tolist()
    pairs = list(combinations(by_mean, 2)) if k <= MOST_FOR_ALL_PAIRS else list(pairwise(by_mean))
    return [start for a, b in pairs for i in range(k - 1) for start in _splits(_merged(theta, a, b), i, floor)]


def _merged(theta: FloatArray, a: int, b: int) -> FloatArray:
    """Components a and b as one of their common mean and variance, the last of k - 1."""
    mean, sigma, weight = theta[0, [a, b]], np.exp(theta[1, [a, b]]), np.exp(theta[2, [a, b]])
    total = weight.sum()
    centre = weight @ mean / total
    variance = weight @ (sigma**2 + (mean - centre) ** 2) / total
    rest = np.delete(theta, [a, b], axis=1)
    merged = np.array([[centre], [0.5 * np.log(variance)], [np.log(total)]])
    return np.concatenate([rest, merged], axis=1)
