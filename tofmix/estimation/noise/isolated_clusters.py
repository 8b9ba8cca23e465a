"""Clusters of samples that are isolated in their pixel, and one surface fitted to each under a Gaussian noise curve.

Use `find_clusters` and `fit_clusters` for a quick look at a recording (`curve_check`). They work on all samples at once
and compile nothing. `learnt.clusters` has the kernels for any shape of the error; both use the same rules.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.estimation.beam import Beam
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.noise_shape import DRIFTS, MOST_LOG_WIDTH, TAIL_DEGREES

CLOSE = 1.2
"""Half the width, in sigmas, of the window of the densest place: it holds 77 % of a Gaussian surface."""

WINDOW = 16.0
"""Half the width of a cluster's window about its densest place, in sigmas."""

MOST_BESIDE = 0.2
"""A cluster is isolated if no other place of its window, `APART` sigmas or more away, has more than this part of the
samples of its densest place."""

APART = 4.0
"""Distance, in sigmas, from which on other samples of the window may be another surface: nearer surfaces overlap."""

LEAST_IN_CLUSTER = 8
"""Least samples at the densest place of a cluster."""

LEAST_TO_CLUSTER = 12
"""Least samples of most pixels for clusters: of fewer, only narrow pixels have `LEAST_IN_CLUSTER` at the densest place
(77 % of 12, less one standard deviation, are 8), and sigma measured from them would be too small."""

LEAST_SHARE = 0.1
"""Least part of the pixel's samples at the densest place of a cluster."""

MOST_IN_PIXEL = 3
"""Most clusters of a pixel: further ones have few of its samples."""

LEAST_CLUSTERS = 12
"""Least clusters that a part of the noise, or a curve, is learnt from."""

WEAK_PRIOR = (0.5, 5.0)
"""Pseudo-counts of background and of the rest for a cluster, where the noise has no background."""

FREE_DRIFT_SIGMAS = 3.0
"""Scale of the drift, in sigmas, while drifts are measured: this prior leaves each drift to its samples."""

WIDTH_INFORMATION = 2.0
"""Fisher's information of the log scale of a Gaussian, of one sample."""


LONGEST_STEP = 1.0
"""Most that a mean moves in one iteration, in sigmas."""

_MOST_ITERATIONS, _TOLERANCE = 100, 2e-4  # of EM; in sigmas, and as a share


class Clusters(NamedTuple):
    """Clusters: the index of the `pixel` (cluster,), and the ends of the window, `low` and `high` (cluster,), mm."""

    pixel: IntArray
    low: FloatArray
    high: FloatArray


class GaussianFits(NamedTuple):
    """One surface fitted to each cluster; (cluster,) where no other shape is named.

    `place` is the range of the surface and `sigma` that of the curve there, mm; `log_width` and `drift` (cluster,
    DRIFTS), mm, are fitted; `support` is the number of the surface's samples, and `error` (sample,) holds the
    standardised errors of the samples of all windows.
    """

    place: FloatArray
    sigma: FloatArray
    log_width: FloatArray
    drift: FloatArray
    support: FloatArray
    error: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PixelSigmas:
    """sigma(r) of single pixels: the curve of a beam, and the pixels' own where amplitudes give one."""

    beam: Beam

    def __call__(self, pixel: IntArray, range_mm: FloatArray) -> FloatArray:
        """Sigma (n,), mm, of each pixel at its range, as `noise.kernel.sigma_at` has it."""
        common = np.interp(range_mm, self.beam.curve_range, self.beam.curve_sigma)
        curves = self.beam.pixel_curves
        if len(curves.size) == 0:
            return np.asarray(common, dtype=np.float64)
        size = curves.size[pixel]
        inside = np.arange(curves.range_mm.shape[1]) < curves.size[:, None]
        ranges, sigmas = curves.range_mm[inside], curves.sigma_mm[inside]
        keys = np.nonzero(inside)[0] + 1j * ranges  # complex numbers are ordered by pixel, then by range
        after = np.searchsorted(keys, pixel + 1j * range_mm, side="right")
        stop = np.maximum(np.cumsum(curves.size)[pixel], 1)
        first = np.maximum(stop - size, 0)
        low, high = np.clip(after - 1, first, stop - 1), np.clip(after, first, stop - 1)
        length = ranges[high] - ranges[low]
        part = np.clip((range_mm - ranges[low]) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
        return np.where(size > 0, sigmas[low] + part * (sigmas[high] - sigmas[low]), common)


@dataclass(frozen=True, slots=True, eq=False)
class FlatSamples:
    """Valid samples of all pixels in one row, by pixel and ascending within it.

    `pixel` (n,) is the index of the pixel, `value` (n,) the sample, mm, and `time` (n,) its time, -1 to 1
    over the window.
    """

    pixel: IntArray
    value: FloatArray
    time: FloatArray

    @classmethod
    def of(cls, samples: Float32Array) -> Self:
        """Take the valid samples (pixel, frame), mm, NaN where invalid."""
        with np.errstate(invalid="ignore"):
            pixel, frame = np.nonzero(np.abs(samples) <= FARTHEST_MM)
        value = samples[pixel, frame].astype(np.float64)
        order = np.argsort(pixel + 1j * value, kind="stable")  # equal samples stay in the order of frames
        frames = samples.shape[1]
        half = 0.5 * (frames - 1) if frames > 1 else 1.0
        return cls(pixel[order], value[order], (frame / half - 1.0)[order])

    def chosen(self, which: BoolArray) -> Self:
        """The samples for which `which` (n,) is true."""
        return replace(self, pixel=self.pixel[which], value=self.value[which], time=self.time[which])

    def keys(self) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
        """Ascending keys (n,): complex numbers are ordered by pixel, then by value."""
        return self.pixel + 1j * self.value

    def until(self, pixel: IntArray, end_mm: FloatArray) -> IntArray:
        """Index (m,) after the last sample of each pixel up to `end_mm` (m,)."""
        return np.searchsorted(self.keys(), pixel + 1j * end_mm, side="right")

    def since(self, pixel: IntArray, start_mm: FloatArray) -> IntArray:
        """Index (m,) of the first sample of each pixel from `start_mm` (m,) on."""
        return np.searchsorted(self.keys(), pixel + 1j * start_mm, side="left")


def find_clusters(samples: FlatSamples, pixels: int, sigma: PixelSigmas) -> Clusters:
    """Find the isolated clusters of `pixels` pixels, in the order of the pixels."""
    owner, places, halves = [], [], []
    total = np.bincount(samples.pixel, minlength=pixels)
    left = samples
    for _ in range(MOST_IN_PIXEL):
        if left.value.size == 0:
            break
        pixel, place, together = _densest_places(left, sigma)
        enough = together >= np.maximum(LEAST_IN_CLUSTER, LEAST_SHARE * total[pixel])
        pixel, place, together = pixel[enough], place[enough], together[enough]
        half = sigma(pixel, place)
        isolated = _isolated(samples, pixel, place, half, together, pixels)
        owner.append(pixel[isolated])
        places.append(place[isolated])
        halves.append(WINDOW * half[isolated])
        low, high = np.full(pixels, np.nan), np.full(pixels, np.nan)  # pixels without a dense place are done
        low[pixel], high[pixel] = place - WINDOW * half, place + WINDOW * half
        left = left.chosen((left.value < low[left.pixel]) | (left.value > high[left.pixel]))
    if not owner:
        return Clusters(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    pixel, place, reach = np.concatenate(owner), np.concatenate(places), np.concatenate(halves)
    order = np.argsort(pixel, kind="stable")
    return Clusters(pixel[order], (place - reach)[order], (place + reach)[order])


def _densest_places(samples: FlatSamples, sigma: PixelSigmas) -> tuple[IntArray, FloatArray, IntArray]:
    """Window of 2 `CLOSE` sigmas with most samples of each pixel that has any: pixel, mean of its samples, number."""
    ends = samples.value + 2.0 * CLOSE * sigma(samples.pixel, samples.value)
    stop = np.maximum.accumulate(samples.until(samples.pixel, ends))
    inside = stop - np.arange(len(stop))
    starts = np.flatnonzero(np.diff(samples.pixel, prepend=-1))
    most = np.repeat(np.maximum.reduceat(inside, starts), np.diff(starts, append=len(stop)))
    densest = np.flatnonzero(inside == most)
    pixel, at = np.unique(samples.pixel[densest], return_index=True)
    first = densest[at]
    sums = np.concatenate(([0.0], np.cumsum(samples.value)))
    return pixel, (sums[stop[first]] - sums[first]) / inside[first], inside[first]


def _isolated(
    samples: FlatSamples, pixel: IntArray, place: FloatArray, sigma: FloatArray, together: IntArray, pixels: int
) -> BoolArray:
    """Whether no other place of each window has so many of the samples that it may be a surface."""
    owner = np.full(pixels, -1)
    owner[pixel] = np.arange(len(pixel))
    some = samples.chosen(owner[samples.pixel] >= 0)
    own = owner[some.pixel]
    first = np.arange(len(own))
    stop = some.until(some.pixel, some.value + 2.0 * CLOSE * sigma[own])
    away = np.abs(0.5 * (some.value + some.value[stop - 1]) - place[own])
    crowded = stop - first > np.maximum(MOST_BESIDE * together[own], 1.0)
    beside = crowded & (away >= APART * sigma[own]) & (away <= WINDOW * sigma[own])
    return np.asarray(np.bincount(own[beside], minlength=len(pixel)) == 0)


def fit_clusters(
    samples: FlatSamples, clusters: Clusters, sigma: PixelSigmas, *, width_scale: float, drift_mm: float = 0.0
) -> GaussianFits:
    """Fit one surface of Gaussian errors on uniform background to each cluster, by EM.

    Parameters
    ----------
    samples : FlatSamples
        The samples that the clusters were found in.
    clusters : Clusters
        Of one or more samples each.
    sigma : PixelSigmas
        The noise curve.
    width_scale : float
        Scale of the Student t prior of log width.
    drift_mm : float
        Scale of that of each Legendre polynomial of a drift, mm; 0: no drift.
    """
    first = samples.since(clusters.pixel, clusters.low)
    count = samples.until(clusters.pixel, clusters.high) - first
    own = np.repeat(np.arange(len(first)), count)
    index = np.arange(len(own)) + np.repeat(first - (np.cumsum(count) - count), count)
    fit = _Em(clusters, sigma, width_scale=width_scale, drift_mm=drift_mm)
    data = _Windows(samples.value[index], _polynomials(samples.time[index]), own, np.arange(len(first)))
    fit.run(data)
    error = fit.errors(data)
    return GaussianFits(fit.place, fit.sigma, fit.log_width, fit.drift, fit.support, error)


def _polynomials(time: FloatArray) -> FloatArray:
    """Legendre polynomials (DRIFTS, n) of the degrees 1 to 3."""
    return np.array([time, 1.5 * time**2 - 0.5, (2.5 * time**2 - 1.5) * time])


class _Windows(NamedTuple):
    """Samples of the windows of some clusters.

    `value` (n,), mm, and `basis` (DRIFTS, n), the polynomials of their times; `own` (n,) is the place of each one's
    cluster in `cluster` (m,), which has the clusters' indices.
    """

    value: FloatArray
    basis: FloatArray
    own: IntArray
    cluster: IntArray

    def only(self, which: BoolArray) -> "_Windows":
        """The windows of the clusters for which `which` (m,) is true."""
        rows = which[self.own]
        own = (np.cumsum(which) - 1)[self.own[rows]]
        return _Windows(self.value[rows], self.basis[:, rows], own, self.cluster[which])

    def summed(self, values: FloatArray) -> FloatArray:
        """Sum of values (n,) over the samples of each cluster (m,)."""
        return np.bincount(self.own, weights=values, minlength=len(self.cluster)).astype(np.float64, copy=False)


class _Em:
    """EM on all clusters at once; most that have converged are left out."""

    def __init__(self, clusters: Clusters, sigma_of: PixelSigmas, *, width_scale: float, drift_mm: float) -> None:
        self._pixel, self._sigma_of, self._length = clusters.pixel, sigma_of, clusters.high - clusters.low
        self._width_scale, self._drift_mm = width_scale, drift_mm
        count = len(clusters.pixel)
        self.place = 0.5 * (clusters.low + clusters.high)
        self.sigma = sigma_of(clusters.pixel, self.place)
        self.log_width, self.support = np.zeros(count), np.zeros(count)
        start_background = 0.05  # share of background that a fit starts with
        self.drift, self.background = np.zeros((count, DRIFTS)), np.full(count, start_background)

    def run(self, data: _Windows) -> None:
        """Iterate until no number of a cluster moves by more than the tolerance."""
        moves = np.ones(len(data.cluster), dtype=np.bool_)
        still_many = 0.75  # part of the clusters that move still, below which the others are left out
        for _ in range(_MOST_ITERATIONS):
            if not moves.any():
                return
            if moves.sum() < still_many * len(moves):
                data = data.only(moves)
            moves = self._step(data) > _TOLERANCE

    def errors(self, data: _Windows) -> FloatArray:
        """Standardised errors (n,) of the samples."""
        fitted = data.value - self.place[data.cluster][data.own]
        if self._drift_mm > 0.0:
            drift = self.drift[data.cluster]
            for d in range(DRIFTS):
                fitted -= drift[:, d][data.own] * data.basis[d]
        return fitted / (self.sigma * np.exp(self.log_width))[data.cluster][data.own]

    def _step(self, data: _Windows) -> FloatArray:
        """One iteration; return how far each cluster (m,) moved, in sigmas or as a share."""
        which, own = data.cluster, data.own
        log_width, background = self.log_width[which], self.background[which]
        width = self.sigma[which] * np.exp(log_width)
        z = self.errors(data)
        density = ((1.0 - background) / (width * math.sqrt(2.0 * math.pi)))[own] * np.exp(-0.5 * z * z)
        floor = 1e-30  # 1/mm, of a density, so that none is 0
        part = density / (density + (background / self._length[which] + floor)[own])
        pull = part * z
        support, push, square = data.summed(part), data.summed(pull), data.summed(pull * z)
        held = np.maximum(support, floor)
        step = push / held
        if self._drift_mm > 0.0:
            step -= self._move_drift(data, part, pull, width, held, push)
        step = np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        precision = (TAIL_DEGREES + 1.0) / (TAIL_DEGREES * self._width_scale**2 + log_width**2)
        wider = (square - support - precision * log_width) / (WIDTH_INFORMATION * support + precision)
        wider = np.clip(log_width + wider, -MOST_LOG_WIDTH, MOST_LOG_WIDTH)
        samples, (near, far) = np.bincount(own, minlength=len(which)), WEAK_PRIOR
        share = (samples - support + near) / (samples + near + far)
        self.place[which] += step * width
        self.sigma[which] = self._sigma_of(self._pixel[which], self.place[which])
        self.log_width[which], self.background[which], self.support[which] = wider, share, support
        return np.asarray(np.max(np.abs([step, wider - log_width, share - background]), axis=0))

    def _move_drift(
        self,
        data: _Windows,
        part: FloatArray,
        pull: FloatArray,
        width: FloatArray,
        support: FloatArray,
        push: FloatArray,
    ) -> FloatArray:
        """One step of scoring of each drift; return what it takes from the step of the mean (m,), in widths."""
        weighted = part * data.basis
        middle = np.stack([data.summed(row) for row in weighted], axis=1)
        score = np.stack([data.summed(pull * row) for row in data.basis], axis=1)
        score -= middle * (push / support)[:, None]
        information = np.empty((len(width), DRIFTS, DRIFTS))
        for a in range(DRIFTS):
            for b in range(a + 1):
                # The part of a polynomial along the constant is left to the mean.
                value = data.summed(weighted[a] * data.basis[b]) - middle[:, a] * middle[:, b] / support
                information[:, a, b] = information[:, b, a] = value
        old = self.drift[data.cluster]
        precision = (TAIL_DEGREES + 1.0) / (TAIL_DEGREES * self._drift_mm**2 + old**2)
        information[:, range(DRIFTS), range(DRIFTS)] += precision * width[:, None] ** 2
        score -= precision * old * width[:, None]
        step = np.linalg.solve(information, score[..., None])[..., 0]
        self.drift[data.cluster] = old + step * width[:, None]
        return np.asarray((step * middle).sum(axis=1) / support)
