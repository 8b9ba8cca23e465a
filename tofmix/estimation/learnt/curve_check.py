"""A quick test of a Gaussian noise curve by the samples: if it passes, no noise is learnt.

Clusters of one surface are fitted under the curve. Their widths, drifts, the shape of their errors and the share of
samples far from all clusters are compared with the curve and p(c_r). A difference is only a reason to learn the noise:
held-out pixels decide whether the learnt noise is better.
"""

import math

import numpy as np

from tofmix.arrays import IntArray
from tofmix.compiled.robust import MAD_TO_SIGMA
from tofmix.estimation.beam import beam_of
from tofmix.estimation.learnt.clusters import ClusterFits, find_clusters, fit_clusters
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.pair_differences import sigma_from_differences
from tofmix.estimation.learnt.sigma_curve import LEAST_CLUSTERS
from tofmix.estimation.learnt.training_pixels import Pixels
from tofmix.estimation.noise.pixel_noise import pixel_curves
from tofmix.learnt_noise import DRIFTS
from tofmix.sensor import NoiseCurve, Sensor

WIDTH_TOLERANCE = 0.10
"""Tolerated difference of the median log width from 0, and tolerated spread of log width."""

SKEWNESS_TOLERANCE, KURTOSIS_TOLERANCE = 0.3, 0.6
"""Tolerated skewness and excess kurtosis of the errors: they add one false alarm in a thousand."""

DRIFT_TOLERANCE = 0.5
"""Tolerated drift over a window, in sigmas."""

BACKGROUND_TOLERANCE = 0.01
"""Tolerated share of samples far from all clusters, beyond p(c_r)."""

LEAST_WITH_CLUSTER = 0.5
"""Least part of the pixels with an isolated cluster: with fewer, differences of samples decide."""

FAR_OFF = 1.5
"""Tolerated factor between the curve's sigma and that of differences of samples, which close surfaces widen."""

SURE = 3.0
"""Standard errors beyond each tolerance: noise alone contradicts the curve in one of some hundred recordings."""

_NEAR_SIGMAS = 8.0  # of a cluster: samples farther from all clusters count as background
_QUARTILE_ERROR = 1.83
"""Relative standard error of the upper quartile of n chi-square variables of one degree, times sqrt(n)."""
_CENTRAL = 4.0  # sigmas; errors more than one sigma farther out are outliers, and no sign of a shape


def doubts(pixels: Pixels, sensor: Sensor) -> list[str]:
    """Ways in which the samples contradict the sensor's Gaussian noise curve.

    Parameters
    ----------
    pixels : Pixels
        Some pixels of the recording.
    sensor : Sensor
        With a noise curve.

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
    noise = PixelNoise.gaussian(sensor.noise, sensor.outlier_probability)
    beam = beam_of(sensor)
    if sensor.noise.law is not None and pixels.amplitude is not None:
        beam = beam._replace(pixel_curves=pixel_curves(pixels.samples.T, pixels.amplitude.T, sensor.noise))
    clusters = find_clusters(pixels.samples, beam)
    owners = np.unique(clusters.pixel)
    filled = np.count_nonzero(np.isfinite(pixels.samples).sum(axis=1) >= 1)
    if len(clusters.pixel) < LEAST_CLUSTERS or len(owners) < LEAST_WITH_CLUSTER * filled:
        return _by_differences(pixels, sensor.noise)
    free = PixelNoise(curve=sensor.noise, p_outlier=noise.p_outlier, background=(0.5, 5.0), drift_mm=np.zeros(DRIFTS))
    law = free.laws()[0]._replace(width_spread=0.5)
    fits = fit_clusters(pixels.samples, clusters, law, beam, False)  # noqa: FBT003  a kernel's flag
    moving = law._replace(drift_mm=np.full(DRIFTS, 3.0 * float(np.median(fits.sigma))))
    drifting = fit_clusters(pixels.samples, clusters, moving, beam, False)  # noqa: FBT003  a kernel's flag
    found = []
    chance = 1.0 / (law.width_information * np.maximum(fits.support, 1.0))
    count = len(fits.place)
    typical = float(np.median(fits.log_width))
    if abs(typical) > WIDTH_TOLERANCE + SURE * math.sqrt(float(np.median(chance)) / count):
        found.append("width")
    spread = MAD_TO_SIGMA * float(np.median(np.abs(fits.log_width - typical)))
    if spread**2 - float(np.median(chance)) > WIDTH_TOLERANCE**2 + SURE * float(np.median(chance)) * math.sqrt(
        2 / count
    ):
        found.append("widths")
    if _is_shaped(fits):
        found.append("shape")
    if _drifts(drifting):
        found.append("drift")
    far = _far_share(pixels, fits, clusters.pixel, owners)
    if far > sensor.outlier_probability + BACKGROUND_TOLERANCE:
        found.append("background")
    return found


def _by_differences(pixels: Pixels, curve: NoiseCurve) -> list[str]:
    """Whether differences of samples contradict the curve's sigma; for recordings without isolated clusters."""
    found = sigma_from_differences(pixels.samples)
    if found is None:
        return []
    ratio = float(np.median(found[1] / curve.sigma(found[0])))
    return ["width"] if not 1.0 / FAR_OFF <= ratio <= FAR_OFF else []


def _is_shaped(fits: ClusterFits) -> bool:
    """Whether the errors of all clusters are skewed or long-tailed, beyond noise and tolerance."""
    z = fits.error[np.isfinite(fits.error) & (np.abs(fits.error) < _CENTRAL + 1.0)]
    if z.size < 100:  # noqa: PLR2004  moments of fewer tell nothing
        return False
    z = (z - z.mean()) / z.std()
    skewness, kurtosis = float((z**3).mean()), float((z**4).mean() - 3.0)
    return abs(skewness) > SKEWNESS_TOLERANCE + SURE * math.sqrt(6 / z.size) or kurtosis > (
        KURTOSIS_TOLERANCE + SURE * math.sqrt(24 / z.size)
    )


def _drifts(fits: ClusterFits) -> bool:
    """Whether the typical change over a window by the first polynomial exceeds noise and tolerance.

    Without drift, the square of this change over the width is 12 / n times an F variable of 1 and n - 4 degrees of
    freedom: the mean and the three polynomials take four.
    """
    from scipy.stats import f

    width = np.exp(fits.log_width) * fits.sigma
    n = max(float(np.median(fits.support)), 1.0)
    free = max(n - 1.0 - DRIFTS, 1.0)
    chance = 12.0 / free
    quartile = float(f.ppf(0.75, 1.0, free))
    square = float(np.quantile((2.0 * fits.drift[:, 0] / width) ** 2, 0.75)) / quartile
    return square - chance > DRIFT_TOLERANCE**2 + SURE * chance * _QUARTILE_ERROR / math.sqrt(len(width))


def _far_share(pixels: Pixels, fits: ClusterFits, pixel: IntArray, owners: IntArray) -> float:
    """Median over the pixels of the share of samples far from all clusters of the pixel.

    Such samples may be of surfaces without an isolated cluster. So the median is a share of background only where most
    pixels see one surface.
    """
    share = np.zeros(len(owners))
    for i, owner in enumerate(owners):
        samples = pixels.samples[owner]
        samples = samples[np.isfinite(samples)]
        far = np.ones(len(samples), dtype=np.bool_)
        for c in np.flatnonzero(pixel == owner):
            reach = _NEAR_SIGMAS * fits.sigma[c] * math.exp(max(fits.log_width[c], 0.0))
            far &= np.abs(samples - fits.place[c]) > reach
        share[i] = far.mean()
    return float(np.median(share))
