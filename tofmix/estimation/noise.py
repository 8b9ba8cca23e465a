"""The noise curve sigma(r) and the share of outliers, measured from a recording itself.

Use `measure_noise` where a camera's curve is not known, or to check the one that
is. It needs pixels that see one surface; up to 40 % may see several. Nothing here
knows a curve beforehand, and amplitudes are not used: sigma depends on range alone.

1. `noise_series` gives each pixel's variance and shape, run of frames by run.
2. Series shaped as one Gaussian are sorted by range into bins.
3. A bin's sigma is that of the lowest group of its series: two surfaces closer than some 3 sigma look like one
   with a larger sigma, never a smaller one (`_locate`).
4. The curve through the bins is taken out and the bins are measured once more, so that a steep curve within a bin
   does no harm.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.estimation.noise_scale import locate
from tofmix.estimation.noise_series import (
    LEAST_SAMPLES,
    SeriesStatistics,
    memory_correction,
    quantisation_step,
    read_series,
    series_statistics,
    shaped_as_one,
    trend_degree,
)
from tofmix.estimation.outliers import measure_outliers
from tofmix.recording import SampleSource
from tofmix.sensor import NoiseCurve, Sensor

STRICTNESS = 0.2
"""Share of Gaussian series that each test of shape turns away: it costs no bias."""

LEAST_IN_BIN = 20
"""Fewest series that tell a sigma."""

BIN_TARGET = 100
"""Series of a bin, where there are enough."""

MOST_BINS = 32

WIDE, NARROW = 0.12, 0.02
"""Extent of a bin over its range: above the first it is split, below the second it never is."""

FEW_FRAMES = 50
"""Series of fewer samples are gathered in bins of nearly twice the extent and twice the number."""

GAP = 0.03
"""A step in range, over the range, that parts two bins."""

PILE_SIGMA = 0.5
"""Samples without a return with less than this share of their neighbour's sigma are a constant."""

SLOPES = (-1.0, 4.0)
"""Least and greatest power of range by which sigma is carried on past the outer bins."""

FILL = 1.15
"""Ratio of neighbouring points of the curve where nothing was seen."""

LEAST_FITTING = 0.1
"""Share of series that must have the shape of one surface for the tests of shape to count."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredNoise:
    """What a recording tells of its camera's noise.

    Parameters
    ----------
    curve : NoiseCurve
        sigma(r), mm.
    pixels : (n,) int64
        Pixels that tell each point of the curve; 0 where it is carried on from its neighbours.
    outlier_probability : float
        p(c_r) of equation (1), in (0, 1).
    outlier_samples : int
        Samples that were seen as outliers.
    step_mm : float
        Step of the stored ranges.
    """

    curve: NoiseCurve
    pixels: IntArray
    outlier_probability: float
    outlier_samples: int
    step_mm: float


def measure_noise(source: SampleSource) -> MeasuredNoise:
    """Measure sigma(r) and p(c_r) from a recording.

    The sensor's own curve is not looked at. The result depends on the samples alone.

    Parameters
    ----------
    source : SampleSource
        The recording; at least 10 frames, and 20 pixels that see one surface at about one range.

    Returns
    -------
    MeasuredNoise
        The curve is linear between its points and constant past its ends, as any `NoiseCurve`.

    Raises
    ------
    ValueError
        If too few pixels see one surface; the text says what is missing.

    References
    ----------
    Basu, Sankhya 15 (1955), 377: shape and variance of a Gaussian sample are independent.
    """
    series = read_series(source)
    step = quantisation_step(series.samples)
    found = series_statistics(series, step)
    chosen = _single_surface(found)
    groups = _bins(found.range_mm[chosen], few=source.shape[0] < FEW_FRAMES)
    if not groups:
        raise ValueError(_what_is_missing(source, found, chosen))
    group = _Group(found, chosen, step)
    points = [group.point(members) for members in groups]
    for _ in range(2):  # the second time with the slope of the first curve taken out of the bins
        points = [group.point(b, points) for b in groups]
    points = _without_constant_pile(points, source.sensor)
    curve = _curve(points)
    p_outlier, n_outliers = measure_outliers(series.samples, found, curve, source.sensor)
    return MeasuredNoise(
        curve=curve,
        pixels=_pixels(curve, points, series.pixel[chosen]),
        outlier_probability=p_outlier,
        outlier_samples=n_outliers,
        step_mm=step,
    )


def _single_surface(found: SeriesStatistics) -> IntArray:
    """Numbers of the series that are shaped as one surface, by range."""
    usable = found.kept > 0
    fits = usable & shaped_as_one(found, STRICTNESS)
    # Noise that is not Gaussian fails the tests nearly everywhere: then they tell nothing of surfaces.
    if fits.sum() < LEAST_FITTING * usable.sum():
        fits = usable
    moving = found.variance > 0
    if 2 * (fits & moving).sum() > fits.sum():
        fits &= moving  # the others are stuck, or coarse steps hide their noise
    chosen = np.flatnonzero(fits)
    return chosen[np.argsort(found.range_mm[chosen], kind="stable")]


def _what_is_missing(source: SampleSource, found: SeriesStatistics, chosen: IntArray) -> str:
    frames = source.shape[0]
    if frames < LEAST_SAMPLES:
        return f"noise: {frames} frames are too few to measure it; at least {LEAST_SAMPLES} are needed"
    filled = int((found.valid >= LEAST_SAMPLES).sum())
    if filled < LEAST_IN_BIN:
        return f"noise: {filled} pixels have {LEAST_SAMPLES} valid samples; at least {LEAST_IN_BIN} are needed"
    return (
        f"noise: {chosen.size} pixels show one surface, and nowhere {LEAST_IN_BIN} of them within"
        f" {100 * WIDE:.0f} % of one range, as measuring it needs"
    )


def _bins(range_mm: FloatArray, *, few: bool) -> list[slice]:
    """Cut ascending ranges into bins: at gaps, then in halves while they are too wide or hold more than they need."""
    if range_mm.size == 0:
        return []
    scale = np.maximum(np.abs(range_mm), 1.0)
    cuts = np.flatnonzero(np.diff(range_mm) > GAP * scale[1:]) + 1
    target = max(BIN_TARGET * (2 if few else 1), range_mm.size // MOST_BINS)
    wide = WIDE * (1.8 if few else 1.0)
    waiting = [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), range_mm.size])]
    bins = []
    while waiting:
        part = waiting.pop()
        count = part.stop - part.start
        extent = (range_mm[part.stop - 1] - range_mm[part.start]) / scale[part.start]
        if count >= 2 * LEAST_IN_BIN and (extent > wide or (count >= 2 * target and extent > NARROW)):
            middle = (part.start + part.stop) // 2
            waiting += [slice(part.start, middle), slice(middle, part.stop)]
        elif count >= LEAST_IN_BIN and extent <= 2 * wide:
            bins.append(part)
    return sorted(bins, key=lambda part: part.start)


class _Point(NamedTuple):
    """A bin's series, their range from `low` to `high` (mm), and log sigma at `centre`."""

    members: slice
    low: float
    centre: float
    high: float
    log_sigma: float


class _Group:
    """The series that tell of the noise, by range."""

    def __init__(self, found: SeriesStatistics, chosen: IntArray, step: float) -> None:
        self._range = found.range_mm[chosen]
        size = int(np.median(found.kept[chosen]))
        self._degrees = size - trend_degree(size) - 1
        variance = found.variance[chosen] * memory_correction(float(np.median(found.memory[chosen])), size)
        # Sheppard's correction: rounding adds step^2 / 12. What is left of less than that cannot be told.
        rounding = step**2 / 12.0
        self._log_sigma = 0.5 * np.log(np.maximum(variance - rounding, rounding))

    def point(self, members: slice, curve: Sequence[_Point] = ()) -> _Point:
        """Measure a bin, with the slope of an earlier curve taken out."""
        range_mm, log_sigma = self._range[members], self._log_sigma[members]
        centre = float(np.median(range_mm))
        if curve:
            log_sigma = log_sigma - _log_curve(curve, range_mm) + _log_curve(curve, np.array([centre]))
        return _Point(members, float(range_mm[0]), centre, float(range_mm[-1]), locate(log_sigma, self._degrees))


def _log_curve(points: Sequence[_Point], range_mm: FloatArray) -> FloatArray:
    """Log sigma at any range: a power law from point to point, carried on past the outer ones by their neighbours'."""
    x = np.log(np.maximum(range_mm, 1.0))
    at = np.log(np.maximum([p.centre for p in points], 1.0))
    values = np.array([p.log_sigma for p in points])
    distinct = np.concatenate([[True], np.diff(at) > 0])
    at, values = at[distinct], values[distinct]
    if len(at) == 1:
        return np.full(x.shape, values[0])
    slopes = np.clip(np.diff(values) / np.diff(at), *SLOPES)
    log_sigma: FloatArray = np.interp(x, at, values)
    log_sigma += slopes[0] * np.minimum(x - at[0], 0.0) + slopes[-1] * np.maximum(x - at[-1], 0.0)
    return log_sigma


def _without_constant_pile(points: list[_Point], sensor: Sensor) -> list[_Point]:
    """Leave out samples without a return that are a constant: their spread is not sigma(range_max)."""
    if sensor.range_max_mm is None or len(points) == 1:
        return points
    before, last = points[-2:]
    near = last.high >= sensor.range_max_mm - 3.0 * math.exp(before.log_sigma)
    return points[:-1] if near and last.log_sigma < before.log_sigma + math.log(PILE_SIGMA) else points


def _curve(points: Sequence[_Point]) -> NoiseCurve:
    """Curve through the points, the ends of their bins, and the power law where nothing was seen."""
    ends = {round(value, 1) for p in points for value in (p.low, p.centre, p.high)}
    ends |= {round(p.centre, 1) for p in points}
    knots = sorted(ends)
    filled = [knots[0]]
    for before, after in pairwise(knots):
        if before >= 1.0 and after > FILL * before:
            pieces = math.ceil(math.log(after / before) / math.log(FILL))
            filled += [round(before * (after / before) ** (k / pieces), 1) for k in range(1, pieces)]
        filled.append(after)
    range_mm = np.unique(np.array(filled))
    return NoiseCurve(range_mm, np.exp(_log_curve(points, range_mm)))


def _pixels(curve: NoiseCurve, points: Sequence[_Point], pixel: IntArray) -> IntArray:
    """Pixels that tell each point of the curve; 0 between the bins' centres."""
    count = np.zeros(len(curve.range_mm), dtype=np.int64)
    for point in points:
        nearest = int(np.argmin(np.abs(curve.range_mm - point.centre)))
        count[nearest] += len(np.unique(pixel[point.members]))
    return count


def disagreement(measured: MeasuredNoise, curve: NoiseCurve) -> tuple[float, float]:
    """Where a curve and the recording differ most: range, mm, and the curve's sigma over the measured one.

    Only the ranges at which the recording tells sigma count.

    Parameters
    ----------
    measured : MeasuredNoise
        What `measure_noise` returned.
    curve : NoiseCurve
        The curve to check.

    Returns
    -------
    float, float
        Range and ratio.
    """
    seen = measured.pixels > 0
    range_mm = measured.curve.range_mm[seen]
    ratio = curve.sigma(range_mm) / measured.curve.sigma_mm[seen]
    worst = int(np.argmax(np.abs(np.log(ratio))))
    return float(range_mm[worst]), float(ratio[worst])
