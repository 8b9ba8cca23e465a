"""One window's image of mean phasors: ranges, amplitudes, their errors, and where the pixels look.

Two quantities are smooth over a flat surface, on any grid of pixels:

- 1 / r = m . d, with the unit vector d of the pixel's beam: linear in the three numbers m of the plane, and exact;
- u = ln A + 3 ln r, a constant for a Lambertian plane under even light, as A falls with cos(incidence) / r^2 and
  cos(incidence) with 1 / r.

A plane gives the phasor of a pixel that it fills: z = exp(u - 3 ln r + i r / K).

A sample's phasor is z = A exp(i r / K), with the amplitude A and K = d_u / 2 pi. Use `mean_phasors` where the samples
are in memory; the results travel with the layers of a block until the image is whole.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.circle import unambiguous_range_mm
from tofmix.sensor import Sensor
from tofmix.unmixing.functions import binomial_most
from tofmix.unmixing.settings import DEFAULT_SETTINGS, ImageSettings

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


TINY = 1.0e-30
"""Least variance, determinant or divisor, in units of the image's median amplitude, squared: divisions stay finite."""

ComplexArray = NDArray[np.complex128]


class PixelDirections(NamedTuple):
    """Where pixels look: `direction`, `across`, `down` (pixel, 3), and the pitches (pixel,), as in `PhasorImage`."""

    direction: FloatArray
    across: FloatArray
    down: FloatArray
    pitch_across: FloatArray
    pitch_down: FloatArray


class Measured(NamedTuple):
    """Measurements of pixels, (pixel,) each, as in `PhasorImage`."""

    range_mm: FloatArray
    range_variance: FloatArray
    log_light: FloatArray
    light_variance: FloatArray
    noise_radial: FloatArray
    noise_tangential: FloatArray
    scatter_radial: FloatArray
    scatter_tangential: FloatArray


@dataclass(slots=True, kw_only=True, eq=False)
class PhasorImage:
    """The measurements of one window. Arrays are (pixel,), row by row, unless said otherwise.

    Parameters
    ----------
    shape : (int, int)
        Rows, columns.
    scale_mm : float
        K, mm a radian.
    phasor : complex
        Mean phasor z of each pixel.
    covariance : (pixel, 3)
        Variances of the real and the imaginary part of one sample, and their covariance.
    samples : float
        Samples in the mean.
    unit : float
        Amplitude that counts as 1 here: the median of the image, so that numbers are of order 1.
    directions : (pixel, 3)
        Unit vectors along the beams.
    range_mm : float
        Range of the mean phasor, on the turn of the samples.
    valid : bool
        Whether the pixel has a mean phasor that a surface returned.
    open_space : bool
        Whether the pixel sees no surface at all.
    across, down : (pixel, 3)
        Unit vectors across the beam, to the right and down in the image.
    pitch_across, pitch_down : float
        Tangent of the angle to the next pixel.
    settings : ImageSettings
        Thresholds of the errors.
    """

    shape: tuple[int, int]
    scale_mm: float
    phasor: ComplexArray
    covariance: FloatArray
    samples: FloatArray
    unit: float
    directions: FloatArray
    range_mm: FloatArray
    valid: BoolArray
    open_space: BoolArray
    across: FloatArray
    down: FloatArray
    pitch_across: FloatArray
    pitch_down: FloatArray
    settings: ImageSettings = DEFAULT_SETTINGS.image
    amplitude: FloatArray = field(init=False)
    mean_covariance: FloatArray = field(init=False)
    noise_radial: FloatArray = field(init=False)
    noise_tangential: FloatArray = field(init=False)
    scatter_radial: FloatArray = field(init=False)
    scatter_tangential: FloatArray = field(init=False)
    log_light: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.amplitude = np.abs(self.phasor)
        level = _level_of_neighbours(self)
        free = np.maximum(self.samples - 1.0, 1.0)[:, np.newaxis]
        even = np.stack([level, level, np.zeros_like(level)], axis=-1)
        prior = self.settings.prior_samples
        one = (self.covariance * free + prior * even) / (free + prior)
        self.mean_covariance = one / np.maximum(self.samples, 1.0)[:, np.newaxis]
        along = self.phasor / np.where(self.amplitude > 0, self.amplitude, 1.0)
        self.scatter_radial = variance_along(self.covariance, along)
        self.scatter_tangential = variance_along(self.covariance, 1j * along)
        most = self.settings.most_noise * level / np.maximum(self.samples, 1.0)
        self.noise_radial = np.minimum(variance_along(self.mean_covariance, along), most)
        self.noise_tangential = np.minimum(variance_along(self.mean_covariance, 1j * along), most)
        self.log_light = np.log(np.where(self.valid, self.amplitude, 1.0)) + 3.0 * np.log(self.range_mm)

    @property
    def count(self) -> int:
        """Number of pixels."""
        return self.shape[0] * self.shape[1]

    @property
    def range_variance(self) -> FloatArray:
        """Variance of the mean's range by noise, mm^2."""
        amplitude = np.where(self.valid, self.amplitude, 1.0)
        return np.asarray(self.scale_mm**2 * self.noise_tangential / amplitude**2)

    @property
    def light_variance(self) -> FloatArray:
        """Variance of ln A by noise."""
        return np.asarray(self.noise_radial / np.where(self.valid, self.amplitude, 1.0) ** 2)

    def is_noisier(self, sigmas: float) -> BoolArray:
        """Whether the samples' ranges (pixel,) scatter more than those of neighbours, by more than standard errors.

        Samples of several surfaces, one each, do; those of one surface, or of a sum, do not.
        """
        free = np.maximum(self.samples - 1.0, 1.0)
        usual = _median_of_neighbours(self, self.scatter_tangential)
        return np.asarray(self.scatter_tangential > (1.0 + sigmas * np.sqrt(2.0 / free)) * usual)

    @property
    def beams(self) -> PixelDirections:
        """Where the pixels look, for kernels."""
        return PixelDirections(self.directions, self.across, self.down, self.pitch_across, self.pitch_down)

    @property
    def measured(self) -> Measured:
        """The measurements, for kernels."""
        return Measured(
            self.range_mm,
            self.range_variance,
            self.log_light,
            self.light_variance,
            self.noise_radial,
            self.noise_tangential,
            self.scatter_radial,
            self.scatter_tangential,
        )

    @property
    def pitch(self) -> FloatArray:
        """The larger of both pitches, (pixel,)."""
        return np.maximum(self.pitch_across, self.pitch_down)


def variance_along(covariance: FloatArray, unit: ComplexArray) -> FloatArray:
    """Variance (...,) along a unit vector of the complex plane, of covariances (..., 3)."""
    x, y = unit.real, unit.imag
    return np.asarray(covariance[..., 0] * x * x + covariance[..., 1] * y * y + 2.0 * covariance[..., 2] * x * y)


def polar_covariance(phasor: ComplexArray, tangential: FloatArray, radial: FloatArray) -> FloatArray:
    """Covariance (..., 3) of phasors with a variance across and one along their direction."""
    along = phasor / np.maximum(np.abs(phasor), np.finfo(float).tiny)
    x, y = along.real, along.imag
    return np.stack(
        [radial * x * x + tangential * y * y, radial * y * y + tangential * x * x, (radial - tangential) * x * y],
        axis=-1,
    )


def _level_of_neighbours(image: PhasorImage) -> FloatArray:
    """Median over 3 x 3 pixels of the variance of one sample, the mean of both parts' (pixel,)."""
    return _median_of_neighbours(image, 0.5 * (image.covariance[:, 0] + image.covariance[:, 1]))


def _median_of_neighbours(image: PhasorImage, values: FloatArray) -> FloatArray:
    """Median over 3 x 3 pixels of values (pixel,), of those with a phasor."""
    own = np.where(image.valid, values, np.nan)
    rows, cols = image.shape
    padded = np.pad(own.reshape(image.shape), 1, mode="edge")
    around = np.stack([padded[i : i + rows, j : j + cols].ravel() for i in range(3) for j in range(3)])
    around.sort(axis=0)  # NaN comes last
    known = np.isfinite(around).sum(axis=0)
    middle = np.take_along_axis(around, (np.maximum(known - 1, 0) // 2)[np.newaxis], axis=0)[0]
    return np.where(known > 0, middle, 0.0)


def make_image(
    phasors: Float32Array,
    directions: FloatArray,
    *,
    scale_mm: float,
    open_space: BoolArray,
    settings: ImageSettings = DEFAULT_SETTINGS.image,
) -> PhasorImage:
    """Make the image of one window.

    Parameters
    ----------
    phasors : (row, col, 7) float32
        From `tofmix.unmixing.image.mean_phasors`.
    directions : (row, col, 3) float64
        Unit vectors along the beams.
    scale_mm : float
        K, mm a radian.
    open_space : (row, col) bool
        Pixels that see no surface at all.

    Returns
    -------
    PhasorImage
        The image.
    """
    shape = (int(phasors.shape[0]), int(phasors.shape[1]))
    flat = np.asarray(phasors, np.float64).reshape(-1, phasors.shape[2])
    phasor: ComplexArray = flat[:, 0] + 1j * flat[:, 1]
    ways = np.asarray(directions, np.float64).reshape(-1, 3)
    across, down, pitch_across, pitch_down = _tangents(ways.reshape(*shape, 3))
    range_mm = scale_mm * (np.angle(phasor) + 2.0 * np.pi * flat[:, 6])
    empty = np.asarray(open_space, bool).ravel()
    valid = (flat[:, 5] >= settings.least_samples) & (np.abs(phasor) > 0) & (range_mm > 0) & ~empty
    unit = float(np.median(np.abs(phasor[valid]))) if valid.any() else 1.0
    return PhasorImage(
        shape=shape,
        scale_mm=scale_mm,
        phasor=phasor / unit,
        covariance=flat[:, 2:5] / unit**2,
        samples=flat[:, 5],
        unit=unit,
        directions=ways,
        range_mm=np.where(valid, range_mm, 1.0),
        valid=valid,
        open_space=empty,
        across=across,
        down=down,
        pitch_across=pitch_across,
        pitch_down=pitch_down,
        settings=settings,
    )


def _tangents(ways: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Unit vectors across each beam, to the right and down, and the pitch of the pixels that way."""
    rows, cols = ways.shape[:2]
    right = np.gradient(ways, axis=1) if cols > 1 else np.zeros_like(ways)
    below = np.gradient(ways, axis=0) if rows > 1 else np.zeros_like(ways)
    if cols == 1:
        right = np.cross(below, ways)
    if rows == 1:
        below = np.cross(ways, right)
    right = right - (right * ways).sum(axis=-1, keepdims=True) * ways
    pitch_across = np.linalg.norm(right, axis=-1)
    across = right / np.maximum(pitch_across, np.finfo(float).tiny)[..., np.newaxis]
    down = np.cross(ways, across)
    pitch_down = (below * down).sum(axis=-1)
    down = np.where(pitch_down[..., np.newaxis] < 0, -down, down)
    one, other = (part.reshape(-1, 3) for part in (across, down))
    least = np.finfo(float).tiny
    return one, other, np.maximum(pitch_across, least).ravel(), np.maximum(np.abs(pitch_down), least).ravel()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Window:
    """Places of a square window around a pixel, without the pixel by default; all (place,)."""

    row: IntArray
    col: IntArray


def window(reach: int, *, middle: bool = False) -> Window:
    """Window of (2 reach + 1)^2 places."""
    steps = np.arange(-reach, reach + 1)
    row, col = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
    kept = (row != 0) | (col != 0) | middle
    return Window(row=row[kept], col=col[kept])


def places(pixels: IntArray, shape: tuple[int, int], around: Window) -> tuple[IntArray, BoolArray]:
    """Pixels (n, place) in the windows of pixels (n,), and which of them lie in the image (the others are pixel 0)."""
    row, col = np.divmod(pixels, shape[1])
    rows, cols = row[:, np.newaxis] + around.row, col[:, np.newaxis] + around.col
    inside = (rows >= 0) & (rows < shape[0]) & (cols >= 0) & (cols < shape[1])
    return np.where(inside, rows * shape[1] + cols, 0), inside


def inverse_form(covariance: FloatArray, one: ComplexArray, other: ComplexArray) -> FloatArray:
    """One . C^-1 . other, (n,), of covariances (n, 3): of the parts, and between them."""
    determinant = np.maximum(covariance[:, 0] * covariance[:, 1] - covariance[:, 2] ** 2, TINY)
    mixed = one.real * other.imag + one.imag * other.real
    form = covariance[:, 1] * one.real * other.real + covariance[:, 0] * one.imag * other.imag
    return np.asarray((form - covariance[:, 2] * mixed) / determinant)
