"""Places of an image in space, on surfaces: on their planes, or on the fine range image of smooth ones.

The fine range image of surfaces as points in space: one point a part of a pixel.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io.surfaces_file import SurfacesFile
from tofmix.optics.projection import Projection, unit
from tofmix.points import MM_A_METRE, PointArray, PointField, packed
from tofmix.surfaces.found import plane_ranges


def optics_of(file: SurfacesFile) -> Projection:
    """The projection of a surfaces file."""
    with _worded(file):
        optics = file.provenance.sensor.optics
    if optics is None:
        raise BadInputError(f"{file.path}: sensor: no field of view, so surfaces cannot be placed in space")
    return optics


def directions(file: SurfacesFile, row: ArrayLike, col: ArrayLike) -> FloatArray:
    """Unit vectors (..., 3) along the beams at places of the image, in pixels."""
    optics = optics_of(file)
    with _worded(file):
        return unit(optics.rays(row, col, shape=file.shape[1:]))


def on_planes(
    file: SurfacesFile, surface: NDArray[np.integer], row: NDArray[np.floating], col: NDArray[np.floating]
) -> FloatArray:
    """Points at which the beams at places of the image meet the planes of surfaces.

    `surface` (n,) are numbers of surfaces, `row` and `col` (n,) places in pixels. The result (n, 3) is in metres in the
    sensor's frame; NaN where a beam does not meet its plane, and without a surface.
    """
    along = directions(file, row, col)
    return np.asarray(along * (plane_ranges(file.planes, surface, along) / MM_A_METRE)[:, np.newaxis])


def on_surfaces(
    file: SurfacesFile, window: int, surface: NDArray[np.integer], row: NDArray[np.floating], col: NDArray[np.floating]
) -> FloatArray:
    """Points of surfaces of a window in the beams at places of the image; arguments as for `on_planes`.

    The result (n, 3) is in metres in the sensor's frame: on the plane as `on_planes`, or in the range of the part of a
    smooth surface that is nearest, within a pixel; NaN without one.
    """
    out = on_planes(file, surface, row, col)
    bent = np.append(file.planes.is_smooth, False)[surface]
    if bent.any():
        numbers, ranges = (file.read_image(name, window) for name in ("surface_fine", "range_fine"))
        near_mm = _nearest_ranges(numbers, ranges, file.factor, surface[bent], row[bent], col[bent])
        out[bent] = directions(file, row[bent], col[bent]) * (near_mm / MM_A_METRE)[:, np.newaxis]
    return out


def _nearest_ranges(
    numbers: NDArray[np.int32],
    ranges: NDArray[np.float32],
    factor: int,
    surface: NDArray[np.integer],
    row: NDArray[np.floating],
    col: NDArray[np.floating],
) -> FloatArray:
    """Range (n,) of the part of each surface that is nearest to a place, within a pixel; NaN without one."""
    out = np.full(len(surface), np.nan)
    places = np.stack([row, col], axis=1).astype(np.float64)
    parts = (places + 0.5) * factor - 0.5
    first = np.maximum(np.ceil(parts - factor), 0).astype(np.int64)
    last = np.floor(parts + factor).astype(np.int64) + 1
    for k in range(len(surface)):
        here = slice(first[k, 0], last[k, 0]), slice(first[k, 1], last[k, 1])
        own = np.argwhere((numbers[here] == surface[k]) & np.isfinite(ranges[here]))
        if len(own):
            nearest = own[((own + first[k] - parts[k]) ** 2).sum(axis=1).argmin()]
            out[k] = ranges[here][tuple(nearest)]
    return out


@contextmanager
def _worded(file: SurfacesFile) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise BadInputError(f"{file.path}: sensor: {error}") from error


FIELDS: tuple[PointField, ...] = (
    PointField(name="x", dtype="<f4", units="m", long_name="to the right"),
    PointField(name="y", dtype="<f4", units="m", long_name="down"),
    PointField(name="z", dtype="<f4", units="m", long_name="away from the sensor"),
    PointField(name="range", dtype="<f4", units="mm", long_name="range of the nearest surface"),
    PointField(name="surface", dtype="<i4", units="1", long_name="the surface, -1 = none"),
    PointField(name="row", dtype="<f4", units="pixel", long_name="row in the image"),
    PointField(name="col", dtype="<f4", units="pixel", long_name="column in the image"),
    PointField(name="window", dtype="<u4", units="1", long_name="window of the layers file"),
)
"""Properties of a point."""

BLOCK_PLACES = 1 << 18
"""Parts of pixels in a block of points: some tens of megabytes while they are placed."""


class FinePoints:
    """Points of the parts of pixels that have a range, of some windows, in blocks of rows."""

    def __init__(self, file: SurfacesFile, windows: Sequence[int]) -> None:
        optics_of(file)
        self._file = file
        self._windows = windows
        self._fine = file.shape[1] * file.factor, file.shape[2] * file.factor
        self._step = max(1, BLOCK_PLACES // self._fine[1])

    @property
    def fields(self) -> tuple[PointField, ...]:
        """Properties of a point."""
        return FIELDS

    def __iter__(self) -> Iterator[PointArray]:
        """Points (point,) of blocks of rows, by window, row and column."""
        for window in self._windows:
            ranges, surface = (self._file.read_image(name, window) for name in ("range_fine", "surface_fine"))
            for first in range(0, self._fine[0], self._step):
                rows = slice(first, first + self._step)
                yield self._block(ranges[rows], surface[rows], first, window)

    def _block(self, ranges: np.ndarray, surface: np.ndarray, first: int, window: int) -> PointArray:
        part_row, part_col = np.nonzero(np.isfinite(ranges))
        row, col = ((part + 0.5) / self._file.factor - 0.5 for part in (part_row + first, part_col))
        points = np.zeros(len(row), dtype=packed(FIELDS))
        range_mm = ranges[part_row, part_col]
        place = directions(self._file, row, col) * (range_mm.astype(np.float64) / MM_A_METRE)[:, np.newaxis]
        points["x"], points["y"], points["z"] = place.T
        points["range"], points["surface"] = range_mm, surface[part_row, part_col]
        points["row"], points["col"], points["window"] = row, col, window
        return points

    def count(self) -> int:
        """Count the points; reads every window."""
        return sum(int(np.isfinite(self._file.read_image("range_fine", window)).sum()) for window in self._windows)

    def __len__(self) -> int:
        """Blocks."""
        return len(self._windows) * -(-self._fine[0] // self._step)
