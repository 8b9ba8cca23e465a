"""From the numbers of a source to those of a recording: radial ranges in mm, and invalid samples."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray

_WHOLE_MM = ("u1", "u2")
"""Types whose whole mm a recording holds as they are."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conversion:
    """How the depths of a source become ranges.

    0, NaN and infinities are never samples, nor are the values in `invalid`.

    Parameters
    ----------
    dtype : dtype
        Type of the depths.
    unit_mm : float
        mm of one unit, above 0.
    invalid : tuple of float
        Further invalid values, in the source's units.
    ray_over_depth : (row, col) float64, optional
        Range over depth, where depths are along z.
    unit_known : bool
        Whether the unit was given; if not, real numbers are checked.
    """

    dtype: np.dtype[Any]
    unit_mm: float = 1.0
    invalid: tuple[float, ...] = ()
    ray_over_depth: FloatArray | None = None
    unit_known: bool = True

    @property
    def is_doubtful(self) -> bool:
        """Whether the unit is a guess: whole numbers are rarely metres, real ones may be."""
        return not self.unit_known and self.dtype.kind == "f"

    @property
    def stored_dtype(self) -> str:
        """``u2`` where ranges are whole mm in 16 bits as they come, with 0 for no sample; else ``f4`` with NaN."""
        whole = self.dtype.newbyteorder("=").str[1:] in _WHOLE_MM
        return "u2" if whole and self.unit_mm == 1.0 and self.ray_over_depth is None else "f4"

    def __call__(self, depth: NDArray[Any]) -> NDArray[np.uint16] | NDArray[np.float32]:
        """Ranges in mm of `stored_dtype`, of the shape of `depth`; in `f4` rounded once, from float64."""
        bad = self._bad(depth)
        if self.stored_dtype == "u2":
            return np.where(bad, 0, depth).astype(np.uint16)
        scale = self.unit_mm if self.ray_over_depth is None else self.unit_mm * self.ray_over_depth
        with np.errstate(over="ignore", invalid="ignore"):
            range_mm = (depth.astype(np.float64) * scale).astype(np.float32)
        range_mm[bad | ~np.isfinite(range_mm)] = np.nan
        return range_mm

    def _bad(self, depth: NDArray[Any]) -> BoolArray:
        bad = depth == 0
        if depth.dtype.kind == "f":
            bad |= ~np.isfinite(depth)
        for value in self.invalid:
            # In the source's own precision: 0.1 as a float32 is not 0.1.
            with np.errstate(over="ignore"):
                bad |= depth == (np.asarray(value).astype(depth.dtype) if depth.dtype.kind == "f" else value)
        return np.asarray(bad, dtype=np.bool_)
