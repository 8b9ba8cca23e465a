"""From the spreads of single-surface series to a curve sigma(r): bins of range, measured, smoothed and joined.

Use it through `noise`. Series come sorted by range. Each bin's sigma is that of its single series (`scale`); the bins
are then smoothed according to their scatter, so many narrow bins lose no precision where the curve is smooth.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.estimation.noise.scale import Located, locate
from tofmix.estimation.noise.settings import CurveSettings
from tofmix.sensor import AmplitudeLaw, NoiseCurve

_ROUGHNESS = np.geomspace(1e-3, 1e5, 33)
"""Variances of the second derivative of log sigma by log range, with the whole range as unit, that are tried."""


class Point(NamedTuple):
    """A bin's series, their range from `low` to `high` (mm), and log sigma at `centre`."""

    members: slice
    low: float
    centre: float
    high: float
    log_sigma: float


def cut_into_bins(range_mm: FloatArray, settings: CurveSettings) -> list[slice]:
    """Cut ascending ranges into bins: at gaps, then in halves while they are too wide or hold more than they need."""
    if range_mm.size == 0:
        return []
    scale = np.maximum(np.abs(range_mm), 1.0)
    cuts = np.flatnonzero(np.diff(range_mm) > settings.gap * scale[1:]) + 1
    target = max(settings.bin_target, range_mm.size // settings.most_bins)
    waiting = [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), range_mm.size])]
    bins = []
    while waiting:
        part = waiting.pop()
        count = part.stop - part.start
        extent = (range_mm[part.stop - 1] - range_mm[part.start]) / scale[part.start]
        many = extent > settings.wide or (count >= 2 * target and extent > settings.narrow)
        if count >= 2 * settings.least_in_bin and many:
            middle = (part.start + part.stop) // 2
            waiting += [slice(part.start, middle), slice(middle, part.stop)]
        elif count >= settings.least_in_bin and extent <= 2 * settings.wide:
            bins.append(part)
    return sorted(bins, key=lambda part: part.start)


def measure_bins(
    range_mm: FloatArray, log_sigma: FloatArray, bins: Sequence[slice], degrees: int, settings: CurveSettings
) -> tuple[list[Point], Located]:
    """Measure the bins, three times: the slope of the curve within each is taken out by the curve before.

    Parameters
    ----------
    range_mm, log_sigma : (series,) float64
        Range, ascending, and half the logarithm of the variance of each series.
    bins : sequence of slice
        From `cut_into_bins`, at least one.
    degrees : int
        Degrees of freedom of the variances.
    settings : CurveSettings
        Thresholds.

    Returns
    -------
    list of Point
        One a bin.
    Located
        The last measurement, before it was smoothed.
    """
    centres = np.array([np.median(range_mm[members]) for members in bins])
    points: list[Point] = []
    for _ in range(3):
        slope = log_curve(points, range_mm, settings) if points else np.zeros(len(range_mm))
        at_centre = log_curve(points, centres, settings) if points else np.zeros(len(centres))
        level = log_sigma - slope
        found = locate([level[members] + at_centre[b] for b, members in enumerate(bins)], degrees)
        smoothed = smooth(np.log(np.maximum(centres, 1.0)), found.log_sigma, found.error, settings.least_smoothed)
        points = [
            Point(members, float(range_mm[members][0]), float(centre), float(range_mm[members][-1]), float(value))
            for members, centre, value in zip(bins, centres, smoothed, strict=True)
        ]
    return points, found


def smooth(x: FloatArray, y: FloatArray, error: FloatArray, least: int) -> FloatArray:
    """Smooth values with known errors by cubic splines, according to their scatter.

    A spline is the mean of a process whose second derivative is white noise. Its variance is integrated out by the
    restricted likelihood of the values, so kinks remain, and straight curves pool the values.

    Parameters
    ----------
    x, y, error : (n,) float64
        Ascending places, values there, and their standard errors, above 0.
    least : int
        Fewest values that determine their smoothness.

    Returns
    -------
    (n,) float64
        Smoothed values; as they are where there are fewer than `least`.

    References
    ----------
    Wahba, J. Royal Statistical Society B 40 (1978), 364; Wecker and Ansley, JASA 78 (1983), 81.
    """
    if len(x) < least or not x[-1] > x[0]:
        return y
    u = (x - x[0]) / (x[-1] - x[0])
    low, high = np.minimum.outer(u, u), np.maximum.outer(u, u)
    kernel = low**2 * (3.0 * high - low) / 6.0
    line = np.stack([np.ones_like(u), u], axis=1)
    fits, likelihood = [], []
    for roughness in _ROUGHNESS:
        lower = np.linalg.cholesky(roughness * kernel + np.diag(error**2))
        basis, values = np.linalg.solve(lower, line), np.linalg.solve(lower, y)
        normal = basis.T @ basis
        straight = np.linalg.solve(normal, basis.T @ values)
        rest = values - basis @ straight
        fits.append(line @ straight + roughness * kernel @ np.linalg.solve(lower.T, rest))
        likelihood.append(-0.5 * rest @ rest - np.log(np.diag(lower)).sum() - 0.5 * float(np.linalg.slogdet(normal)[1]))
    weight = np.exp(np.array(likelihood) - max(likelihood))
    return np.asarray(weight @ np.array(fits) / weight.sum(), dtype=np.float64)


def log_curve(points: Sequence[Point], range_mm: FloatArray, settings: CurveSettings) -> FloatArray:
    """Log sigma at any range: a power law from point to point, carried on past the outer ones by their neighbours'."""
    x = np.log(np.maximum(range_mm, 1.0))
    at = np.log(np.maximum([p.centre for p in points], 1.0))
    values = np.array([p.log_sigma for p in points])
    distinct = np.concatenate([[True], np.diff(at) > 0])
    at, values = at[distinct], values[distinct]
    if len(at) == 1:
        return np.full(x.shape, values[0])
    slopes = np.clip(np.diff(values) / np.diff(at), *settings.slopes)
    log_sigma: FloatArray = np.interp(x, at, values)
    log_sigma += slopes[0] * np.minimum(x - at[0], 0.0) + slopes[-1] * np.maximum(x - at[-1], 0.0)
    return log_sigma


def join(points: Sequence[Point], settings: CurveSettings) -> NoiseCurve:
    """Curve through the points, the ends of their bins, and the power law where nothing was seen."""
    ends = {round(value, 1) for p in points for value in (p.low, p.centre, p.high)}
    knots = sorted(ends)
    filled = [knots[0]]
    for before, after in pairwise(knots):
        if before >= 1.0 and after > settings.fill * before:
            pieces = math.ceil(math.log(after / before) / math.log(settings.fill))
            filled += [round(before * (after / before) ** (k / pieces), 1) for k in range(1, pieces)]
        filled.append(after)
    range_mm = np.unique(np.array(filled))
    return NoiseCurve(range_mm, np.exp(log_curve(points, range_mm, settings)))


def reference_at(law: AmplitudeLaw, centres: FloatArray, range_mm: FloatArray) -> FloatArray:
    """Reference amplitude at any range: a power of range between the law's `centres`, mm, constant past them."""
    at, x = np.log(np.maximum(centres, 1.0)), np.log(np.maximum(range_mm, 1.0))
    return np.asarray(np.exp(np.interp(x, at, np.log(law.reference))), dtype=np.float64)


def with_law(curve: NoiseCurve, law: AmplitudeLaw, centres: FloatArray) -> NoiseCurve:
    """The curve of noise at the law's factor 1, as one at its references, which are at `centres`, mm."""
    reference = reference_at(law, centres, curve.range_mm)
    sigma_mm = curve.sigma_mm * np.exp(law.log_factor(reference))
    return NoiseCurve(curve.range_mm, sigma_mm, AmplitudeLaw(reference, law.amplitude, law.factor))
