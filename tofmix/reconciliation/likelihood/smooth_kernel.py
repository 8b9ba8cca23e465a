"""The log-likelihood where cells of whole mm are narrow against every sigma: density times width, pixels abreast.

A frame's samples are worked on together by loops that vectorise, where `tofmix.reconciliation.likelihood.kernel` goes
sample by sample. It chooses, and takes all that this leaves: lattices, folds, and noise of about a millimetre.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.compiled.vector import exp_minus, log_of, total_of

_ROUNDED = 1.0 / 12.0  # variance of whole mm
_PER_SIGMA = 1.0 / math.sqrt(2.0 * math.pi)

_Found = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Of a frame's pixels: samples, densities, and those times slopes and information."""
_Ranks = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Arrays (rank, pixel) of the components that a pixel has: scale, mean, variance, rate, and whether it takes a bias."""
_Now = tuple[FloatArray, FloatArray]
"""Arrays (rank, pixel) that hold for one frame: precision, and scale times its root."""


class LatentEvents(NamedTuple):
    """A mixture over the latent event, with its changes from frame to frame, as kernels take it."""

    key: IntArray  # (frame,): Which of the mixture's times holds
    since: FloatArray  # (frame,): Time since then, s
    frame_bias: FloatArray  # (frame,): Bias of every lit component, mm
    extra_variance: FloatArray  # (frame,): Likewise, mm2
    pixel_bias: FloatArray  # (pixel,): Bias of every lit component, mm
    weight: FloatArray  # (time, component, pixel), as are the others
    mean: FloatArray  # mm
    sigma: FloatArray  # mm
    rate: FloatArray  # mm/s
    lit: BoolArray


@jit
def smooth_log_likelihood(
    samples: NDArray[np.uint16],
    pixels: IntArray,
    frames: IntArray,
    events: LatentEvents,
    log_invalid: FloatArray,
    random_density: FloatArray,
    ends: IntArray,
    by_pixel: FloatArray,
    by_frame: FloatArray,
) -> None:
    """Add up log-likelihoods and their slopes against a bias, for cells of one mm.

    Parameters
    ----------
    pixels : (n,) int64
        Which ones to go over, those with many components first.
    log_invalid : (time, pixel) float64
        Log probability of an invalid sample.
    ends : (rank,) int64
        How many pixels have at least 1, 2, ... components.

    The others are those of `tofmix.reconciliation.likelihood.kernel.log_likelihood`.
    """
    key, since, frame_bias, extra_variance, pixel_bias, weight, mean, sigma, rate, lit = events
    n, ranks = len(pixels), len(ends)
    parts = (
        np.empty((ranks, n)),
        np.empty((ranks, n)),
        np.empty((ranks, n)),
        np.empty((ranks, n)),
        np.empty((ranks, n)),
    )
    found = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    now = np.empty((ranks, n)), np.empty((ranks, n))
    lost, valid, log_total, bias, sums = np.empty(n), np.empty(n), np.empty(n), pixel_bias[pixels], np.zeros((4, n))
    time, extra = -1, -1.0
    for t in frames:
        anew = key[t] != time
        if anew:
            time = key[t]
            lost[:] = log_invalid[time][pixels]
            _gather((weight[time], mean[time], sigma[time], rate[time]), lit[time], pixels, parts)
        if anew or extra_variance[t] != extra:
            extra = extra_variance[t]
            for rank in range(ranks):
                _widen(parts, rank, extra, now)
        _begin(samples[t], pixels, random_density, found)
        for rank in range(ranks):
            _add(found, parts, now, rank, ends[rank], bias, (since[t], frame_bias[t]))
        _end(found, lost, valid, log_total)
        rows = log_total, found[2], found[3], valid
        for j in range(4):
            _sum(rows[j], sums[j])
            by_frame[t, j] += total_of(rows[j])
    for j in range(4):
        for i in range(n):
            by_pixel[pixels[i], j] += sums[j, i]


@jit
def _gather(
    mixture: tuple[FloatArray, FloatArray, FloatArray, FloatArray], lit: BoolArray, pixels: IntArray, parts: _Ranks
) -> None:
    """Each pixel's components that have a weight, the others left out."""
    weight, mean, sigma, rate = mixture
    scale, middle, variance, speed, glow = parts
    for i in range(len(pixels)):
        p = pixels[i]
        rank = 0
        for k in range(len(weight)):
            if weight[k, p] > 0.0:
                scale[rank, i] = weight[k, p] * _PER_SIGMA
                middle[rank, i] = mean[k, p]
                variance[rank, i] = sigma[k, p] ** 2 + _ROUNDED
                speed[rank, i] = rate[k, p]
                glow[rank, i] = 1.0 if lit[k, p] else 0.0
                rank += 1
        for left in range(rank, len(scale)):
            scale[left, i], middle[left, i], variance[left, i], speed[left, i], glow[left, i] = 0.0, 0.0, 1.0, 0.0, 0.0


@jit
def _begin(samples: NDArray[np.uint16], pixels: IntArray, random_density: FloatArray, found: _Found) -> None:
    value, total, slope, information = found
    for i in range(len(pixels)):
        value[i] = samples[pixels[i]]
        total[i] = random_density[pixels[i]]
        slope[i] = 0.0
        information[i] = 0.0


@jit
def _widen(parts: _Ranks, rank: int, extra: float, now: _Now) -> None:
    scale, variance, glow = parts[0][rank], parts[2][rank], parts[4][rank]
    precision, height = now[0][rank], now[1][rank]
    for i in range(len(scale)):
        precision[i] = 1.0 / (variance[i] + glow[i] * extra)
        height[i] = scale[i] * math.sqrt(precision[i])


@jit
def _add(
    found: _Found, parts: _Ranks, now: _Now, rank: int, end: int, bias: FloatArray, frame: tuple[float, float]
) -> None:
    """Add one rank's densities, and those times their slopes and information."""
    value, total, slope, information = found[0][:end], found[1][:end], found[2][:end], found[3][:end]
    middle, speed, glow = parts[1][rank][:end], parts[3][rank][:end], parts[4][rank][:end]
    precision, height = now[0][rank][:end], now[1][rank][:end]
    since, frame_bias = frame
    for i in range(len(value)):
        away = value[i] - middle[i] - glow[i] * (speed[i] * since + frame_bias + bias[i])
        pull = away * precision[i]
        inside = height[i] * exp_minus(0.5 * away * pull)
        total[i] += inside
        inside *= glow[i]
        slope[i] += inside * pull
        information[i] += inside * precision[i]


@jit
def _end(found: _Found, lost: FloatArray, valid: FloatArray, log_total: FloatArray) -> None:
    """Divide by the density, and give invalid samples their own probability."""
    value, total, slope, information = found
    for i in range(len(value)):
        here = 1.0 if value[i] > 0.0 else 0.0
        share = here / total[i]
        valid[i] = here
        log_total[i] = here * log_of(total[i]) + (1.0 - here) * lost[i]
        slope[i] *= share
        information[i] *= share


@jit
def _sum(row: FloatArray, into: FloatArray) -> None:
    for i in range(len(row)):
        into[i] += row[i]
