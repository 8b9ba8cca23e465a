"""Noise of a recording's pixels beyond the noise curve, as a sensor carries it, and the step of stored ranges.

Learnt noise of the pixels beyond the noise curve: background, drift, memory, and gains by chance.

`tofmix.estimation.learnt` learns it; a sensor carries it, so threads, shards, clusters and resumed runs all use the
same noise.

The step on which the ranges of a recording are stored: common, by range, or of each pixel.
"""

import math
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import BoolArray, FloatArray, IntArray

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
        `tofmix.estimation.mixture.false_alarms.FALSE_ALARMS`.
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
