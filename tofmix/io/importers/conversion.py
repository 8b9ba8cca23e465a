"""From the numbers of a source to those of a recording: radial ranges in mm, and invalid samples.

Status codes beside the ranges: which of them mark a valid sample.
"""

import math
import re
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.io.importers.base import SourceRequest
from tofmix.io.importers.streams import set_of
from tofmix.io.samples import no_sample

_NAMES = set_of("status confidence quality valid validity flag flags error errors")


def is_status_name(name: str) -> bool:
    """Whether a column, dataset or array holds codes or grades of samples, by a word of its name."""
    words = re.split(r"[^a-z0-9]+", name.lower())
    return any(word.rstrip("0123456789") in _NAMES for word in words)


def codes_of(name: str, request: SourceRequest) -> tuple[int, ...] | None:
    """Codes of valid samples in a column, dataset or array of a name or path; None where nothing tells them.

    `valid_status` of the request is used first, then the camera's codes for whatever is called ``status``.
    """
    last = name.rpartition("/")[2].lower()
    if request.valid_status is not None:
        wanted, codes = request.valid_status
        return codes if wanted.strip("/").lower() in (name.strip("/").lower(), last) else None
    of_camera = "status" in re.split(r"[^a-z0-9]+", last)
    return request.status_codes if of_camera and request.status_codes else None


_WHOLE_MM = ("u1", "u2")
"""Types whose whole mm a recording holds as they are."""


class Converted(NamedTuple):
    """Ranges in mm of the shape of the depths, and the number of values that were dropped, by reason."""

    range_mm: NDArray[np.uint16] | NDArray[np.float32]
    dropped: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conversion:
    """How the depths of a source become ranges.

    `tofmix.io.samples.no_sample` says which values are no samples.
    """

    dtype: np.dtype[Any]  # type of the depths
    unit_mm: float = 1.0  # mm of one unit, above 0
    offset_mm: float = 0.0  # added after the unit, mm
    invalid: tuple[float, ...] = ()  # further invalid values, in the source's numbers
    valid_span: tuple[float, float] = (-math.inf, math.inf)  # least and largest valid value, in the source's numbers
    status_valid: tuple[int, ...] = ()  # status codes of valid samples
    ray_over_depth: FloatArray | None = None
    """(row, col) float64, optional: Range over depth, where depths are along z."""
    unit_known: bool = True  # whether the unit was given; if not, real numbers are checked
    keep_values: bool = False  # whether zeros and fill values are ranges

    @property
    def is_doubtful(self) -> bool:
        """Whether the unit is a guess: whole numbers are rarely metres, real ones may be."""
        return not self.unit_known and self.dtype.kind == "f"

    @property
    def stored_dtype(self) -> str:
        """``u2`` where ranges are whole mm in 16 bits as they come, with 0 for no sample; else ``f4`` with NaN."""
        whole = self.dtype.newbyteorder("=").str[1:] in _WHOLE_MM and not self.keep_values
        as_they_are = self.unit_mm == 1.0 and not self.offset_mm and self.ray_over_depth is None
        return "u2" if whole and as_they_are else "f4"

    def __call__(self, depth: NDArray[Any], status: NDArray[Any] | None = None) -> Converted:
        """Convert a frame, (row, col) or (target, row, col), with status codes of the same shape.

        The ranges are of `stored_dtype`; in `f4` they are rounded once, from float64.
        """
        bad, dropped = no_sample(
            depth,
            unit_mm=self.unit_mm,
            offset_mm=self.offset_mm,
            invalid=self.invalid,
            valid_span=self.valid_span,
            keep_values=self.keep_values,
        )
        if status is not None:
            unfit = ~bad & ~np.isin(status, self.status_valid)
            if count := int(np.count_nonzero(unfit)):
                dropped["status"] = count
                bad |= unfit
        if self.stored_dtype == "u2":
            return Converted(np.where(bad, 0, depth).astype(np.uint16), dropped)
        with np.errstate(over="ignore", invalid="ignore"):
            along: Any = 1.0 if self.ray_over_depth is None else self.ray_over_depth
            rounded = (depth.astype(np.float64) * (self.unit_mm * along) + self.offset_mm * along).astype(np.float32)
        rounded[bad | ~np.isfinite(rounded)] = np.nan
        return Converted(rounded, dropped)
