"""Gaussian mixtures of plain samples, without a noise curve.

Use `fit_gaussians` where nothing is known of sigma: to compare with other programs,
or on data that is no recording. Where sigma(r) is known, `tofmix.estimation.mixture.em.fit_mixture` and
`tofmix.estimation.layering.layer_pixels` tell much closer surfaces apart.

The likelihood of such a mixture has many maxima. The search is deterministic: it
climbs from one component to k, each time from partitions of the sorted samples
(`benchmarks.plain_starts`), from splits of the last solution and from merges with splits of the
best one so far. It mostly finds the greatest maximum, but that is not certain.

References
----------
Ueda, Nakano, Ghahramani and Hinton, SMEM algorithm for mixture models, Neural Computation 12(9), 2000,
doi:10.1162/089976600300015088.
Varadhan and Roland, Scandinavian J. Statistics 35(2), 2008, doi:10.1111/j.1467-9469.2007.00585.x: scheme S3.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from benchmarks.plain_starts import merged_and_split, partitions, split
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.samples import readings_of

SHORT_ITER = 30
"""EM iterations after which starts are compared."""

KEPT = 6
"""Starts that are fitted to the end."""

ROUNDS = 4
"""Most rounds of merges and splits at one number of components."""

_LOG_ROOT_TWO_PI = 0.5 * math.log(2.0 * math.pi)
_LEAST_WEIGHT = 1.0e-12
_LONGEST_JUMP = 256.0


class Variances(StrEnum):
    """What is assumed of the components' variances."""

    EQUAL = "equal"
    FREE = "free"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlainFit:
    """A fitted mixture: weights, means and sigmas (k,) float64, by mean; log_likelihood in nat.

    n_iter counts the EM iterations of the fit that won, not those of the search.
    """

    weights: FloatArray
    means: FloatArray
    sigmas: FloatArray
    log_likelihood: float
    n_iter: int
    converged: bool


@jit
def _em_map(samples: FloatArray, theta: FloatArray, equal: bool, floor: float, out: FloatArray) -> float:
    """One EM iteration from `theta` to `out`; return the log likelihood at `theta`.

    Both are (3, k): means, log sigmas, log weights. Terms are held relative to the largest, so that a sample far
    from every component still counts.
    """
    k, n = theta.shape[1], len(samples)
    terms, inverse = np.empty(k), np.exp(-theta[1])
    constant = theta[2] - theta[1] - _LOG_ROOT_TWO_PI
    support, first, second = np.zeros(k), np.zeros(k), np.zeros(k)
    likelihood = 0.0
    for j in range(n):
        top = -math.inf
        for i in range(k):
            z = (samples[j] - theta[0, i]) * inverse[i]
            terms[i] = constant[i] - 0.5 * z * z
            top = max(top, terms[i])
        total = 0.0
        for i in range(k):
            terms[i] = math.exp(terms[i] - top)
            total += terms[i]
        likelihood += top + math.log(total)
        for i in range(k):
            share = terms[i] / total
            away = samples[j] - theta[0, i]
            support[i] += share
            first[i] += share * away
            second[i] += share * away * away
    common = 0.0
    for i in range(k):
        held = max(support[i], _LEAST_WEIGHT)
        shift = first[i] / held
        squares = max(second[i] - held * shift * shift, 0.0)
        common += squares
        out[0, i] = theta[0, i] + shift
        out[1, i] = math.log(max(math.sqrt(squares / held), floor))
        out[2, i] = math.log(max(support[i] / n, _LEAST_WEIGHT))
    if equal:
        out[1] = math.log(max(math.sqrt(common / n), floor))
    return likelihood


@jit
def _climb(
    samples: FloatArray, theta: FloatArray, equal: bool, floor: float, max_iter: int, tol: float
) -> tuple[float, int, bool]:
    """Run accelerated EM on `theta`, in place; return the log likelihood, the iterations and whether it converged.

    It has converged when two iterations and the jump after them gain less than `tol`.
    """
    one, two, ahead = np.empty_like(theta), np.empty_like(theta), np.empty_like(theta)
    iterations, before = 0, -math.inf
    while True:
        likelihood = _em_map(samples, theta, equal, floor, one)
        _em_map(samples, one, equal, floor, two)
        iterations += 2
        if likelihood - before < tol or iterations >= max_iter:
            return likelihood, iterations, likelihood - before < tol
        before = likelihood
        step, bend = one - theta, two - one - (one - theta)
        bend2 = np.sum(bend * bend)
        jump = min(math.sqrt(np.sum(step * step) / bend2), _LONGEST_JUMP) if bend2 > 0.0 else 1.0
        theta[:] = two
        if jump > 1.0:
            ahead[:] = one - step + 2.0 * jump * step + jump * jump * bend
            ahead[1] = np.maximum(ahead[1], math.log(floor))
            ahead[2] -= math.log(np.sum(np.exp(ahead[2])))
            # One EM iteration makes a proper mixture of it; it must not be worse than where the jump began.
            iterations += 1
            if np.isfinite(ahead).all() and _em_map(samples, ahead, equal, floor, one) > likelihood:
                theta[:] = one


@dataclass(frozen=True, slots=True)
class _Solution:
    theta: FloatArray
    log_likelihood: float
    n_iter: int
    converged: bool


class _Search:
    """The best mixture of each number of components, one after the other."""

    def __init__(self, samples: FloatArray, *, equal: bool, floor: float, max_iter: int, tol: float) -> None:
        self._samples, self._equal, self._floor = samples, equal, floor
        self._max_iter, self._tol = max_iter, tol

    def best(self, k: int) -> _Solution:
        """Find the best mixture of k components."""
        found = self._finished([partitions(self._samples, 1, self._floor)[0]])
        for count in range(2, k + 1):
            starts = partitions(self._samples, count, self._floor) + split(found.theta, self._floor)
            found = self._finished(starts)
            for _ in range(ROUNDS):
                other = self._finished(merged_and_split(found.theta, self._floor))
                if other.log_likelihood <= found.log_likelihood + self._tol:
                    break
                found = other
        return found

    def _finished(self, starts: list[FloatArray]) -> _Solution:
        """Follow every start a little, the best of them to the end; return the best end."""
        tried = []
        for theta in starts:
            start = np.ascontiguousarray(theta)  # one layout, one compiled kernel
            if self._equal:
                start[1] = 0.5 * math.log(np.exp(2.0 * start[1]) @ np.exp(start[2]))
            likelihood, *_ = _climb(self._samples, start, self._equal, self._floor, SHORT_ITER, 0.0)
            tried.append((likelihood, start))
        tried.sort(key=lambda pair: -pair[0])
        ends = []
        for _, theta in tried[:KEPT]:
            outcome = _climb(self._samples, theta, self._equal, self._floor, self._max_iter, self._tol)
            ends.append(_Solution(theta, *outcome))
        return max(ends, key=lambda end: end.log_likelihood)


def fit_gaussians(
    samples: ArrayLike,
    k: int,
    *,
    variances: Variances | str = Variances.FREE,
    floor: float = 0.01,
    max_iter: int = 5000,
    tol: float = 1.0e-7,
) -> PlainFit:
    """Fit k Gaussians to samples by maximum likelihood, from many starts.

    `samples` (n,) array_like: samples, in any unit; values that are not finite are left out.
    `k`: components, 1 to n.
    `variances`: ``equal``: one unknown common sigma; ``free``: each component has its own.
    `floor`: least sigma, as a share of the samples' standard deviation, in (0, 1). Without one the likelihood has no
      bound: a component may shrink onto one sample.
    `max_iter`: most EM iterations of one start, at least 2.
    `tol`: a start has converged when one accelerated step gains less than this, nat; above 0.
    Returns PlainFit: the best fit found. The same samples, in any order, give the same fit.
    Raises ValueError: If there is no finite sample, all are equal, or a value is out of these bounds.
    """
    values = readings_of(samples).value
    kind = Variances(variances)
    if not 1 <= k <= len(values):
        raise ValueError(f"k: {k} is not 1 to {len(values)}, the number of samples")
    if not 0 < floor < 1 or max_iter < 2 or not tol > 0:
        raise ValueError(f"floor {floor} must be in (0, 1), max_iter {max_iter} at least 2 and tol {tol} above 0")
    centre, spread = float(values.mean()), float(values.std())
    if not spread > 0:
        raise ValueError("samples: all are equal")
    search = _Search((values - centre) / spread, equal=kind is Variances.EQUAL, floor=floor, max_iter=max_iter, tol=tol)
    found = search.best(k)
    order = np.argsort(found.theta[0], kind="stable")
    means, log_sigmas, log_weights = found.theta[:, order]
    weights = np.exp(log_weights)
    return PlainFit(
        weights=weights / weights.sum(),
        means=centre + spread * means,
        sigmas=spread * np.exp(log_sigmas),
        log_likelihood=found.log_likelihood - len(values) * math.log(spread),
        n_iter=found.n_iter,
        converged=found.converged,
    )
