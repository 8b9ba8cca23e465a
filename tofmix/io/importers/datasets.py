"""A dataset of an HDF5 or netCDF file as frames, with its packing undone.

Frames are read in blocks of frames, for any order of its axes.

Packed numbers and fill values of HDF5 and netCDF datasets, as the CF conventions have them.

References
----------
CF Conventions 1.11, sections 2.5.1 and 8.1; NetCDF Users Guide, attributes ``_Unsigned`` and
``valid_range``. The default fill values
are those of netCDF's ``netcdf.h``.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.guard import guard
from tofmix.io.importers.arrays import Frames
from tofmix.io.importers.base import BLOCK_BYTES, as_stack, check_numbers, stack_shape

_DEFAULT_FILLS = {f"i{n}": -(2 ** (8 * n - 1)) + 1 for n in (1, 2, 4)} | {f"u{n}": 2 ** (8 * n) - 1 for n in (1, 2, 4)}
_DEFAULT_FILLS |= {"i8": -(2**63) + 2, "u8": 2**64 - 2}
"""netCDF's fill values of whole numbers; that of real ones is above any range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Packing:
    """How stored numbers become values: ``scale_factor * number + add_offset``; some numbers are no values."""

    # scale_factor, add_offset: In the unit of the dataset.
    scale_factor: float = 1.0
    add_offset: float = 0.0
    invalid: tuple[float, ...] = ()  # stored numbers that are fill values
    valid_span: tuple[float, float] = (-math.inf, math.inf)  # least and largest valid stored number
    dtype: np.dtype[Any] | None = None
    """Whole numbers that the stored ones are to be read as: netCDF-3 has no unsigned ones, and marks them."""

    def stated(self) -> dict[str, Any]:
        """Fields of a `FrameSource`."""
        return {name: getattr(self, name) for name in ("scale_factor", "add_offset", "invalid", "valid_span")}

    def as_marked(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Stored numbers as whole numbers with or without a sign, as the dataset marks them."""
        return stored if self.dtype is None else stored.view(self.dtype)

    def unpacked(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Values of stored numbers, as they are where nothing is packed; fill values become NaN."""
        if self == Packing():
            return stored
        stored = self.as_marked(stored)
        bad = np.isin(stored, self.invalid) | (stored < self.valid_span[0]) | (stored > self.valid_span[1])
        return np.where(bad, np.nan, stored * self.scale_factor + self.add_offset)


def packing_of(dataset: h5py.Dataset, path: Path, *, netcdf: bool) -> Packing:
    """Read the packing of a dataset; with `netcdf`, netCDF's default fill values count where it names none."""
    scale = _numbers(dataset, "scale_factor", path, count=1) or (1.0,)
    offset = _numbers(dataset, "add_offset", path, count=1) or (0.0,)
    if not (math.isfinite(scale[0]) and scale[0] > 0 and math.isfinite(offset[0])):
        raise BadInputError(
            f"{path}: {dataset.name}: scale_factor {scale[0]:g} and add_offset {offset[0]:g} are no packing of ranges"
        )
    fills = (*_numbers(dataset, "_FillValue", path, count=1), *_numbers(dataset, "missing_value", path))
    own = _own_fill(dataset)
    if not fills and own is not None:
        fills = (own,)
    dtype = _marked_dtype(dataset)
    kind = dataset.dtype.str[1:]
    if not fills and netcdf and kind in _DEFAULT_FILLS:
        fills = (float(_DEFAULT_FILLS[kind]),)
    if dtype is not None:
        fills = tuple(_as_marked(fill, dtype) for fill in fills)
    return Packing(
        scale_factor=scale[0],
        add_offset=offset[0],
        invalid=tuple(fill for fill in fills if not math.isnan(fill)),
        valid_span=_span(dataset, path, dtype, scale[0], offset[0]),
        dtype=dtype,
    )


def _marked_dtype(dataset: h5py.Dataset) -> np.dtype[Any] | None:
    """Type that ``_Unsigned`` of the NetCDF Users Guide gives to whole numbers; None where it changes nothing."""
    mark = dataset.attrs.get("_Unsigned")
    text = (mark.decode(errors="replace") if isinstance(mark, bytes) else str(mark)).lower()
    meant = {"true": "u", "1": "u", "false": "i", "0": "i"}.get(text)
    if meant is None or dataset.dtype.kind not in "iu" or dataset.dtype.kind == meant:
        return None
    return np.dtype(f"{dataset.dtype.byteorder}{meant}{dataset.dtype.itemsize}")


def _as_marked(number: float, dtype: np.dtype[Any]) -> float:
    """A limit or a fill value, which is stored as the numbers are, in the marked type."""
    if math.isinf(number) or not number.is_integer():
        return number
    size = 2 ** (8 * dtype.itemsize)
    whole = int(number) % size
    return float(whole - size if dtype.kind == "i" and whole >= size // 2 else whole)


def _span(
    dataset: h5py.Dataset, path: Path, dtype: np.dtype[Any] | None, scale: float, offset: float
) -> tuple[float, float]:
    """Least and largest valid stored number."""

    def stored(key: str, count: int) -> tuple[float, ...]:
        limits = _numbers(dataset, key, path, count=count)
        if _is_unpacked(dataset, key, limits):
            # The shortest text of a float32 is the number that was meant: 1.95, not 1.9500000477.
            short = np.asarray(dataset.attrs[key]).dtype.itemsize <= np.dtype(np.float32).itemsize
            meant = [float(str(np.float32(limit))) if short else limit for limit in limits]
            # A limit in stored numbers, from its value: 8.0 / 0.001 is 8000.000000000001 or less than 8000 in other
            # numbers.
            digits = 6
            return tuple(round((limit - offset) / scale, digits) for limit in meant)
        return limits if dtype is None else tuple(_as_marked(limit, dtype) for limit in limits)

    both = stored("valid_range", 2)
    least = stored("valid_min", 1) or both[:1] or (-math.inf,)
    most = stored("valid_max", 1) or both[1:] or (math.inf,)
    return least[0], most[0]


def _is_unpacked(dataset: h5py.Dataset, key: str, limits: tuple[float, ...]) -> bool:
    """Whether limits are values rather than stored numbers.

    By the NetCDF Users Guide they are where they have the wider type of ``scale_factor`` and ``add_offset``, and it is
    wider than that of the stored numbers. A limit with a fraction is no stored whole number either.
    """
    packing = [
        np.asarray(dataset.attrs[name]).dtype for name in ("scale_factor", "add_offset") if name in dataset.attrs
    ]
    if not limits or not packing:
        return False
    if dataset.dtype.kind in "iu" and not all(limit.is_integer() or math.isinf(limit) for limit in limits):
        return True
    wide = np.result_type(*packing)
    return bool(
        wide.kind == "f"
        and np.asarray(dataset.attrs[key]).dtype.newbyteorder("=") == wide.newbyteorder("=")
        and np.result_type(wide, dataset.dtype) == wide.newbyteorder("=")
        and wide.newbyteorder("=") != dataset.dtype.newbyteorder("=")
    )


def _own_fill(dataset: h5py.Dataset) -> float | None:
    """The fill value that the file's maker gave the dataset itself; None for HDF5's own 0."""
    if dataset.id.get_create_plist().fill_value_defined() != h5py.h5d.FILL_VALUE_USER_DEFINED:
        return None
    value = float(dataset.fillvalue)
    return value or None


def _numbers(dataset: h5py.Dataset, key: str, path: Path, *, count: int | None = None) -> tuple[float, ...]:
    value = dataset.attrs.get(key)
    if value is None:
        return ()
    numbers = np.asarray(value).reshape(-1)
    if numbers.dtype.kind not in "iuf" or numbers.size == 0 or (count is not None and numbers.size != count):
        expected = "numbers" if count is None else "a number" if count == 1 else f"{count} numbers"
        raise BadInputError(f"{path}: {dataset.name.lstrip('/')}: {key}: expected {expected}, got {value!r}")
    return tuple(float(number) for number in numbers)


def dataset_frames(
    dataset: h5py.Dataset, names: tuple[str, ...], image: tuple[int, int] | None, path: Path, name: str
) -> Frames:
    """The frames of a dataset that `tofmix.io.guard.guard` has checked.

    `names` are its axes, in the order in which they are stored; `image` are rows and columns where an axis is ``zone``.
    """
    what = f"{path}: {name}"
    check_numbers(dataset.dtype, what)
    frames, targets, (rows, cols) = stack_shape(dataset.shape, names, image, what)

    def images() -> Iterator[NDArray[Any]]:
        for part in _parts(dataset, names, frames, rows * cols * max(1, targets)):
            with guard.reading(path, name):
                block = np.asarray(dataset[part or ...])
            yield from as_stack(block, names, image, what)

    return Frames(images=images(), shape=(frames, rows, cols), targets=targets, dtype=dataset.dtype)


def _parts(dataset: h5py.Dataset, names: tuple[str, ...], frames: int, values: int) -> Iterator[tuple[slice, ...]]:
    """Selections of blocks of frames, of so many values each; all of a single image."""
    if "frame" not in names:
        yield ()
        return
    axis = names.index("frame")
    stored = dataset.chunks[axis] if dataset.chunks else 1
    most = max(1, BLOCK_BYTES // (values * dataset.dtype.itemsize))
    step = max(1, most // stored * stored) if most >= stored else most
    for start in range(0, frames, step):
        yield (*(slice(None),) * axis, slice(start, min(start + step, frames)))
