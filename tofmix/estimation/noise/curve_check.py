"""Whether a recording agrees with its noise curve: to learn the noise instead, and to warn before an estimate.

`doubts` and `is_contradicted` are a quick test of a Gaussian curve; if it passes, no noise is learnt. Clusters of one
surface are fitted under the curve. Their widths, drifts, the shape of their errors and the share of samples far from
all clusters are compared with the curve and p(c_r). A difference is only a reason to learn the noise: held-out pixels
decide whether the learnt noise is better.

`check_consistency` gives the scatter and the drift of the ranges as statistics, from some pixels of the first window;
`tofmix.report.summary.findings` decides which are reported.
"""

import math
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.bounds import Factor, NotNegative, Share, check_bounds
from tofmix.circle import fold
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.beam import beam_of
from tofmix.estimation.noise.amplitude import pixel_curves
from tofmix.estimation.noise.isolated_clusters import (
    FREE_DRIFT_SIGMAS,
    LEAST_CLUSTERS,
    WIDTH_INFORMATION,
    Clusters,
    FlatSamples,
    GaussianFits,
    PixelSigmas,
    find_clusters,
    fit_clusters,
)
from tofmix.estimation.noise.measurement import single_surface
from tofmix.estimation.noise.series import (
    LEAST_SAMPLES,
    SERIES_FRAMES,
    Series,
    SeriesStatistics,
    quantisation_step,
    read_runs,
    series_statistics,
    sigma_from_differences,
)
from tofmix.estimation.noise.training_pixels import Pixels, pixels_of, scatters
from tofmix.estimation.unrolling import UnrolledSource
from tofmix.noise_shape import DRIFTS, SIGMA_OF_STEP, RangeStep
from tofmix.recording import SampleSource, amplitude_source, by_target, samples_a_frame
from tofmix.sensor import NoiseCurve, Sensor

_QUARTILE = NormalDist().inv_cdf(7.0 / 8.0)
_QUARTILE_ERROR = round(math.sqrt(3.0) / (4.0 * _QUARTILE * NormalDist().pdf(_QUARTILE)), 2)
"""Relative standard error of the upper quartile of n chi-square variables of one degree, times sqrt(n).

The variance of a sample quantile is p (1 - p) / (n f^2), with f the density there: that of z^2 is phi(z) / z.

References
----------
Serfling, Approximation Theorems of Mathematical Statistics, 1980, section 2.3.3.
"""


_NODES, _NEWTON_STEPS = 40, 8
"""Nodes of the integral of a Student t density, and steps to its quantile: from 1 degree on to 1e-12."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveTolerances:
    """Differences between samples and their noise curve up to which no noise is learnt.

    Parameters
    ----------
    width : float
        Of the median log width from 0, and spread of log width.
    skewness, kurtosis : float
        Of the errors; the excess kurtosis. The defaults add one false alarm in a thousand.
    drift : float
        Over a window, in sigmas.
    background : float
        Share of samples far from all clusters, beyond p(c_r).
    differences : float
        Factor between the curve's sigma and that of differences of samples, which close surfaces widen.
    least_with_cluster : float
        Least part of the pixels with an isolated cluster; with fewer, differences of samples decide.
    standard_errors : float
        Standard errors beyond each tolerance: noise alone contradicts the curve in one of some hundred recordings.
    """

    width: NotNegative = 0.10
    skewness: NotNegative = 0.3
    kurtosis: NotNegative = 0.6
    drift: NotNegative = 0.5
    background: NotNegative = 0.01
    differences: Factor = 1.5
    least_with_cluster: Share = 0.5
    standard_errors: NotNegative = 3.0

    def __post_init__(self) -> None:
        check_bounds(self)


DEFAULT_TOLERANCES = CurveTolerances()


def doubts(pixels: Pixels, sensor: Sensor, *, tolerances: CurveTolerances = DEFAULT_TOLERANCES) -> list[str]:
    """Ways in which the samples contradict the sensor's Gaussian noise curve.

    Parameters
    ----------
    pixels : Pixels
        Some pixels of the recording.
    sensor : Sensor
        With a noise curve.
    tolerances : CurveTolerances
        Differences that are no contradiction.

    Returns
    -------
    list of str
        Of ``width``, ``widths``, ``shape``, ``drift``, ``background``; empty where there are too few clusters.

    Raises
    ------
    ValueError
        If the sensor has no noise curve.
    """
    if sensor.noise is None:
        raise ValueError("the sensor has no noise curve")
    beam = beam_of(sensor)
    if sensor.noise.law is not None and pixels.amplitude is not None:
        beam = beam._replace(pixel_curves=pixel_curves(pixels.samples.T, pixels.amplitude.T, sensor.noise))
    samples, sigma = FlatSamples.of(pixels.samples), PixelSigmas(beam)
    clusters = find_clusters(samples, len(pixels.samples), sigma)
    owners = np.unique(clusters.pixel)
    filled = np.count_nonzero(np.isfinite(pixels.samples).any(axis=1))
    if len(clusters.pixel) < LEAST_CLUSTERS or len(owners) < tolerances.least_with_cluster * filled:
        return _by_differences(pixels, sensor.noise, tolerances)
    free_scale = 0.5  # scale of log width while widths are measured: this prior leaves each width to its samples
    fits = fit_clusters(samples, clusters, sigma, width_scale=free_scale)
    drift_mm = FREE_DRIFT_SIGMAS * float(np.median(fits.sigma))
    drifting = fit_clusters(samples, clusters, sigma, width_scale=free_scale, drift_mm=drift_mm)
    found, errors = [], tolerances.standard_errors
    variance = 1.0 / (WIDTH_INFORMATION * np.maximum(fits.support, 1.0))
    count = len(fits.place)
    typical = float(np.median(fits.log_width))
    if abs(typical) > tolerances.width + errors * math.sqrt(float(np.median(variance)) / count):
        found.append("width")
    spread = MAD_TO_SIGMA * float(np.median(np.abs(fits.log_width - typical)))
    beyond = tolerances.width**2 + errors * float(np.median(variance)) * math.sqrt(2 / count)
    if spread**2 - float(np.median(variance)) > beyond:
        found.append("widths")
    if _is_shaped(fits, tolerances):
        found.append("shape")
    if _drifts(drifting, tolerances):
        found.append("drift")
    if _far_share(samples, fits, clusters) > sensor.outlier_probability + tolerances.background:
        found.append("background")
    return found


def is_contradicted(
    source: SampleSource, *, window_frames: int, stride_frames: int | None = None, step: RangeStep | None = None
) -> bool:
    """Whether the samples of a recording contradict the Gaussian curve of its sensor, by `doubts`.

    Parameters
    ----------
    source : SampleSource
        The recording, with a curve. Up to 1000 pixels are read.
    window_frames, stride_frames : int
        Frames of a window, and from one window to the next.
    step : RangeStep, optional
        Step of the stored ranges; default: a common one, from the samples.

    Raises
    ------
    ValueError
        If the sensor has no curve.
    """
    targets = samples_a_frame(source)
    stride = (stride_frames or window_frames) * targets
    pixels = pixels_of(source, window_frames * targets, stride, most=1000, step=step)
    sensor = source.sensor
    if step is not None and sensor.noise is not None:
        # Rounding, and its spread over the step, each add a variance of step^2 / 12.
        wider = np.hypot(sensor.noise.sigma_mm, math.sqrt(2.0) * step.rounding(sensor.noise.range_mm))
        sensor = replace(sensor, noise=replace(sensor.noise, sigma_mm=wider), range_step_mm=None)
    return scatters(pixels) and bool(doubts(pixels.with_fine_step(), sensor))


def _by_differences(pixels: Pixels, curve: NoiseCurve, tolerances: CurveTolerances) -> list[str]:
    """Whether differences of samples contradict the curve's sigma; for recordings without isolated clusters."""
    found = sigma_from_differences(pixels.samples)
    if found is None:
        return []
    ratio = float(np.median(found[1] / curve.sigma(found[0])))
    return ["width"] if not 1.0 / tolerances.differences <= ratio <= tolerances.differences else []


def _is_shaped(fits: GaussianFits, tolerances: CurveTolerances) -> bool:
    """Whether the errors of all clusters are skewed or long-tailed, beyond noise and tolerance."""
    central = 4.0  # largest error, in sigmas, that is a sign of a shape; one sigma farther out, errors are outliers
    z = fits.error[np.abs(fits.error) < central + 1.0]
    least_errors = 100  # least errors whose skewness and kurtosis are tested
    if z.size < least_errors:
        return False
    z = (z - z.mean()) / z.std()
    skewness, kurtosis = float((z**3).mean()), float((z**4).mean() - 3.0)
    errors = tolerances.standard_errors
    skewed = abs(skewness) > tolerances.skewness + errors * math.sqrt(6 / z.size)
    return skewed or kurtosis > tolerances.kurtosis + errors * math.sqrt(24 / z.size)


def _drifts(fits: GaussianFits, tolerances: CurveTolerances) -> bool:
    """Whether the typical change over a window by the first polynomial exceeds noise and tolerance.

    Without drift, the square of this change over the width is 12 / n times an F variable of 1 and n - 4 degrees of
    freedom, the square of a Student t variable: the mean and the three polynomials take four.
    """
    width = np.exp(fits.log_width) * fits.sigma
    n = max(float(np.median(fits.support)), 1.0)
    free = max(n - 1.0 - DRIFTS, 1.0)
    variance = 12.0 / free
    quartile = _quantile_of_t(7.0 / 8.0, free) ** 2
    square = float(np.quantile((2.0 * fits.drift[:, 0] / width) ** 2, 0.75)) / quartile
    error = tolerances.standard_errors * variance * _QUARTILE_ERROR / math.sqrt(len(width))
    return square - variance > tolerances.drift**2 + error


def _quantile_of_t(probability: float, degrees: float) -> float:
    """Quantile of a Student t variable, for probabilities from 1/2 on; SciPy, which has it too, is slow to import."""
    log_peak = math.lgamma(0.5 * (degrees + 1.0)) - math.lgamma(0.5 * degrees) - 0.5 * math.log(degrees * math.pi)
    node, weight = np.polynomial.legendre.leggauss(_NODES)

    def density(t: FloatArray) -> FloatArray:
        return np.exp(log_peak - 0.5 * (degrees + 1.0) * np.log1p(t * t / degrees))

    found = NormalDist().inv_cdf(probability)
    for _ in range(_NEWTON_STEPS):
        below = 0.5 + 0.5 * found * float(weight @ density(0.5 * found * (node + 1.0)))
        found -= (below - probability) / float(density(np.array(found)))
    return found


def _far_share(samples: FlatSamples, fits: GaussianFits, clusters: Clusters) -> float:
    """Median over the pixels of the share of samples far from all clusters of the pixel.

    Such samples may be of surfaces without an isolated cluster. So the median is a share of background only where most
    pixels see one surface.
    """
    near_sigmas = 8.0  # distance from a cluster, in sigmas, beyond which a sample counts as background
    reach = near_sigmas * fits.sigma * np.exp(np.maximum(fits.log_width, 0.0))
    change = np.zeros(len(samples.value) + 1, dtype=np.int64)
    np.add.at(change, samples.since(clusters.pixel, fits.place - reach), 1)
    np.add.at(change, samples.until(clusters.pixel, fits.place + reach), -1)
    far = np.cumsum(change[:-1]) == 0
    owners = np.unique(clusters.pixel)
    of_pixel = np.bincount(samples.pixel, minlength=owners[-1] + 1)[owners]
    return float(np.median(np.bincount(samples.pixel[far], minlength=owners[-1] + 1)[owners] / of_pixel))


MEDIAN_TO_MEAN = math.sqrt(math.pi / 2.0)
"""Standard error of the median of Gaussian samples over that of their mean (Kendall and Stuart, 10.10)."""

_DRIFT_QUANTILE = 0.75  # of the pixels' changes: a drift shows in a quarter of the pixels at least
GAUSSIAN_QUARTILE = NormalDist().inv_cdf(0.5 * (1.0 + _DRIFT_QUANTILE))
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
    quartile = float(np.quantile(np.abs(change) / sigma[at], _DRIFT_QUANTILE))
    by_chance = GAUSSIAN_QUARTILE * MEDIAN_TO_MEAN * math.sqrt(2.0 / part)
    moved = math.sqrt(max(quartile**2 - by_chance**2, 0.0))
    return float(moved * window_frames / (window_frames - part))
