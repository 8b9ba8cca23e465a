"""The noise of a group of series of which some see more than one surface.

Use `locate` on the logarithms of their standard deviations. Two surfaces that a
series cannot tell apart make it wider, never narrower. So a series is either
single, its variance chi-square about sigma^2, or wider by an unknown factor.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray, IntArray

_STEP = 0.005  # of log sigma: half a per cent
_REACH = 0.45  # from the median down to the least sigma that is tried, and a third of it up
_CONTAMINATED = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])  # share of wider series
_EXCESS = (0.08, 0.25, 0.7)  # mean of the exponential log factor by which they are wider
_DISPERSION = (1.0, 0.6, 0.35, 0.2, 0.1)  # factors on the degrees of freedom: sigma itself differs between pixels
_BACKGROUND = 0.002  # density of series that are neither, so that no single one decides


def locate(log_sigma: FloatArray, degrees: int) -> float:
    """Log sigma of the single series in a group, at most 60 % of which see more than one surface.

    Parameters
    ----------
    log_sigma : (n,) float64
        Half the logarithm of each series' variance.
    degrees : int
        Degrees of freedom of the variances.

    Returns
    -------
    float
        The mean of log sigma over all shares, factors and dispersions that are tried, by their likelihood.
    """
    centre = float(np.median(log_sigma))
    places, counts = np.unique(np.rint((log_sigma - centre) / _STEP).astype(np.int64), return_counts=True)
    shifts = np.arange(-int(_REACH / _STEP), int(_REACH / _STEP) // 3 + 1)
    offset = places[None, :] - shifts[:, None]
    likelihood = np.stack(
        [_likelihoods(offset, counts, dispersion * degrees, excess) for dispersion in _DISPERSION for excess in _EXCESS]
    )
    weight = np.exp(likelihood - likelihood.max()).sum(axis=(0, 2))
    return centre + _STEP * float(weight @ shifts / weight.sum())


def _likelihoods(offset: IntArray, counts: IntArray, degrees: float, excess: float) -> FloatArray:
    """Log likelihood (shift, share) for one dispersion and excess; `offset` (shift, place) in steps."""
    grid = np.arange(-1200, 1201)
    single = np.exp(_log_density(_STEP * grid, degrees))
    steps = np.rint(-excess * np.log(1.0 - (np.arange(8) + 0.5) / 8) / _STEP).astype(np.int64)
    wider = np.mean([np.exp(_log_density(_STEP * (grid - u), degrees)) for u in steps], axis=0)
    at = np.clip(offset, grid[0], grid[-1]) - grid[0]
    shares = _CONTAMINATED[:, None, None]
    density = (1.0 - shares) * single[at] + shares * wider[at] + _BACKGROUND
    total: FloatArray = (np.log(density) @ counts).T
    return total


def _log_density(z: NDArray[np.floating], degrees: float) -> FloatArray:
    """Log density of z = log(s / sigma), s^2 / sigma^2 being chi-square over its degrees of freedom."""
    half = degrees / 2.0
    constant = math.log(2.0) + half * math.log(half) - math.lgamma(half)
    density: FloatArray = constant + degrees * z - half * np.exp(2.0 * z)
    return density
