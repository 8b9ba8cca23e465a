"""The density over range of random values, p(c_r): fog, rain or dust, whose returns lie near the sensor.

Without it, random values are uniform over the working range. One density holds for all pixels of a recording; how many
of a pixel's samples are random is the pixel's own share.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray

LEAST_POINTS = 2  # of a density

_ROUNDING = 1.0e-12
"""How far an area may be from 1 by the rounding of some thousand sums."""


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
        if range_mm.ndim != 1 or range_mm.shape != density.shape or range_mm.size < LEAST_POINTS:
            raise ValueError(
                f"background density: range and density must be two lists of one length, at least {LEAST_POINTS}, got"
                f" shapes {range_mm.shape} and {density.shape}"
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


def _areas(range_mm: FloatArray, density: FloatArray) -> FloatArray:
    """Area below each point."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(range_mm))])
