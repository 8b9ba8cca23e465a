"""From the samples of a pixel to its mean phasor, the input of unmixing.

A sample's phasor is z = A exp(i r / K), with the amplitude A and K = d_u / 2 pi. Use `mean_phasors` where the samples
are in memory; the results travel with the layers of a block until the image is whole.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.optics.geometry import unambiguous_range_mm
from tofmix.sensor import Sensor
from tofmix.unmixing.functions import binomial_most

FIELDS = ("real", "imaginary", "variance_real", "variance_imaginary", "covariance", "samples", "turn")
"""Values of each pixel, in the order of the last axis."""

FIELD_COUNT = len(FIELDS)


def phase_scale_mm(frequency_hz: float) -> float:
    """K = d_u / 2 pi, mm a radian, of a modulation frequency in Hz."""
    return unambiguous_range_mm(frequency_hz) / (2.0 * math.pi)


def mean_phasors(
    range_mm: NDArray[np.floating],
    amplitude: NDArray[np.floating],
    sensor: Sensor,
    *,
    suspect: float = 8.0,
    far_sigmas: float = 6.0,
    rare: float = 1.0e-3,
) -> Float32Array:
    """Mean, covariance and number of the phasors of each pixel.

    Outliers are left out: samples far from the others, if they are no more than the sensor's p(c_r) explains.

    Parameters
    ----------
    range_mm, amplitude : (frame, ...) array of float
        Samples; a sample without a finite range and amplitude is skipped.
    sensor : Sensor
        Its modulation frequency must be known.
    suspect : float
        Square of a sample's distance from the mean, over the sum of both variances, from which on outliers are looked
        for. Of 1000 Gaussian samples the largest has about 7; one outlier among n samples has n.
    far_sigmas : float
        Distance from the median, in sigma of the samples about it, of a sample that noise does not explain.
    rare : float
        Chance below which outliers alone do not explain the number of far samples: these belong to another surface.

    Returns
    -------
    (..., 7) float32
        `FIELDS`: mean (amplitude), variances and covariance of one sample (amplitude squared), samples used, and the
        turn of the circle that the ranges are on: r = K arg(z) + turn d_u. Without samples all is 0.

    Raises
    ------
    ValueError
        If the modulation frequency is not known.
    """
    if sensor.modulation_frequency_hz is None:
        raise ValueError("phasors need the modulation frequency")
    scale = phase_scale_mm(sensor.modulation_frequency_hz)
    shape = range_mm.shape[1:]
    ranges = np.asarray(range_mm, np.float32).reshape(len(range_mm), -1)
    light = np.asarray(amplitude, np.float32).reshape(ranges.shape)
    valid = np.isfinite(ranges) & np.isfinite(light)
    light = np.where(valid, light, np.float32(0))
    phase = np.where(valid, ranges, np.float32(0)) / np.float32(scale)
    real, imaginary = light * np.cos(phase), light * np.sin(phase)
    count, mean, parts = _moments(real, imaginary, valid)
    away = (real - mean.real) ** 2 + (imaginary - mean.imag) ** 2
    most = np.where(valid, away, 0.0).max(axis=0, initial=0.0)
    suspects = np.flatnonzero(most > suspect * (parts[0] + parts[1]))
    if suspects.size:
        kept = valid[:, suspects] & ~_outliers(
            real[:, suspects], imaginary[:, suspects], valid[:, suspects], sensor.outlier_probability, far_sigmas, rare
        )
        some = _moments(real[:, suspects], imaginary[:, suspects], kept)
        count[suspects], mean[suspects], parts[:, suspects] = some
    middle = _median(ranges, valid)
    length = 2.0 * math.pi * scale
    turn = np.rint((middle - scale * np.angle(mean)) / length)
    out = np.stack([mean.real, mean.imag, *parts, count, np.where(count > 0, turn, 0.0)], axis=-1)
    return np.asarray(np.nan_to_num(out), np.float32).reshape(*shape, FIELD_COUNT)


def _moments(
    real: Float32Array, imaginary: Float32Array, valid: BoolArray
) -> tuple[FloatArray, NDArray[np.complex128], FloatArray]:
    """Number (pixel,), mean (pixel,), and variances and covariance (3, pixel) of the valid phasors (frame, pixel)."""
    count = valid.sum(axis=0).astype(np.float64)
    whole = np.maximum(count, 1.0)
    x, y = (np.where(valid, part, 0.0).sum(axis=0, dtype=np.float64) / whole for part in (real, imaginary))
    dx, dy = np.where(valid, real - x, 0.0), np.where(valid, imaginary - y, 0.0)
    free = np.maximum(count - 1.0, 1.0)
    parts = np.stack([(dx * dx).sum(axis=0), (dy * dy).sum(axis=0), (dx * dy).sum(axis=0)]) / free
    return count, x + 1j * y, parts


def _median(values: Float32Array, valid: BoolArray) -> FloatArray:
    """Lower median (pixel,) of the valid values (frame, pixel); 0 without one."""
    ordered = np.sort(np.where(valid, values, np.inf), axis=0)
    middle = np.maximum(valid.sum(axis=0) - 1, 0) // 2
    found = np.take_along_axis(ordered, middle[np.newaxis], axis=0)[0]
    return np.where(np.isfinite(found), found, 0.0).astype(np.float64)


def _outliers(
    real: Float32Array, imaginary: Float32Array, valid: BoolArray, probability: float, far_sigmas: float, rare: float
) -> BoolArray:
    """Samples (frame, pixel) that are random values: far from the median phasor, and as few as those are."""
    away = np.hypot(real - _median(real, valid), imaginary - _median(imaginary, valid))
    # The median distance of a two-dimensional Gaussian is sqrt(2 ln 2) sigma.
    sigma = _median(away.astype(np.float32), valid) / math.sqrt(2.0 * math.log(2.0))
    far = valid & (away > far_sigmas * sigma)
    most = binomial_most(1.0 - rare, valid.sum(axis=0), probability)
    return np.asarray(far & (far.sum(axis=0) <= most))
