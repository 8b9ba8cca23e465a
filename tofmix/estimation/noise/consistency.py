"""Check of a recording against its noise curve, and the drift of its ranges, before an estimate.

Use `check_consistency`. It reads only some pixels of the first window, so it takes little time compared with an
estimate. It returns statistics; `tofmix.report.summary.findings` decides which are reported.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.circle import fold
from tofmix.estimation.noise.measurement import single_surface
from tofmix.estimation.noise.series import (
    LEAST_SAMPLES,
    SERIES_FRAMES,
    Series,
    SeriesStatistics,
    quantisation_step,
    read_runs,
    series_statistics,
)
from tofmix.estimation.unrolling import UnrolledSource
from tofmix.noise_shape import SIGMA_OF_STEP, RangeStep
from tofmix.recording import SampleSource, amplitude_source, by_target
from tofmix.sensor import NoiseCurve

MEDIAN_TO_MEAN = math.sqrt(math.pi / 2.0)
"""Standard error of the median of Gaussian samples over that of their mean (Kendall and Stuart, 10.10)."""

_QUARTILE = 0.75  # of the pixels' changes: a drift shows in a quarter of the pixels at least
GAUSSIAN_QUARTILE = NormalDist().inv_cdf(0.5 * (1.0 + _QUARTILE))
"""That quantile of the absolute value of a standard Gaussian number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Consistency:
    """Statistics of pixels that see one surface; None if there are too few.

    Parameters
    ----------
    pixels : int
        Pixels that were judged.
    scatter_over_curve : float or None
        Median over pixels of the samples' standard deviation, trends in time taken out, over the noise curve's.
    drift_sigmas : float or None
        How far the ranges of a quarter of the pixels or more change over a window, chance taken out, in sigmas: the
        noise curve's, or the samples' own where that is larger.
    window_frames : int
        Frames of the window.
    """

    pixels: int
    scatter_over_curve: float | None
    drift_sigmas: float | None
    window_frames: int


def check_consistency(
    source: SampleSource,
    curve: NoiseCurve | None,
    *,
    step: RangeStep | None = None,
    window_frames: int,
    unambiguous_range_mm: float | None = None,
    follows_drift: bool = False,
    most_pixels: int = 1 << 13,
    most_judged: int = 1 << 11,
    least_pixels: int = 30,
) -> Consistency:
    """Hold some samples of the first window against the noise curve.

    Parameters
    ----------
    source : SampleSource
        The recording. Of up to `most_pixels` pixels up to 100 frames are read, and the last 100 of a longer window. Up
        to `most_judged` of these pixels are judged.
    curve : NoiseCurve or None
        The curve that the estimate uses.
    step : RangeStep, optional
        Step of the stored ranges; default: a common one, from the samples.
    window_frames : int
        Frames of a window, at least 1.
    unambiguous_range_mm : float, optional
        Length of the circle that ranges are taken on, mm.
    follows_drift : bool
        Whether the estimate lets pixels drift: then a drift is nothing to warn of, and is not looked for.
    most_pixels : int
        About how many pixels are read; one stored band of rows at least.
    most_judged : int
        About how many of them are judged, spread over all that are read: of 2048 pixels, a median's standard error is
        3 % of their spread.
    least_pixels : int
        With fewer pixels of one surface there is no result.

    Returns
    -------
    Consistency
        It depends on the samples, the curve and the window's length alone.
    """
    source = by_target(source)  # targets of a frame by turns would be scatter and drift
    nothing = Consistency(pixels=0, scatter_over_curve=None, drift_sigmas=None, window_frames=window_frames)
    length = min(source.shape[0], SERIES_FRAMES)
    if curve is None or length < LEAST_SAMPLES:
        return nothing
    ranges = source if unambiguous_range_mm is None else UnrolledSource(source, unambiguous_range_mm)
    starts = [0] if window_frames <= length else [0, window_frames - length]
    amplitudes = None if curve.law is None else amplitude_source(source)
    series = read_runs(ranges, starts, length, _rows(source, most_pixels), amplitudes)
    series = _thinned(series, len(starts), most_judged)
    step_mm = quantisation_step(series.samples) if step is None else step.typical()
    found = series_statistics(series, step_mm)
    place = found.range_mm if unambiguous_range_mm is None else fold(found.range_mm, unambiguous_range_mm)
    sigma = np.asarray(curve.sigma(place, series.amplitude), dtype=np.float64)
    chosen = single_surface(found)
    chosen = chosen[_returns(source, curve, place[chosen])]
    if chosen.size < least_pixels:
        return nothing
    rounding = np.full(sigma.shape, step_mm) if step is None else step.at(place, series.pixel)
    scatter = _scatter(found, sigma, chosen, rounding, least_pixels)
    seen = sigma * max(1.0, scatter or 0.0)
    if step is not None:
        seen = np.hypot(seen, SIGMA_OF_STEP * rounding)
    drift = None
    if not follows_drift:
        drift = _drift(series, seen, chosen, window_frames, unambiguous_range_mm, least_pixels)
    return Consistency(
        pixels=int(np.unique(series.pixel[chosen]).size),
        scatter_over_curve=scatter,
        drift_sigmas=drift,
        window_frames=window_frames,
    )


def _rows(source: SampleSource, most_pixels: int) -> IntArray:
    """Rows of whole stored bands, spread evenly over the image."""
    _, rows, cols = source.shape
    band = min(max(1, source.row_step), rows)
    bands = -(-rows // band)
    few = max(1, min(bands, most_pixels // (band * cols)))
    firsts = np.unique(np.linspace(0, bands - 1, few).astype(np.int64)) if few > 1 else np.array([bands // 2])
    chosen = (band * firsts[:, None] + np.arange(band)).ravel()
    return np.asarray(chosen[chosen < rows], dtype=np.int64)


def _thinned(series: Series, runs: int, most: int) -> Series:
    """Every k-th pixel of each run; k is odd, so that it is not the same columns of every row in most images."""
    pixels = len(series.pixel) // runs
    step = -(-pixels // most)
    if step > 1:
        step |= 1
    kept = (np.arange(runs)[:, None] * pixels + np.arange(0, pixels, step)).ravel()
    return Series(series.samples[kept], series.pixel[kept], series.amplitude[kept])


def _returns(source: SampleSource, curve: NoiseCurve, range_mm: FloatArray) -> BoolArray:
    """Which ranges belong to surfaces: samples without a return lie at `range_max_mm`, with another spread."""
    most = source.sensor.range_max_mm
    if most is None:
        return np.ones(range_mm.shape, dtype=np.bool_)
    no_return_sigmas = 3.0  # samples this near to the largest range may be no return
    return np.asarray(range_mm < most - no_return_sigmas * float(curve.sigma(most)), dtype=np.bool_)


def _scatter(
    found: SeriesStatistics, sigma: FloatArray, chosen: IntArray, step: FloatArray, least_pixels: int
) -> float | None:
    """Median ratio of standard deviations; rounding adds step^2 / 12 to a variance (Sheppard)."""
    # Where sigma is below half a step, samples may well show no scatter at all.
    chosen = chosen[sigma[chosen] >= 0.5 * step[chosen]]
    if chosen.size < least_pixels:
        return None
    ratio = np.sqrt(np.maximum(found.variance[chosen], 0.0)) / np.hypot(sigma[chosen], step[chosen] / math.sqrt(12.0))
    return float(np.median(ratio))


def _drift(
    series: Series,
    sigma: FloatArray,
    chosen: IntArray,
    window_frames: int,
    length_mm: float | None,
    least_pixels: int,
) -> float | None:
    """How far the medians of a quarter of the pixels move over a window, in sigmas.

    It is the upper quartile of the absolute change from the first third of a window to the last. The changes have a
    standard error, which sigma gives; the square of its quartile is subtracted.
    """
    runs = series.samples.shape[1]
    pixels = len(series.pixel) if window_frames <= runs else len(series.pixel) // 2
    ends = 3  # the change over a window is that from its first third to its last
    part = min(window_frames, runs) // ends if window_frames <= runs else min(window_frames // ends, runs)
    if window_frames < LEAST_SAMPLES:
        return None
    early = series.samples[:pixels, :part]
    late = (
        series.samples[-pixels:, runs - part :]
        if window_frames > runs
        else (series.samples[:, window_frames - part : window_frames])
    )
    at = chosen[chosen < pixels]
    at = at[(np.isfinite(early[at]).sum(axis=1) > part // 2) & (np.isfinite(late[at]).sum(axis=1) > part // 2)]
    if at.size < least_pixels:
        return None
    change = np.nanmedian(late[at], axis=1).astype(np.float64) - np.nanmedian(early[at], axis=1)
    if length_mm is not None:
        change = fold(change + 0.5 * length_mm, length_mm) - 0.5 * length_mm
    quartile = float(np.quantile(np.abs(change) / sigma[at], _QUARTILE))
    by_chance = GAUSSIAN_QUARTILE * MEDIAN_TO_MEAN * math.sqrt(2.0 / part)
    moved = math.sqrt(max(quartile**2 - by_chance**2, 0.0))
    return float(moved * window_frames / (window_frames - part))
