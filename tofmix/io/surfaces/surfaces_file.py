"""Reading of surfaces files; every dataset is checked when the file is opened, its values when they are read."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io import sensor_group
from tofmix.io.guard import guard
from tofmix.io.layers.provenance import read_surfaces_provenance
from tofmix.io.result_file import open_result, typed_dataset
from tofmix.io.surfaces.fields import AXIS, EDGE_KEYS, FIELDS, FORMAT, MOST_FACTOR, PLANE_KEYS, SurfaceField
from tofmix.options import MAX_LAYERS_LIMIT
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE
from tofmix.surfaces.found import NO_SURFACE, Edges, Planes, WindowSurfaces
from tofmix.wording import counted

MOST_POINTS_A_PIXEL = 64
"""Points of edges for each pixel, on average over a file: beyond it, they are no edges. A thin bar has four."""


class SurfacesFile:
    """An open surfaces file; made by `open_surfaces`."""

    def __init__(self, root: h5py.File, path: Path) -> None:
        self.path = path
        specs = [spec for spec in FIELDS if not spec.of_windows or spec.name in root]
        self._datasets = {
            spec.name: typed_dataset(root, spec.name, path, dtype=spec.dtype, dims=spec.dims) for spec in specs
        }
        images = self._datasets["surface"].shape
        self.shape: tuple[int, int, int] = images[:3]
        self.max_layers = int(images[3])
        if 0 in images:
            raise BadInputError(f"{path}: surface: shape {images} holds no layer")
        if max(images[1:3]) > MOST_PIXELS_A_SIDE or images[0] > MOST_FRAMES or images[3] > MAX_LAYERS_LIMIT:
            raise BadInputError(
                f"{path}: surface: shape {images}; no more than {MOST_FRAMES} windows of {MOST_PIXELS_A_SIDE} pixels"
                f" a side and {MAX_LAYERS_LIMIT} layers"
            )
        self.factor = _factor(self._datasets["range_fine"], path)
        self._check_lengths(specs)
        self.provenance = read_surfaces_provenance(root, path)
        sensor_group.check_maps(self.provenance.sensor, self.shape[1:], path)

    def _check_lengths(self, specs: list[SurfaceField]) -> None:
        windows, rows, cols = self.shape
        lengths = {
            "window": windows,
            "row": rows,
            "col": cols,
            "layer": self.max_layers,
            "axis": AXIS,
            "row_fine": rows * self.factor,
            "col_fine": cols * self.factor,
            "edge_point": len(self._datasets["edge_row"]),
            "surface_index": len(self._datasets["n_pixels"]),
        }
        for spec in specs:
            shape, expected = self._datasets[spec.name].shape, tuple(lengths[name] for name in spec.dims)
            if shape != expected:
                raise BadInputError(f"{self.path}: {spec.name}: shape {shape}, expected {spec.dims} = {expected}")
        pixels = windows * rows * cols
        if lengths["surface_index"] > pixels * self.max_layers:
            raise BadInputError(f"{self.path}: n_pixels: {lengths['surface_index']} surfaces, more than layers")
        if lengths["edge_point"] > pixels * MOST_POINTS_A_PIXEL:
            raise BadInputError(
                f"{self.path}: edge_row: {lengths['edge_point']} points of edges in {counted(pixels, 'pixel')}"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the datasets, in their order."""
        return tuple(self._datasets)

    @property
    def surfaces(self) -> int:
        """Surfaces of all windows."""
        return len(self._datasets["n_pixels"])

    @property
    def smooth_surfaces(self) -> int:
        """Surfaces that are smooth and no planes."""
        return int(self.planes.is_smooth.sum())

    @property
    def edge_points(self) -> int:
        """Points of the edges of all windows."""
        return len(self._datasets["edge_row"])

    @property
    def edge_lines(self) -> int:
        """Lines of the edges of all windows."""
        return int(self.read_dataset("edge_line", slice(-1, None))[-1]) + 1 if self.edge_points else 0

    def read_dataset(self, name: str, part: slice = slice(None)) -> NDArray[Any]:
        """Read one dataset, or a part along its first dimension, without a look at its values.

        Raises
        ------
        BadInputError
            If it cannot be read.
        """
        with guard.reading(self.path, name):
            return np.asarray(self._datasets[name][part])

    @cached_property
    def planes(self) -> Planes:
        """Planes of the surfaces of all windows."""
        return Planes(**{key: self.read_dataset(name) for key, name in PLANE_KEYS.items()})

    @cached_property
    def surface_window(self) -> NDArray[np.uint32]:
        """Window of each surface."""
        return self.read_windows("surface_window")

    @cached_property
    def _edge_starts(self) -> NDArray[np.intp]:
        """First point of each window, and the end."""
        return np.searchsorted(self.read_windows("edge_window"), np.arange(self.shape[0] + 1))

    def read_windows(self, name: str) -> NDArray[np.uint32]:
        """Read the window of each surface (`surface_window`) or of each point of an edge (`edge_window`).

        Raises
        ------
        BadInputError
            If it cannot be read, is missing in a file of several windows, or is no ascending list of its windows.
        """
        length = self.surfaces if name == "surface_window" else self.edge_points
        if name not in self._datasets:
            if self.shape[0] > 1 and length:
                raise BadInputError(f"{self.path}: no dataset {name}, but {self.shape[0]} windows")
            return np.zeros(length, dtype=np.uint32)
        windows = self.read_dataset(name)
        if (windows[1:] < windows[:-1]).any() or (windows >= self.shape[0]).any():
            raise BadInputError(f"{self.path}: {name}: expected windows 0 to {self.shape[0] - 1}, ascending")
        return windows

    def read_edges(self, window: int) -> Edges:
        """Read the edges of one window, numbered as in the file.

        Raises
        ------
        BadInputError
            If they cannot be read, have no place, or are of surfaces that are not in the file.
        """
        part = slice(int(self._edge_starts[window]), int(self._edge_starts[window + 1]))
        arrays: dict[str, Any] = {key: self.read_dataset(f"edge_{key}", part) for key in EDGE_KEYS}
        for key in ("near", "far"):
            self._check_numbers(f"edge_{key}", arrays[key])
        for key in ("row", "col"):
            if not np.isfinite(arrays[key]).all():
                raise BadInputError(f"{self.path}: edge_{key}: a point without a place; run tofmix verify")
        return Edges(**arrays)

    def read_image(self, name: str, window: int) -> NDArray[Any]:
        """Read `surface`, `range_fine` or `surface_fine` of one window, numbered as in the file.

        Raises
        ------
        BadInputError
            If it cannot be read, or names surfaces that are not in the file.
        """
        with guard.reading(self.path, name):
            image = np.asarray(self._datasets[name][window])
        if image.dtype.kind == "i":
            self._check_numbers(name, image)
        return image

    def read_window(self, window: int) -> WindowSurfaces:
        """Read one window; surfaces and lines are numbered as in the file, and `planes` are those of all windows.

        Raises
        ------
        BadInputError
            If it cannot be read, or names surfaces that are not in the file.
        """
        images: dict[str, Any] = {
            name: self.read_image(name, window) for name in ("surface", "range_fine", "surface_fine")
        }
        return WindowSurfaces(planes=self.planes, edges=self.read_edges(window), **images)

    def _check_numbers(self, name: str, numbers: NDArray[np.int32]) -> None:
        if numbers.size and not (int(numbers.min()) >= NO_SURFACE and int(numbers.max()) < self.surfaces):
            raise BadInputError(
                f"{self.path}: {name}: surfaces {numbers.min()} to {numbers.max()},"
                f" but the file has {counted(self.surfaces, 'surface')}; is it damaged? Run tofmix verify"
            )


@contextmanager
def open_surfaces(path: Path) -> Iterator[SurfacesFile]:
    """Open a surfaces file for reading.

    Raises
    ------
    BadInputError
        If the file is missing, not HDF5 or cut short, or is no surfaces file.
    """
    with open_result(path, kind=FORMAT, make=SurfacesFile) as surfaces:
        yield surfaces


def _factor(dataset: h5py.Dataset, path: Path) -> int:
    value = np.asarray(dataset.attrs.get("factor", 0))
    factor = int(value.reshape(-1)[0]) if value.size == 1 and value.dtype.kind in "iu" else 0
    if not 1 <= factor <= MOST_FACTOR:
        raise BadInputError(f"{path}: range_fine: attribute factor: expected a whole number from 1 to {MOST_FACTOR}")
    return factor
