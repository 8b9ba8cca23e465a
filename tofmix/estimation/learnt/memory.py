"""Memory of the noise: the correlation of errors from one frame to the next, as of AR(1) noise.

It changes no fit of a pixel, but sigma, standard errors, and the gains that noise alone gives.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.clusters import ClusterFits
from tofmix.estimation.learnt.law import precision_of_t
from tofmix.estimation.learnt.model import PixelNoise

LEAST_MEMORY, MOST_MEMORY = 0.05, 0.95
"""Correlations below the first count as 0, and none above the second is given."""

LEAST_PAIRS = 100
"""Least pairs of neighbouring frames: fewer determine a correlation to no better than 0.1."""

_CENTRAL = 4.0
"""Largest error of a surface, in sigmas; a larger one is background."""

_SIGNIFICANT = 3.0
"""Standard errors of a correlation, 1 / sqrt(pairs) for errors without memory, up to which it counts as 0."""

_ROUNDS = 30
"""Iterations for the part of the memory that fitted means and drifts hide."""


def centred(error: FloatArray) -> FloatArray:
    """Errors (cluster, frame) less the mean of each cluster: that of rounded samples is not 0, and is no memory."""
    known = np.isfinite(error) & (np.abs(error) < _CENTRAL)
    mean = np.where(known, error, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.asarray(error - mean[:, None])


def memory_of(fits: ClusterFits, noise: PixelNoise) -> float:
    """Correlation of the errors of all clusters from frame to frame; 0 where noise without memory may give it.

    The fitted mean and each polynomial of a drift remove a part of the slow errors: `taken` / n of their variance,
    which is (1 + rho) / (1 - rho) times that of all errors for AR(1) noise. This part is missing from the covariance
    and from the variance, and is added again.

    Parameters
    ----------
    fits : ClusterFits
        Clusters of one surface, fitted under `noise`.
    noise : PixelNoise
        The noise without memory.
    """
    a, b = fits.error[:, :-1], fits.error[:, 1:]
    both = np.isfinite(a) & np.isfinite(b) & (np.abs(a) < _CENTRAL) & (np.abs(b) < _CENTRAL)
    if both.sum() < LEAST_PAIRS:
        return 0.0
    x, y = a[both], b[both]
    n = max(float(np.median(fits.support)), 2.0)
    seen = float((x * y).mean() / math.sqrt((x * x).mean() * (y * y).mean()))
    taken = 1.0
    for d, scale in enumerate(noise.drift_mm.tolist()):
        information = n * noise.laws()[0].information / (float(np.median(fits.sigma)) ** 2 * (2.0 * d + 3.0))
        taken += information / (information + precision_of_t(0.0, scale)) if scale > 0.0 else 0.0
    found = seen
    for _ in range(_ROUNDS):
        slow = (1.0 + found) / (1.0 - found) * taken / n
        found = min(max(seen + slow * (1.0 - seen), 0.0), MOST_MEMORY)
    return found if found > max(LEAST_MEMORY, _SIGNIFICANT / math.sqrt(both.sum())) else 0.0
