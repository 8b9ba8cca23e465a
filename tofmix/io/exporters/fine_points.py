"""The fine range image of surfaces as points in space: one point a part of a pixel."""

from collections.abc import Iterator, Sequence

import numpy as np

from tofmix.io.exporters.placing import directions, optics_of
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.points import MM_A_METRE, PointArray, PointField, packed

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
