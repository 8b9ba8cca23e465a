"""The wander of a camera: all means walk together, by an unknown way.

The ranges of a real camera, such as a VL53L0X, wander within minutes by tenths of their noise. A random walk describes
this; a course in time is known as well as the walk lets it be. Its size is one of a few, with probabilities
that the recording of the scene gives, and is integrated out.

A way of all means beyond the reach of a pixel's noise is no wander: something moves, and `straight_way` finds it.

References
----------
Durbin and Koopman, Time Series Analysis by State Space Methods, 2.1, for the local level model; Patterson and Thompson,
Biometrika 58 (1971) 545, for a likelihood of contrasts, which no trend changes.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp
from scipy.stats import kendalltau, norm

from tofmix.arrays import BoolArray, FloatArray
from tofmix.simulation.measured_scene import UNKNOWN_WALK, WALKS

FARTHEST_SCORE = np.float32(4.0)
"""Largest score in the statistics: one sample must not determine a fourth power."""


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


def frame_levels(away: FloatArray) -> FloatArray:
    """What the samples of each frame have in common (frame,), NaN for frames without a sample.

    Each pixel has its own level, found together with those of the frames: it does not matter which pixels are valid
    when.

    Parameters
    ----------
    away : (frame, pixel) float64
        Samples, or their differences from a model; NaN where there is none.

    References
    ----------
    Tukey, Exploratory Data Analysis, 1977, chapter 11: median polish.
    """
    there = np.isfinite(away)
    some = np.asarray(there.any(axis=1))
    out = np.full(len(away), np.nan)
    if not some.any():
        return out
    away = away[some][:, there.any(axis=0)]
    level = np.zeros(len(away))
    polished = 30  # turns of the levels of pixels and frames
    for _ in range(polished):
        own = np.nanmedian(away - level[:, None], axis=0)
        level = np.nanmedian(away - own, axis=1)
    out[some] = level
    return out


def uneven_way(off_mm: FloatArray, range_mm: FloatArray, time_s: FloatArray) -> FloatArray:
    """What samples off a steady way have in common in each frame, in proportion to range (frame,), beside a line.

    Parameters
    ----------
    off_mm : (frame, pixel) float64
        Samples off their way; NaN where there is none.
    range_mm : (frame, pixel) float64
        Ranges on this way.
    time_s : (frame,) float64
        Time of each frame. Frames of fewer than four samples have what their neighbours in time have.
    """
    least = 4  # samples of a frame
    levels = frame_levels(off_mm / range_mm)
    told = np.isfinite(off_mm).sum(axis=1) >= least
    if told.sum() < least:
        return np.zeros(len(off_mm))
    levels = np.interp(time_s, time_s[told], levels[told])
    line = np.polynomial.Polynomial.fit(time_s[told], levels[told], 1)
    return np.asarray(levels - line(time_s))


class _Lines(NamedTuple):
    """Resistant lines of pixels. Arrays are (frame,) and (pixel,); of pixels without one, `told` is False."""

    since: FloatArray  # s, from the middle of the time
    slope: FloatArray  # mm/s, 0 where it is not told
    change_mm: FloatArray  # from the first third of the time to the last
    sigma_mm: FloatArray  # of samples about the line
    error_mm: FloatArray  # of the change
    told: BoolArray


def _lines(samples: FloatArray, time_s: FloatArray) -> _Lines:
    """Lines through the medians of the first and the last third of the time.

    References
    ----------
    Tukey, Exploratory Data Analysis, 1977, chapter 10: the resistant line.
    """
    third = max(len(samples) // 3, 1)
    early, late = slice(third), slice(len(samples) - third, None)
    since = time_s - 0.5 * (time_s[0] + time_s[-1])
    way_s = float(np.median(since[late]) - np.median(since[early]))
    count = np.minimum(np.isfinite(samples[early]).sum(axis=0), np.isfinite(samples[late]).sum(axis=0))
    told = (count > 0) & (way_s > 0)
    change, sigma, error = np.zeros((3, samples.shape[1]))
    slope = np.zeros(samples.shape[1])
    if told.any():
        own = samples[:, told]
        change[told] = np.nanmedian(own[late], axis=0) - np.nanmedian(own[early], axis=0)
        slope[told] = change[told] / way_s
        rest = own - since[:, None] * slope[told]
        sigma[told] = np.nanmedian(np.abs(rest - np.nanmedian(rest, axis=0)), axis=0) / norm.ppf(0.75)
        error[told] = math.sqrt(math.pi / 2.0) * sigma[told] * np.sqrt(2.0 / count[told])  # of two medians
    return _Lines(since, slope, change, sigma, error, told)


def straight_way(samples: FloatArray, time_s: FloatArray, alpha: float) -> float | None:
    """The way of all means along a line, mm, if it is beyond the reach of a pixel's noise; None if it is not.

    If all together do not go one way, that of those pixels which do, one by one.

    Parameters
    ----------
    samples : (frame, pixel) float64
        Ranges, mm; NaN where there is none.
    time_s : (frame,) float64
        Time of each frame.
    alpha : float
        Level of the test that the means go one way.

    References
    ----------
    Mann, Econometrica 13 (1945) 245.
    """
    of_pixels = _lines(samples, time_s)
    if not of_pixels.told.any():
        return None
    apart = np.diff(np.unique(samples[np.isfinite(samples)]))
    cell = float(apart.min()) / math.sqrt(12.0) if apart.size else 0.0  # of values on a grid
    way = _way(samples, of_pixels.told, time_s)
    far = FARTHEST_SCORE * math.hypot(float(np.median(of_pixels.sigma_mm[of_pixels.told])), cell)
    levels = frame_levels(samples[:, of_pixels.told])
    if abs(way) >= far and float(kendalltau(of_pixels.since, levels, nan_policy="omit").pvalue) < alpha:
        return way
    straight = 1.5 * FARTHEST_SCORE  # change of one pixel, in sigma: noise with a memory rarely goes so straight
    moving = of_pixels.told & (np.abs(of_pixels.change_mm) > straight * np.hypot(of_pixels.sigma_mm, cell))
    slopes = of_pixels.slope[moving]
    alike = 0.25  # part of a speed by which pixels of one body differ
    together = np.abs(slopes - slopes[:, None]) < alike * np.abs(slopes[:, None])
    moving[moving] = together[int(together.sum(axis=1).argmax())] if slopes.size else False
    least, part = 3, 0.02  # pixels, and their part, that are no chance
    return _way(samples, moving, time_s) if moving.sum() >= max(least, part * of_pixels.told.sum()) else None


def _way(samples: FloatArray, pixels: BoolArray, time_s: FloatArray) -> float:
    """The way of some pixels along a line, mm."""
    line = _lines(frame_levels(samples[:, pixels])[:, None], time_s)
    return float(line.slope[0] * (time_s[-1] - time_s[0]))


def straight_courses(samples: FloatArray, time_s: FloatArray) -> FloatArray:
    """The ways of pixels along a line, (frame, pixel), mm, 0 in the middle of the time; parameters as `straight_way`.

    A pixel whose line is within three standard errors of none has none.
    """
    lines, clearly = _lines(samples, time_s), 3.0
    return lines.since[:, None] * np.where(np.abs(lines.change_mm) > clearly * lines.error_mm, lines.slope, 0.0)
