"""Clusters of samples that are isolated in their pixel, and fits of one surface to each.

The noise is learnt from clusters: a pixel of one surface has one, and a pixel of two distant surfaces two. The samples
around a cluster are its background.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Background, Beam, sigma_at
from tofmix.estimation.learnt.acceleration import LEARNING_ITER, LEARNING_TOL, maximise
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
    Samples,
    cell_of,
    fill_cells,
    fill_times,
    still_row,
    take_samples,
)
from tofmix.estimation.learnt.em import detrend, mix
from tofmix.estimation.learnt.law import Law, density_at, spread_at
from tofmix.estimation.learnt.population import SAME_LEVEL
from tofmix.estimation.learnt.trials import densest_place, new_workspace, try_one_more
from tofmix.estimation.noise.amplitude import beam_of_pixel
from tofmix.estimation.noise.isolated_clusters import (
    APART,
    CLOSE,
    LEAST_IN_CLUSTER,
    LEAST_SHARE,
    MOST_BESIDE,
    MOST_IN_PIXEL,
    WINDOW,
    Clusters,
)
from tofmix.noise_shape import DRIFTS, LEAST_SIGMA

SIGMAS = LEAST_SIGMA * np.exp(0.1 * np.arange(38))
"""Sigmas, in steps, whose likelihood is computed: from the least that a step tells to 4 steps."""


class ClusterFits(NamedTuple):
    """One surface fitted to each cluster; (cluster,) where no other shape is named.

    `place` is the range of the surface and `sigma` that of the curve there, mm; `log_width` and `drift` (cluster,
    DRIFTS), mm, are fitted; `support` is the number of the surface's samples, `gain` that of a second surface, nat, and
    `error` (cluster, frame) the standardised errors of the window's samples, NaN where a frame has none.
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
    """Find the isolated clusters of samples (pixel, frame), mm, NaN where invalid."""
    pixels, frames = samples.shape
    most = pixels * MOST_IN_PIXEL
    owner, low, high, count = np.zeros(most, dtype=np.int64), np.zeros(most), np.zeros(most), 0
    value, time, left = np.empty(frames), np.empty(frames), np.empty(frames)
    for pixel in range(pixels):
        n = take_samples(samples[pixel], value, time)
        own = beam_of_pixel(beam, pixel)
        rest = n
        left[:n] = value[:n]
        for _ in range(MOST_IN_PIXEL):
            place, most_together = densest_place(left, rest, own, True)  # noqa: FBT003  a kernel's flag
            if most_together < max(LEAST_IN_CLUSTER, LEAST_SHARE * n):
                break
            sigma = spread_at(place, own)
            a, b = place - WINDOW * sigma, place + WINDOW * sigma
            if _isolated(value, n, place, a, b, most_together, sigma):
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
def _isolated(
    y: FloatArray,
    n: int,
    place: float,
    a: float,
    b: float,
    most_together: float,
    sigma: float,
) -> bool:
    """Whether no other place of the window [a, b] has so many of the samples that it may be a surface."""
    stop = 0
    for first in range(n):
        stop = max(stop, first)
        while stop < n and y[stop] <= y[first] + 2.0 * CLOSE * sigma:
            stop += 1
        middle = 0.5 * (y[first] + y[stop - 1])
        apart = a <= middle <= b and abs(middle - place) >= APART * sigma
        if apart and stop - first > max(MOST_BESIDE * most_together, 1.0):
            return False
    return True


@jit
def cluster_likelihoods(
    samples: Float32Array,
    clusters: Clusters,
    place: FloatArray,
    support: FloatArray,
    step: FloatArray,
    law: Law,
    beam: Beam,
) -> FloatArray:
    """Log likelihood (cluster, `SIGMAS`) of sigmas of clusters of one surface, whose range is not known.

    The likelihood is the mean over ranges, equally spaced: a mean that is fitted instead makes sigma too small, by far
    if most samples of a cluster have one value.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples as they were stored, mm, NaN where invalid.
    clusters : Clusters
        Isolated clusters.
    place, support, step : (cluster,) float64
        Fitted range, mm, of each, number of its samples that are of the surface, and the step there, mm.
    law : Law
        The noise; drift and widths are not used.
    beam : Beam
        The steps.
    """
    count, frames = len(clusters.pixel), samples.shape[1]
    out = np.zeros((count, len(SIGMAS)))
    value, time = np.empty(frames), np.empty(frames)
    ranges = 96  # ranges of a surface over which a likelihood is averaged
    times, half, logs = np.empty(frames), np.empty(frames), np.empty(ranges)
    for c in range(count):
        n_all = take_samples(samples[clusters.pixel[c]], value, time)
        n, levels = 0.0, 0
        for j in range(n_all):
            if not clusters.low[c] <= value[j] <= clusters.high[c]:
                continue
            n += 1.0
            if levels > 0 and value[j] - value[levels - 1] < SAME_LEVEL * step[c]:
                times[levels - 1] += 1.0
            else:
                value[levels], times[levels] = value[j], 1.0
                levels += 1
        own = beam_of_pixel(beam, clusters.pixel[c])
        for j in range(levels):
            value[j], half[j] = cell_of(value[j], own)
        rest = max(n - support[c], 0.5) / max(n, 1.0)
        uniform = 2.0 * rest / (clusters.high[c] - clusters.low[c])
        for s in range(len(SIGMAS)):
            sigma = SIGMAS[s] * step[c]
            spread = math.sqrt(sigma * sigma + step[c] * step[c] / 12.0)
            reach = 0.5 * step[c] + 5.0 * spread / math.sqrt(max(support[c], 1.0))
            best = -math.inf
            for m in range(ranges):
                mean = place[c] + reach * (2.0 * (m + 0.5) / ranges - 1.0)
                total = 0.0
                for j in range(levels):
                    h = half[j] / sigma
                    inside = 2.0 * h * density_at((value[j] - mean) / sigma, h, law)
                    total += times[j] * math.log((1.0 - rest) * inside + uniform * half[j])
                logs[m] = total
                best = max(best, total)
            mean_likelihood = 0.0
            for m in range(ranges):
                mean_likelihood += math.exp(logs[m] - best)
            out[c, s] = best + math.log(mean_likelihood * reach)
    return out


@jit
def fit_clusters(samples: Float32Array, clusters: Clusters, law: Law, beam: Beam, second: bool) -> ClusterFits:
    """Fit one surface on uniform background to each cluster; with `second`, also fit a second one for its gain."""
    count, frames = len(clusters.pixel), samples.shape[1]
    place, sigma, log_width, support = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    drift, gain = np.zeros((count, DRIFTS)), np.zeros(count)
    error = np.full((count, frames), np.nan)
    value, time = np.empty(frames), np.empty(frames)
    work = new_workspace(3, frames, 1)
    fit, scratch = work.fit, work.scratch
    half = 0.5 * (frames - 1) if frames > 1 else 1.0
    uniform = Background(beam.background.range_mm[:0], beam.background.density[:0])
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
            common.curve_range,
            common.curve_sigma,
            np.inf,
            1.0,
            np.inf,
            np.inf,
            np.inf,
            beam.p_outlier,
            beam.outlier_density,
            clusters.low[c],
            clusters.high[c],
            beam.pixel_curves,
            common.steps,
            uniform,
        )
        fill_times(data, scratch)
        fill_cells(data, own, scratch)
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
