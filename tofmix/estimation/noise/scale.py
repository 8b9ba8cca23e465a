"""The noise of groups of series of which some see more than one surface.

Use `locate` on the logarithms of their standard deviations, one group a range. Two surfaces that a series does not
separate make it wider, never narrower. So a series is either single, its variance chi-square about sigma^2, or wider by
an unknown factor. The share of wider series, their factor, and the spread of sigma between pixels come from all groups
together, because a single group has too few series.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray, IntArray

STEP = 0.005
"""Step of log sigma in all tables: half a per cent."""

GRID = np.arange(-1200, 1201)
"""Places, in steps, at which densities are kept."""

_REACH = 0.45  # from the median down to the least sigma that is tried, and a third of it up
_CONTAMINATED = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])  # share of wider series
_EXCESS = (0.08, 0.25, 0.7)  # mean of the exponential log factor by which they are wider
_DISPERSION = (1.0, 0.6, 0.35, 0.2, 0.1)  # factors on the degrees of freedom: sigma itself differs between pixels
_BACKGROUND = 0.002  # density of series that are neither, so that no single one decides
_ROUNDS = 60  # EM steps for the chances of the mixtures
_PRIOR_GROUPS = 1.0  # weight of equal chances for all mixtures, in groups


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Located:
    """Result of `locate`.

    `log_sigma` and its standard error `error`, both (group,); `chances` (mixture,) of the shares, excesses and
    dispersions that were tried, learned from all groups, for `single_share`.
    """

    log_sigma: FloatArray
    error: FloatArray
    chances: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ScaleMixtures:
    """Densities of log(s / sigma) on `GRID`, for every share, excess and dispersion that is tried.

    `single` and `density` are (mixture, place): the share of single series times their density, and that of all.
    `degrees` (mixture,) are the degrees of freedom, less where sigma differs between pixels.
    """

    single: FloatArray
    density: FloatArray
    degrees: FloatArray

    @classmethod
    @cache
    def of(cls, degrees: int) -> Self:
        """Mixtures for variances of so many degrees of freedom."""
        single, density, left = [], [], []
        for dispersion in _DISPERSION:
            one = np.exp(_log_density(STEP * GRID, dispersion * degrees))
            for excess in _EXCESS:
                steps = np.rint(-excess * np.log(1.0 - (np.arange(8) + 0.5) / 8) / STEP).astype(np.int64)
                wider = np.mean([np.exp(_log_density(STEP * (GRID - u), dispersion * degrees)) for u in steps], axis=0)
                for share in _CONTAMINATED:
                    single.append((1.0 - share) * one)
                    density.append(single[-1] + share * wider + _BACKGROUND)
                    left.append(dispersion * degrees)
        return cls(np.array(single), np.array(density), np.array(left))


def locate(groups: Sequence[FloatArray], degrees: int) -> Located:
    """Log sigma of the single series in each group, at most 60 % of which see more than one surface.

    Parameters
    ----------
    groups : sequence of (n,) float64
        Half the logarithm of each series' variance, group by group; at least one group, none empty.
    degrees : int
        Degrees of freedom of the variances.

    Returns
    -------
    Located
        Means and standard deviations over all mixtures that are tried, by their likelihood and by how well they
        do in all groups (empirical Bayes).
    """
    log_density = np.log(ScaleMixtures.of(degrees).density)
    centre = [float(np.median(group)) for group in groups]
    shifts = np.arange(-int(_REACH / STEP), int(_REACH / STEP) // 3 + 1)
    tables = np.array([_likelihoods(g - c, shifts, log_density) for g, c in zip(groups, centre, strict=True)])
    tables -= tables.max(axis=(1, 2), keepdims=True)
    likelihood = np.exp(tables)
    evidence = likelihood.sum(axis=1)
    chances = np.full(evidence.shape[1], 1.0 / evidence.shape[1])
    for _ in range(_ROUNDS):
        mine = evidence * chances
        mine /= mine.sum(axis=1, keepdims=True)
        chances = (mine.sum(axis=0) + _PRIOR_GROUPS / len(chances)) / (len(groups) + _PRIOR_GROUPS)
    weight = likelihood @ chances
    weight /= weight.sum(axis=1, keepdims=True)
    mean = weight @ shifts
    error = np.sqrt(np.maximum((weight * (shifts - mean[:, None]) ** 2).sum(axis=1), 1.0))
    return Located(log_sigma=np.array(centre) + STEP * mean, error=STEP * error, chances=chances)


def single_share(away: FloatArray, degrees: int, chances: FloatArray) -> FloatArray:
    """How surely each series is single; `away` is its log standard deviation less log sigma, any shape."""
    mixtures = ScaleMixtures.of(degrees)
    at = place(away)
    share: FloatArray = (chances @ mixtures.single)[at] / (chances @ mixtures.density)[at]
    return share


def place(away: FloatArray) -> IntArray:
    """Number of the nearest place of `GRID`; values beyond it are put at its ends."""
    steps = np.clip(np.rint(away / STEP), GRID[0], GRID[-1])
    return np.asarray(steps - GRID[0], dtype=np.int64)


def _likelihoods(away: FloatArray, shifts: IntArray, log_density: FloatArray) -> FloatArray:
    """Log likelihood (shift, mixture) of a group, `away` from its middle."""
    places, counts = np.unique(np.rint(away / STEP).astype(np.int64), return_counts=True)
    at = np.clip(places[None, :] - shifts[:, None], GRID[0], GRID[-1]) - GRID[0]
    total = np.zeros((len(shifts), len(log_density)))
    for k in range(len(log_density)):
        total[:, k] = log_density[k][at] @ counts
    return total


def _log_density(z: NDArray[np.floating], degrees: float) -> FloatArray:
    """Log density of z = log(s / sigma), s^2 / sigma^2 being chi-square over its degrees of freedom."""
    half = degrees / 2.0
    constant = math.log(2.0) + half * math.log(half) - math.lgamma(half)
    density: FloatArray = constant + degrees * z - half * np.exp(2.0 * z)
    return density
