"""Noise beyond sigma(r), as a sensor carries it: shape, random values, learnt noise, and the step of stored ranges.

`NoiseShape`: the density of z = (x - r) / sigma(r), where the error of one sample is not Gaussian. One shape holds for
all pixels of a camera. Its location and scale are fixed, so that a noise curve keeps its meaning: the median of z is 0,
and its central 68.27 % are as wide as a standard Gaussian's.

`BackgroundDensity`: the density over range of random values, p(c_r): fog, rain or dust, whose returns lie near the
sensor. Without it, random values are uniform over the working range. One density holds for all pixels of a recording;
how many of a pixel's samples are random is the pixel's own share.

`LearntNoise`: background, drift, memory, and gains by chance. `tofmix.estimation.learnt` learns it; a sensor carries
it, so threads, shards, clusters and resumed runs all use the same noise.

`RangeStep`: the step on which the ranges of a recording are stored, common, by range, or of each pixel.
"""

import math
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class BackgroundDensity:
    """Density of random values, linear between its points and constant past its ends.

    Parameters
    ----------
    range_mm : (n,) float64
        Strictly ascending ranges, mm, at least two: from one end of the working range to the other.
    density : (n,) float64
        Density at each of them, 1/mm, above 0. It is scaled so that the area under it is 1.

    Raises
    ------
    ValueError
        If the two differ in length or are too short, a value is not finite, the ranges do not ascend, or a density is
        not above 0.
    """

    range_mm: FloatArray
    density: FloatArray

    def __post_init__(self) -> None:
        range_mm = np.array(self.range_mm, dtype=np.float64, copy=True)
        density = np.array(self.density, dtype=np.float64, copy=True)
        least_background_points = 2  # of a density
        if range_mm.ndim != 1 or range_mm.shape != density.shape or range_mm.size < least_background_points:
            raise ValueError(
                "background density: range and density must be two lists of one length, at least"
                f" {least_background_points}, got shapes {range_mm.shape} and {density.shape}"
            )
        if not (np.isfinite(range_mm).all() and np.isfinite(density).all()):
            raise ValueError("background density: a value is not finite")
        if not (np.diff(range_mm) > 0).all():
            raise ValueError("background density: its ranges do not ascend")
        if not (density > 0).all():
            raise ValueError("background density: a density is not above 0")
        area = _areas(range_mm, density)[-1]
        if abs(area - 1.0) > _ROUNDING:  # a density that was scaled once keeps its numbers, to the last digit
            density /= area
        range_mm.setflags(write=False)
        density.setflags(write=False)
        object.__setattr__(self, "range_mm", range_mm)
        object.__setattr__(self, "density", density)

    @classmethod
    def uniform(cls, low_mm: float, high_mm: float) -> Self:
        """Make the uniform density from one range to another, mm."""
        return cls(np.array([low_mm, high_mm]), np.ones(2))

    def at(self, range_mm: ArrayLike) -> FloatArray:
        """Density, 1/mm, at ranges of any shape, mm."""
        return np.asarray(np.interp(np.asarray(range_mm, np.float64), self.range_mm, self.density))

    def quantile(self, chance: ArrayLike) -> FloatArray:
        """Range, mm, below which a random value lies with each chance, of any shape."""
        wanted, width = np.clip(np.asarray(chance, dtype=np.float64), 0.0, 1.0), np.diff(self.range_mm)
        below = _areas(self.range_mm, self.density)
        at = np.clip(np.searchsorted(below, wanted, side="right") - 1, 0, len(width) - 1)
        rest, first = wanted - below[at], self.density[at]
        slope = np.diff(self.density)[at] / width[at]
        # rest = d t + s t^2 / 2; this form of the root is exact for s = 0 and loses no digits.
        root = np.sqrt(np.maximum(first**2 + 2.0 * slope * rest, 0.0))
        return np.asarray(self.range_mm[at] + np.clip(2.0 * rest / (first + root), 0.0, width[at]), dtype=np.float64)

    def same_as(self, other: "BackgroundDensity | None") -> bool:
        """Whether all numbers are equal."""
        return (
            other is not None
            and np.array_equal(self.range_mm, other.range_mm)
            and np.array_equal(self.density, other.density)
        )


CENTRAL = (0.158655253931457, 0.5, 0.841344746068543)
"""Chances that a standard Gaussian number is below -1, 0 and 1."""


_ROUNDING = 1.0e-12
"""How far an area may be from 1 by the rounding of some thousand sums."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseShape:
    """Density of the standardised error, linear between its points and 0 past its ends.

    Parameters
    ----------
    z : (n,) float64
        Strictly ascending standardised errors, at least three.
    density : (n,) float64
        Density at each of them, at least 0. It is scaled so that the area under it is 1.

    Raises
    ------
    ValueError
        If the two differ in length or are too short, a value is not finite, z does not ascend, a density is negative or
        all are 0, or the median is not 0 or the central 68 % are not as wide as a standard Gaussian's, to 0.05.
    """

    z: FloatArray
    density: FloatArray

    def __post_init__(self) -> None:
        z = np.array(self.z, dtype=np.float64, copy=True)
        density = np.array(self.density, dtype=np.float64, copy=True)
        least_points = 3  # points of a density
        if z.ndim != 1 or z.shape != density.shape or z.size < least_points:
            raise ValueError(
                f"noise shape: z and density must be two lists of one length, at least {least_points}, got shapes"
                f" {z.shape} and {density.shape}"
            )
        if not (np.isfinite(z).all() and np.isfinite(density).all()):
            raise ValueError("noise shape: a value is not finite")
        if not (np.diff(z) > 0).all():
            raise ValueError("noise shape: its z do not ascend")
        if (density < 0).any() or not (density > 0).any():
            raise ValueError("noise shape: a density must be at least 0, and one above 0")
        area = _areas(z, density)[-1]
        if abs(area - 1.0) > _ROUNDING:  # a shape that was scaled once keeps its numbers, to the last digit
            density /= area
        z.setflags(write=False)
        density.setflags(write=False)
        object.__setattr__(self, "z", z)
        object.__setattr__(self, "density", density)
        low, middle, high = self.quantile(CENTRAL)
        # How far, in sigmas, a given shape's median and half width may be from 0 and 1: a table has a step.
        tolerance = 0.05
        if abs(middle) > tolerance or abs(0.5 * (high - low) - 1.0) > tolerance:
            raise ValueError(
                "noise shape: expected median 0 and half width 1 of the central 68 %, as of a standard Gaussian; got"
                f" {middle:.3g} and {0.5 * (high - low):.3g}"
            )

    @classmethod
    def standardised(cls, z: ArrayLike, density: ArrayLike) -> Self:
        """The shape of any density, moved and scaled to the median 0 and the width of a standard Gaussian.

        Raises
        ------
        ValueError
            As the class, but for the median and the width.
        """
        places, heights = np.asarray(z, dtype=np.float64), np.asarray(density, dtype=np.float64)
        area = _areas(places, heights)[-1]
        if not area > 0:
            raise ValueError("noise shape: a density must be at least 0, and one above 0")
        low, middle, high = _quantile(np.array(CENTRAL), places, heights / area)
        return cls((places - middle) / (0.5 * (high - low)), heights)

    def pdf(self, z: ArrayLike) -> FloatArray:
        """Density at z of any shape."""
        return np.asarray(
            np.interp(np.asarray(z, dtype=np.float64), self.z, self.density, left=0.0, right=0.0), dtype=np.float64
        )

    def quantile(self, chance: ArrayLike) -> FloatArray:
        """Return the z below which a sample lies with each chance, of any shape: draws are those of uniform numbers."""
        return _quantile(np.asarray(chance, dtype=np.float64), self.z, self.density)

    def cdf(self, z: ArrayLike) -> FloatArray:
        """Chance that a sample lies below z, of any shape."""
        places = np.clip(np.asarray(z, dtype=np.float64), self.z[0], self.z[-1])
        below = _areas(self.z, self.density)
        at = np.clip(np.searchsorted(self.z, places, side="right") - 1, 0, len(self.z) - 2)
        past = places - self.z[at]
        slope = np.diff(self.density) / np.diff(self.z)
        return np.asarray(below[at] + past * (self.density[at] + 0.5 * slope[at] * past), dtype=np.float64)

    def moments(self) -> tuple[float, float, float, float]:
        """Mean, standard deviation, skewness and excess kurtosis of z."""
        fine = np.linspace(self.z[0], self.z[-1], 8 * len(self.z) + 1)
        weight = self.pdf(fine)
        weight /= weight.sum()
        mean = float(weight @ fine)
        m2, m3, m4 = (float(weight @ (fine - mean) ** power) for power in (2, 3, 4))
        return mean, m2**0.5, m3 / m2**1.5, m4 / m2**2 - 3.0

    def same_as(self, other: "NoiseShape | None") -> bool:
        """Whether all numbers are equal."""
        return other is not None and np.array_equal(self.z, other.z) and np.array_equal(self.density, other.density)


def _areas(z: FloatArray, density: FloatArray) -> FloatArray:
    """Area below each point."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(z))])


def _quantile(chance: FloatArray, z: FloatArray, density: FloatArray) -> FloatArray:
    """Invert the piecewise quadratic distribution of a density that is linear between its points."""
    below = _areas(z, density)
    wanted = np.clip(chance, 0.0, 1.0) * below[-1]
    at = np.clip(np.searchsorted(below, wanted, side="right") - 1, 0, len(z) - 2)
    rest = wanted - below[at]
    width = z[at + 1] - z[at]
    slope = (density[at + 1] - density[at]) / width
    # rest = d t + s t^2 / 2; this form of the root is exact for s = 0 and loses no digits.
    root = np.sqrt(np.maximum(density[at] ** 2 + 2.0 * slope * rest, 0.0))
    t = 2.0 * rest / np.maximum(density[at] + root, np.finfo(np.float64).tiny)
    return np.asarray(z[at] + np.clip(t, 0.0, width), dtype=np.float64)


WHOLE_MM = 1.0
"""Step, mm, of ranges that are stored as integers."""

LEAST_SIGMA = 0.1
"""Least sigma that a step tells, in steps: a surface in the middle of its step then shows one value in 10^6 samples."""

SIGMA_OF_STEP = 1.0 / math.sqrt(12.0)
"""Standard deviation of a uniform error over a step, in steps."""


@dataclass(frozen=True, slots=True, eq=False)
class RangeStep:
    """A step of stored ranges.

    Parameters
    ----------
    range_mm, step_mm : (n,) float64
        Ranges, mm, ascending, and the step at each, mm: linear in between, constant past the ends. One point is a
        common step.
    own_mm : (pixel,) float64, optional
        Step of each pixel, mm, NaN where it is not known; the points then are one, the median.
    """

    range_mm: FloatArray
    step_mm: FloatArray
    own_mm: FloatArray | None = None

    @classmethod
    def common(cls, step_mm: float) -> Self:
        """One step for all."""
        return cls(np.zeros(1), np.array([step_mm]))

    @classmethod
    def of_pixels(cls, own_mm: ArrayLike) -> Self:
        """A step of each pixel, NaN where it is not known."""
        own = np.asarray(own_mm, dtype=np.float64).ravel()
        return cls(np.zeros(1), np.array([np.nanmedian(own)]), own)

    @property
    def is_common(self) -> bool:
        """Whether it is one number."""
        return self.own_mm is None and len(self.step_mm) == 1

    def chosen(self, pixel: IntArray | BoolArray) -> "RangeStep":
        """The step of some pixels (n,), by their numbers, or by a mask (pixel,)."""
        if self.own_mm is None:
            return self
        return RangeStep(self.range_mm, self.step_mm, self.own_mm[pixel])

    def without_pixels(self) -> "RangeStep":
        """The step by range alone: the median one where each pixel has its own."""
        return RangeStep(self.range_mm, self.step_mm)

    def typical(self) -> float:
        """Median step, mm."""
        return float(np.median(self.step_mm))

    def at(self, range_mm: ArrayLike, pixel: IntArray | None = None) -> FloatArray:
        """Step, mm, at ranges, mm, of pixels, both of one shape; the median one where a pixel's is not known."""
        by_range = np.asarray(np.interp(np.asarray(range_mm), self.range_mm, self.step_mm), dtype=np.float64)
        if self.own_mm is None or pixel is None:
            return by_range
        own = self.own_mm[pixel]
        return np.where(np.isfinite(own), own, by_range)

    def least_sigma(self, range_mm: ArrayLike) -> FloatArray:
        """Least sigma, mm, that values on the step tell at ranges, mm."""
        return np.asarray(LEAST_SIGMA * self.at(range_mm), dtype=np.float64)

    def rounding(self, range_mm: ArrayLike) -> FloatArray:
        """Standard deviation, mm, of the rounding to the step at ranges, mm."""
        return np.asarray(SIGMA_OF_STEP * self.at(range_mm), dtype=np.float64)


DRIFTS = 3
"""Legendre polynomials of time, of the degrees 1 to 3, that a pixel's ranges may follow within a window."""

TAIL_DEGREES = 4.0
"""Degrees of freedom of the Student t priors of log width and drift: some pixels are far wider than others."""

MOST_LOG_WIDTH = 1.5
"""Largest absolute log width of a pixel."""

_SHAPES = {"drift_mm": 1, "gain_samples": 1, "gain_background": 1, "gain_more": 3, "gain_first": 2}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LearntNoise:
    """Noise of pixels in addition to a curve, and the gains in likelihood that this noise alone reaches.

    Parameters
    ----------
    background : (float, float) or None
        Prior of each pixel's share of uniform background, a Beta density: pseudo-counts, in samples, of background and
        of the rest. None: every pixel has about the sensor's p(c_r).
    drift_mm : (DRIFTS,) float64
        Scale, mm, of what each pixel's ranges follow within a window.
    memory : float
        Correlation of the standardised error from one frame to the next, as of AR(1) noise, in [0, 1).
    gain_samples : (n,) float64
        Numbers of samples, ascending, that the gains are known for.
    gain_background : (b,) float64
        Shares of background, ascending, that they are known for.
    gain_more : (n, b, chance) float64
        Gain, nat, of one surface more that noise exceeds with each of
        `tofmix.estimation.mixture.counting.FALSE_ALARMS`.
    gain_first : (n, chance) float64
        The same for the first surface beside background alone.

    Raises
    ------
    ValueError
        If an array has a wrong number of dimensions or a wrong length, a number is not finite, or one is out of its
        bounds.
    """

    background: tuple[float, float] | None
    drift_mm: FloatArray
    memory: float
    gain_samples: FloatArray
    gain_background: FloatArray
    gain_more: FloatArray
    gain_first: FloatArray

    def __post_init__(self) -> None:
        for name, dimensions in _SHAPES.items():
            values = np.array(getattr(self, name), dtype=np.float64, copy=True)
            if values.ndim != dimensions or values.size == 0 or not np.isfinite(values).all() or (values < 0).any():
                raise ValueError(
                    f"learnt noise: {name}: expected {dimensions} dimensions of finite numbers, none negative"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        sizes = len(self.gain_samples), len(self.gain_background)
        if self.gain_more.shape[:2] != sizes or self.gain_first.shape != (sizes[0], self.gain_more.shape[2]):
            raise ValueError("learnt noise: the tables of gains differ in size")
        if len(self.drift_mm) != DRIFTS:
            raise ValueError(f"learnt noise: drift_mm: {len(self.drift_mm)} numbers, not {DRIFTS}")
        if not 0 <= self.memory < 1:
            raise ValueError(f"learnt noise: memory {self.memory:g} is not in [0, 1)")
        if self.background is not None and not (min(self.background) > 0 and np.isfinite(self.background).all()):
            raise ValueError("learnt noise: background: two finite numbers above 0 are expected")

    def same_as(self, other: "LearntNoise | None") -> bool:
        """Whether all numbers are equal."""
        return other is not None and all(
            np.array_equal(np.array(getattr(self, f.name) or 0.0), np.array(getattr(other, f.name) or 0.0))
            if f.name == "background"
            else np.array_equal(getattr(self, f.name), getattr(other, f.name))
            for f in fields(self)
        )
