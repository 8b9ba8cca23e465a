"""The step on which the ranges of a recording are stored: common, by range, or of each pixel."""

import math
from dataclasses import dataclass
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
