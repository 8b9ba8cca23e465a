"""The most probable hypothesis of each pixel, its kind among the kinds, and their prior probabilities."""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.unmixing.functions import logsumexp
from tofmix.unmixing.image import TINY, ComplexArray, PhasorImage, inverse_form
from tofmix.unmixing.surface_fit import MOST_SURFACES, NeighbourSurfaces


class Kind(IntEnum):
    """Kind of a hypothesis."""

    UNKNOWN = 0
    NEW = 1
    CONTINUED = 2
    OTHER_REFLECTANCE = 3
    PAIR = 4
    TRIPLE = 5
    EMPTY = 6


PRIORS = {
    Kind.NEW: 0.02,
    Kind.CONTINUED: 0.5,
    Kind.OTHER_REFLECTANCE: 0.03,
    Kind.PAIR: 0.4,
    Kind.TRIPLE: 0.05,
    Kind.EMPTY: 0.5,
}
"""Prior probabilities at edges, where alone pixels are in doubt; each is shared by the hypotheses of its kind. Beside
open space, that fills a pixel as probably as a surface does.
"""

ENDS = 3
"""Most surfaces of a pixel."""

OPEN = MOST_SURFACES
"""Number of the first kind of open space among the ends."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenSpace:
    """The return of a pixel without a surface.

    Parameters
    ----------
    nearby : (pixel,) bool
        Whether a pixel may see it.
    phasor : complex
        Mean phasor.
    variance : float
        Variance of its real part, and of its imaginary part, from pixel to pixel, beyond noise.
    scatter : float
        Variance of one sample's, likewise, by noise; 0 where no samples tell.
    """

    nearby: BoolArray
    phasor: complex
    variance: float
    scatter: float

    def log_density(self, image: PhasorImage, pixels: IntArray) -> FloatArray:
        """Log density (n,) of the mean phasors of pixels that open space fills, nat; -inf where it is not nearby."""
        noise = self.scatter / np.maximum(image.samples[pixels], 1.0)
        even = (self.variance + noise)[:, np.newaxis] * np.array([1.0, 1.0, 0.0])
        covariance = even if self.scatter > 0.0 else even + image.mean_covariance[pixels]
        return np.where(self.nearby[pixels], log_normal(image.phasor[pixels] - self.phasor, covariance), -np.inf)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LikeliestHypotheses:
    """The most probable hypothesis of pixels (n,).

    Parameters
    ----------
    kind : (n,) int64
        `Kind`.
    probability : (n,) float64
        Its posterior.
    plane : (n, 3) float64
        CONTINUED: m of the surface's plane, 1 / mm.
    is_distant : (n,) bool
        CONTINUED: whether the surface is known from elsewhere in the image.
    range_mm, range_variance, share, share_variance : (n, ENDS) float64
        PAIR, TRIPLE and EMPTY: the surfaces; NaN past the last, an infinite range is open space.
    is_known : (n,) bool
        PAIR and TRIPLE: whether all ends are (`tofmix.unmixing.neighbours.Members`).
    is_fresh : (n,) bool
        CONTINUED, PAIR and TRIPLE: whether the surface, or one of the ends, is.
    chord : (n,) complex128
        PAIR: difference of both phasors.
    scatter : (n,) float64
        PAIR: variance along the chord of samples that are of one surface each, or sums, by their noise alone; infinite
        where it is not known.
    log_density : (n,) float64
        Log density of the mean phasor in units of the image's median amplitude, nat.
    log_evidence : (n,) float64
        Likewise, under all hypotheses.
    """

    kind: IntArray
    probability: FloatArray
    plane: FloatArray
    is_distant: BoolArray
    range_mm: FloatArray
    range_variance: FloatArray
    share: FloatArray
    share_variance: FloatArray
    is_known: BoolArray
    is_fresh: BoolArray
    chord: ComplexArray
    scatter: FloatArray
    log_density: FloatArray
    log_evidence: FloatArray


class Best:
    """Keeps, pixel by pixel, the most probable of the hypotheses that are put to it."""

    def __init__(self, count: int, likely: float) -> None:
        self._likely = likely
        self._log = np.full(count, -np.inf)
        self._logs: list[FloatArray] = []
        ends = (count, ENDS)
        self._kept: dict[str, NDArray[Any]] = {
            "kind": np.zeros(count, np.int64),
            "plane": np.zeros((count, 3)),
            "is_distant": np.zeros(count, bool),
            "range_mm": np.full(ends, np.nan),
            "range_variance": np.full(ends, np.nan),
            "share": np.full(ends, np.nan),
            "share_variance": np.full(ends, np.nan),
            "is_known": np.ones(count, bool),
            "is_fresh": np.zeros(count, bool),
            "chord": np.zeros(count, np.complex128),
            "scatter": np.zeros(count),
            "log_density": np.full(count, np.nan),
        }
        self._blank = {name: values[:1].copy() for name, values in self._kept.items()}

    def put(
        self,
        kind: Kind,
        log_prior: FloatArray,
        log_density: FloatArray,
        *,
        which: IntArray | None = None,
        **values: NDArray[Any],
    ) -> None:
        """Put one hypothesis of each pixel, or of `which`: log prior and density (n,), and its values by field."""
        rows = np.arange(len(self._log)) if which is None else which
        log = log_prior + np.where(np.isfinite(log_density), log_density, -np.inf)
        everywhere = np.full(len(self._log), -np.inf)
        everywhere[rows] = log
        self._logs.append(everywhere)
        better = np.flatnonzero(log > self._log[rows])
        changed = rows[better]
        self._log[changed] = log[better]
        everything = {"kind": np.full(len(log), int(kind)), "log_density": log_density} | values
        for name, kept in self._kept.items():
            kept[changed] = everything[name][better] if name in everything else self._blank[name]

    def unexplained(self) -> IntArray:
        """Pixels (m,) that no neighbouring surfaces explain."""
        total = logsumexp(np.stack(self._logs))
        vague = (self._kept["kind"] == Kind.NEW) | ~self._kept["is_known"]
        return np.flatnonzero(vague | (np.exp(self._log - total) < self._likely))

    def findings(self) -> LikeliestHypotheses:
        """The kept hypothesis, with its probability among all."""
        total = logsumexp(np.stack(self._logs))
        return LikeliestHypotheses(probability=np.exp(self._log - total), log_evidence=total, **self._kept)


_LOG_TWO_PI = math.log(2.0 * math.pi)


def log_share(prior: float, chance: FloatArray | BoolArray, total: FloatArray) -> FloatArray:
    """Log (n,) of a prior that hypotheses of chances of `total` share; -inf where the one in question has none."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(prior * chance / np.maximum(total, 1.0)))


def place_chance(neighbours: NeighbourSurfaces, aside: float) -> FloatArray:
    """Chance (n, surface) of a surface by its place: it fills one of the eight pixels around, or none of them."""
    return np.where(neighbours.touches, 1.0, aside)


def log_normal(difference: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Log density (n,) of differences of phasors (n,) under a Gaussian of covariances (n, 3)."""
    determinant = np.maximum(covariance[:, 0] * covariance[:, 1] - covariance[:, 2] ** 2, TINY)
    return np.asarray(-0.5 * inverse_form(covariance, difference, difference) - 0.5 * np.log(determinant) - _LOG_TWO_PI)
