"""Clusters of samples that stand clear of all others in their pixel, and fits of one surface to each.

The noise is learnt from them: a pixel of one surface is one cluster, one of two far apart is two, and a pixel on strong
background is one where its samples crowd. What surrounds a cluster is its background.
"""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.learnt.blocks import take_samples
from tofmix.estimation.learnt.components import (
    BACKGROUND,
    DRIFT,
    LOG_WIDTH,
    MEAN,
    OWN,
    ROWS,
    SIGMA,
    SUPPORT,
    WEIGHT,
    still_row,
)
from tofmix.estimation.learnt.fitting import LEARNING_ITER, LEARNING_TOL, Samples, detrend, fill_times, maximise, mix
from tofmix.estimation.learnt.law import Law
from tofmix.estimation.learnt.trials import CLOSE, densest_place, new_workspace, try_one_more
from tofmix.estimation.noise.kernel import sigma_at
from tofmix.estimation.noise.pixel_noise import beam_of_pixel
from tofmix.learnt_noise import DRIFTS

WINDOW = 16.0
"""A cluster's window reaches this many sigma to either side of its densest place."""

CLEAR = 0.2
"""No other place of the window, `APART` sigma or more away, has more samples together than this part of the densest."""

APART = 4.0
"""Sigmas from which on another crowd of the window may be another surface: two nearer ones overlap in one crowd."""

LEAST_IN_CLUSTER = 8
"""Samples that crowd in a cluster, at least."""

LEAST_SHARE = 0.1
"""Part of the pixel's samples that crowd in a cluster, at least."""

MOST_IN_PIXEL = 3
"""Clusters looked for in a pixel: later ones hold few of its samples."""


class Clusters(NamedTuple):
    """Clusters of pixels: `pixel` (cluster,), and the window of each, `low` and `high` (cluster,), mm."""

    pixel: IntArray
    low: FloatArray
    high: FloatArray


class ClusterFits(NamedTuple):
    """One surface fitted to each cluster, all (cluster,).

    `place` of the surface and `sigma` of the curve there, mm; `log_width`; `drift` (cluster, DRIFTS), mm; `support`,
    the samples that are the surface's; `gain`, nat, of a second surface; `error` (cluster, frame), the standardised
    errors of all samples of the window, NaN where there is none.
    """

    place: FloatArray
    sigma: FloatArray
    log_width: FloatArray
    drift: FloatArray
    support: FloatArray
    gain: FloatArray
    error: FloatArray


@jit
def find_clusters(samples: Float32Array, beam: Beam) -> Clusters:
    """Find the clusters of pixels (pixel, frame)."""
    pixels, frames = samples.shape
    most = pixels * MOST_IN_PIXEL
    owner, low, high, count = np.zeros(most, dtype=np.int64), np.zeros(most), np.zeros(most), 0
    value, time, left = np.empty(frames), np.empty(frames), np.empty(frames)
    for pixel in range(pixels):
        n = take_samples(samples[pixel], value, time)
        own = beam_of_pixel(beam, pixel)
        curve_range, curve_sigma = own.curve_range, own.curve_sigma
        rest = n
        left[:n] = value[:n]
        for _ in range(MOST_IN_PIXEL):
            place, crowd_size = densest_place(left, rest, own, True)  # noqa: FBT003  a kernel's flag
            if crowd_size < max(LEAST_IN_CLUSTER, LEAST_SHARE * n):
                break
            sigma = sigma_at(place, curve_range, curve_sigma)
            a, b = place - WINDOW * sigma, place + WINDOW * sigma
            if _clear(value, n, place, a, b, crowd_size, curve_range, curve_sigma):
                owner[count], low[count], high[count] = pixel, a, b
                count += 1
            kept = 0
            for j in range(rest):
                if not a <= left[j] <= b:
                    left[kept] = left[j]
                    kept += 1
            rest = kept
    return Clusters(owner[:count].copy(), low[:count].copy(), high[:count].copy())


@jit
def _clear(
    y: FloatArray,
    n: int,
    place: float,
    a: float,
    b: float,
    crowd_size: float,
    curve_range: FloatArray,
    curve_sigma: FloatArray,
) -> bool:
    """Whether no other place of the window [a, b] has so many samples together that it may be a surface."""
    sigma = sigma_at(place, curve_range, curve_sigma)
    stop = 0
    for first in range(n):
        stop = max(stop, first)
        while stop < n and y[stop] <= y[first] + 2.0 * CLOSE * sigma:
            stop += 1
        middle = 0.5 * (y[first] + y[stop - 1])
        if a <= middle <= b and abs(middle - place) >= APART * sigma and stop - first > max(CLEAR * crowd_size, 1.0):
            return False
    return True


@jit
def fit_clusters(samples: Float32Array, clusters: Clusters, law: Law, beam: Beam, second: bool) -> ClusterFits:
    """Fit one surface on uniform background to each cluster; with `second`, also find what a second surface gains."""
    count, frames = len(clusters.pixel), samples.shape[1]
    place, sigma, log_width, support = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    drift, gain = np.zeros((count, DRIFTS)), np.zeros(count)
    error = np.full((count, frames), np.nan)
    value, time = np.empty(frames), np.empty(frames)
    work = new_workspace(3, frames, 1)
    fit, scratch = work.fit, work.scratch
    half = 0.5 * (frames - 1) if frames > 1 else 1.0
    for c in range(count):
        n_all = take_samples(samples[clusters.pixel[c]], value, time)
        first = 0
        while first < n_all and value[first] < clusters.low[c]:
            first += 1
        stop = first
        while stop < n_all and value[stop] <= clusters.high[c]:
            stop += 1
        n = stop - first
        data = Samples(value[first:stop], time[first:stop])
        common = beam_of_pixel(beam, clusters.pixel[c])
        own = Beam(
            common.curve_range, common.curve_sigma, np.inf, 1.0, np.inf, np.inf, np.inf, beam.p_outlier,
            beam.outlier_density,
            clusters.low[c], clusters.high[c], beam.pixel_curves,
        )  # fmt: skip
        fill_times(data, scratch)
        for row in range(ROWS):
            fit[row, :] = 0.0
        middle = 0.5 * (clusters.low[c] + clusters.high[c])
        fit[MEAN, 0], fit[SIGMA, 0] = middle, sigma_at(middle, own.curve_range, own.curve_sigma)
        fit[OWN, BACKGROUND] = 0.05
        fit[WEIGHT, 0] = 0.95
        maximise(data, 1, fit, law, own, LEARNING_ITER, LEARNING_TOL, scratch)
        mix(data, 1, fit, law, own, scratch)
        detrend(data, 0, fit, scratch)
        place[c], sigma[c], log_width[c] = fit[MEAN, 0], fit[SIGMA, 0], fit[OWN, LOG_WIDTH]
        support[c] = fit[SUPPORT, 0]
        for d in range(DRIFTS):
            drift[c, d] = fit[DRIFT + d, 0]
        scale = 1.0 / (fit[SIGMA, 0] * np.exp(fit[OWN, LOG_WIDTH]))
        for j in range(n):
            frame = round((data.time[j] + 1.0) * half)
            error[c, frame] = (scratch[still_row(fit), j] - fit[MEAN, 0]) * scale
        if second:
            gain[c] = try_one_more(data, 1, work, law, own, 1.0)
    return ClusterFits(place, sigma, log_width, drift, support, gain, error)
