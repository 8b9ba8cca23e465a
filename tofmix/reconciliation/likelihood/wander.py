"""The wander of a camera: all means walk together, by an unknown way.

The ranges of a real camera, such as a VL53L0X, wander within minutes by tenths of their noise. A random walk describes
this; a course in time is known as well as the walk lets it be. Its size is one of a few, with probabilities
that the recording of the scene gives, and is integrated out.

References
----------
Durbin and Koopman, Time Series Analysis by State Space Methods, 2.1, for the local level model; Patterson and Thompson,
Biometrika 58 (1971) 545, for a likelihood of contrasts, which no trend changes.
"""

import numpy as np
from scipy.special import logsumexp

from tofmix.arrays import FloatArray
from tofmix.simulation.measured_scene import UNKNOWN_WALK, WALKS


def gains(slope: FloatArray, information: FloatArray, *, longer: float = 1.0, degree: int = 0) -> FloatArray:
    """What a walk of each of `WALKS` changes in the log-likelihood (size,), nats.

    Parameters
    ----------
    slope, information : (frame,) float64
        Of the log-likelihood in a bias of all samples of the frame, in units of sigma.
    longer : float
        Length of this recording over that of the scene: the variance of a walk grows with it.
    degree : int
        Of the polynomial in time that is free; 0 is a constant.
    """
    most_blocks = 10  # of time, in which a walk is told
    count = min(most_blocks, slope.size)
    if count <= degree + 1:
        return np.zeros(len(WALKS))
    block = np.arange(slope.size) * count // slope.size
    pull = np.asarray(np.bincount(block, slope), dtype=np.float64)
    told = np.bincount(block, information)
    free = np.vander(np.linspace(-1.0, 1.0, count), degree + 1)
    seen = free * told[:, None]
    inverse = np.linalg.pinv(free.T @ seen, hermitian=True)
    pull = pull - seen @ (inverse @ (free.T @ pull))
    known = np.diag(told) - seen @ inverse @ seen.T
    steps = np.tril(np.ones((count, count)), -1)[:, :-1] / np.sqrt(count - 1)
    value, axes = np.linalg.eigh(steps.T @ known @ steps)
    along = (axes.T @ (steps.T @ pull)) ** 2
    variance = longer * np.square(WALKS)[:, None]
    value = np.maximum(value, 0.0)
    return np.asarray(0.5 * (along * variance / (1.0 + value * variance) - np.log1p(value * variance)).sum(axis=1))


def gain(of_sizes: FloatArray, probability: tuple[float, ...]) -> float:
    """What a walk of unknown size changes in the log-likelihood, nats."""
    return float(logsumexp(of_sizes, b=np.asarray(probability)))


def probabilities(z: FloatArray, *, frame_noise: float, repeats: float) -> tuple[float, ...]:
    """Probability of each of `WALKS` by the recording of a scene.

    Parameters
    ----------
    z : (frame, pixel) float64
        Residuals of samples about their pixel's mean, in sigma, NaN where there is none.
    frame_noise : float
        Standard deviation of what the samples of a frame have in common, in sigma.
    repeats : float
        Frames that are worth one independent frame, by the memory of the noise.
    """
    there = np.isfinite(z)
    each = float(np.nanmean(z**2)) if there.any() else 0.0
    if not each:
        return UNKNOWN_WALK
    steady = 2  # degree of a course that is a change and no walk: a drift, or the beginning of a warm-up
    count = there.sum(axis=1)
    free = repeats * (1.0 + count / each * frame_noise**2)
    found = gains(np.nansum(z, axis=1) / each / free, count / each / free, degree=steady) + np.log(UNKNOWN_WALK)
    share = np.exp(found - logsumexp(found))
    return tuple(float(p) for p in share)
