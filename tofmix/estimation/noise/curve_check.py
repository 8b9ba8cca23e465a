"""A quick test of a Gaussian noise curve by the samples: if it passes, no noise is learnt.

Clusters of one surface are fitted under the curve. Their widths, drifts, the shape of their errors and the share of
samples far from all clusters are compared with the curve and p(c_r). A difference is only a reason to learn the noise:
held-out pixels decide whether the learnt noise is better.
"""

import math
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.bounds import Factor, NotNegative, Share, check_bounds
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.beam import beam_of
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
from tofmix.estimation.noise.pixel_noise import pixel_curves
from tofmix.estimation.noise.series import sigma_from_differences
from tofmix.estimation.noise.training_pixels import Pixels, pixels_of, scatters
from tofmix.noise_shape import DRIFTS, RangeStep
from tofmix.recording import SampleSource, samples_a_frame
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
