"""What is no sample: values that stand for a lost sample, in sources of all kinds and in arrays.

One rule for `tofmix import` and `tofmix.from_array`. Recordings are read by the contract of their file instead.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray

FILLS_16_BIT = (32768.0, 65535.0)
"""Fill values of 16-bit counts. Wider types hold them too, to which counts were converted, as they are or in mm."""


_BITS_16 = 2  # bytes

GUESSED = ("fill value", "negative", "above")
"""Beginnings of the reasons that neither the source nor the user names."""


class NoSample(NamedTuple):
    """Samples that are none: `bad` of the shape of the values, and their numbers above 0 by reason, in order."""

    bad: BoolArray
    dropped: dict[str, int]


def no_sample(
    values: NDArray[Any],
    *,
    unit_mm: float,
    offset_mm: float = 0.0,
    invalid: tuple[float, ...] = (),
    valid_span: tuple[float, float] = (-math.inf, math.inf),
    keep_values: bool = False,
) -> NoSample:
    """Find the values that are no samples: zeros, NaN, infinities, and what the reasons name.

    Parameters
    ----------
    values : array of int or float
        Numbers of the source.
    unit_mm, offset_mm : float
        A range in mm is `unit_mm` times a value, plus `offset_mm`.
    invalid : tuple of float
        Values that are no samples, in the source's numbers.
    valid_span : (float, float)
        Least and largest valid value, in the source's numbers.
    keep_values : bool
        Whether zeros and fill values are ranges. What no recording can hold is dropped all the same: NaN, infinities,
        negative ranges.

    Returns
    -------
    NoSample
        A value counts for the first reason that applies.
    """
    bad = np.zeros(values.shape, dtype=np.bool_)
    dropped: dict[str, int] = {}
    reasons = _reasons(values, unit_mm, offset_mm, invalid, valid_span, keep_values=keep_values)
    for reason, mask in reasons:
        mask &= ~bad  # noqa: PLW2901  an array of this loop alone
        if count := int(np.count_nonzero(mask)):
            dropped[reason] = dropped.get(reason, 0) + count
            bad |= mask
    return NoSample(bad, dropped)


def is_camera_matrix(image: NDArray[Any]) -> bool:
    """Whether an array is no image but the matrix of a camera: 3 x 3, with a last row of 0 0 1."""
    return image.shape == (3, 3) and image[2].tolist() == [0, 0, 1]


def guessed(dropped: dict[str, int]) -> str:
    """Numbers and reasons of the values that neither the source nor the user calls invalid; empty without any."""
    return ", ".join(f"{number:,} {reason}" for reason, number in unnamed(dropped).items())


def unnamed(dropped: dict[str, int]) -> dict[str, int]:
    """Numbers by reason of the values that neither the source nor the user calls invalid."""
    return {reason: number for reason, number in dropped.items() if reason.startswith(GUESSED)}


def _reasons(
    values: NDArray[Any],
    unit_mm: float,
    offset_mm: float,
    invalid: tuple[float, ...],
    valid_span: tuple[float, float],
    *,
    keep_values: bool,
) -> Iterator[tuple[str, BoolArray]]:
    is_float = values.dtype.kind == "f"
    if is_float:
        yield "NaN", np.isnan(values)
        yield "infinite", np.isinf(values)
    if not keep_values:
        with np.errstate(invalid="ignore", over="ignore"):
            yield "zero", (values == 0) if not offset_mm else _wide(values) * float(unit_mm) == -offset_mm
    for value in invalid:
        # In the source's own precision: 0.1 as a float32 is not 0.1.
        with np.errstate(over="ignore"):
            yield f"value {value:g}", values == (np.asarray(value).astype(values.dtype) if is_float else value)
    if valid_span != (-math.inf, math.inf):
        with np.errstate(invalid="ignore"):
            yield (
                "outside of the stated valid range",
                (values < valid_span[0]) | (values > valid_span[1]),
            )
    if not keep_values:
        yield from _fills(values, unit_mm, offset_mm)
    if values.dtype.kind != "u" or offset_mm:
        with np.errstate(invalid="ignore", over="ignore"):
            yield "negative", _wide(values) * float(unit_mm) < -offset_mm


def _fills(values: NDArray[Any], unit_mm: float, offset_mm: float) -> Iterator[tuple[str, BoolArray]]:
    is_float = values.dtype.kind == "f"
    if not is_float:
        ends = np.iinfo(values.dtype)
        for end in (int(ends.max), *([int(ends.min)] if ends.min else [])):
            yield f"fill value {end}", values == np.array(end, dtype=values.dtype)
    most_mm = 1.0e9  # a range above this many mm, 1,000 km, is a fill value; netCDF's is 9.97e36
    if is_float or values.dtype.itemsize > _BITS_16:
        with np.errstate(invalid="ignore", over="ignore"):
            range_mm = _wide(values) * float(unit_mm) + offset_mm
            for value in FILLS_16_BIT:
                yield (
                    f"fill value {value:g} mm",
                    np.abs(range_mm - value) < _equal_mm(values, value, unit_mm, offset_mm),
                )
            yield f"above {most_mm:g} mm", range_mm > most_mm
    if values.dtype.itemsize >= _BITS_16 and _are_16_bit_counts(values):
        with np.errstate(over="ignore"):
            for value in FILLS_16_BIT:
                yield f"fill value {value:g}", values == value


def _wide(values: NDArray[Any]) -> NDArray[Any]:
    """Numbers of 16-bit floats in 32 bits, which hold them in mm."""
    return values.astype(np.float32) if values.dtype == np.float16 else values


def _equal_mm(values: NDArray[Any], fill_mm: float, unit_mm: float, offset_mm: float) -> float:
    """Most that a value in mm may differ from a fill value and still be the nearest number of its type."""
    equal_mm = 0.01  # 65.535 as a float32, and in mm, is within this of 65535 mm
    if values.dtype.kind != "f":
        return equal_mm
    with np.errstate(over="ignore", invalid="ignore"):
        spacing = float(np.spacing(values.dtype.type((fill_mm - offset_mm) / unit_mm)))
    return max(equal_mm, spacing * unit_mm / 2) if math.isfinite(spacing) else equal_mm


def _are_16_bit_counts(values: NDArray[Any]) -> bool:
    """Whether no value is above those of 16 bits: wider types hold such counts too, in any unit."""
    if values.dtype.kind != "f" and values.dtype.itemsize == _BITS_16:
        return True
    most = float(np.fmax.reduce(values, axis=None, initial=0, where=np.isfinite(values)))
    return most <= FILLS_16_BIT[-1]
