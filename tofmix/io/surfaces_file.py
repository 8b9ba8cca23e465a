"""Surfaces files (`*.surfaces.h5`): written by `tofmix surfaces`, read by `export` and `report`.

Every dataset is checked when a file is opened, its values when they are read. The same surfaces and the same provenance
give the same bytes.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io import hdf5, sensor_group
from tofmix.io.hdf5 import ResultFile, open_result
from tofmix.io.layers.layers_file import read_surfaces_provenance, write_provenance
from tofmix.io.schema import (
    AXIS,
    FINE_DIMS,
    IMAGE_FIELDS,
    LIST_FIELDS,
    MOST_FACTOR,
    OF_WINDOWS,
    SURFACES,
    SURFACES_FIELDS,
    Field,
)
from tofmix.surfaces.found import NO_SURFACE, Edges, Planes, SurfacesProvenance, WindowSurfaces
from tofmix.wording import counted

FORMAT = SURFACES


_CHUNK_BYTES = 1 << 20
"""Approximate bytes of a stored chunk: a reader of a few rows unpacks little."""

_EDGES = {name: name.removeprefix("edge_") for name in (spec.name for spec in LIST_FIELDS[:6])}
_PLANES = {name: name.removeprefix("plane_") for name in ("n_pixels", "plane_normal", "plane_offset_mm", "rms_mm")}
"""Datasets of `Edges` and of `Planes`, and their fields."""


class SurfacesWriter(hdf5.FileWriter):
    """Writes a surfaces file window by window; the file gets its name when all windows are in.

    Use it as a context manager, and `write` the windows in their order. Images go to the file at once; planes and edges
    are held until the end.

    Parameters
    ----------
    path : Path
        The new file.
    shape : (int, int, int)
        Windows, rows, columns.
    max_layers : int
        Length of the layer axis.
    factor : int
        Parts along each side of a pixel.
    provenance : SurfacesProvenance
        Source and options of the surfaces.
    overwrite, inputs
        As for `AtomicFile`, also for its errors.
    """

    kind = SURFACES

    def __init__(
        self,
        path: Path,
        *,
        shape: tuple[int, int, int],
        max_layers: int,
        factor: int,
        provenance: SurfacesProvenance,
        overwrite: bool = False,
        inputs: tuple[Path, ...] = (),
    ) -> None:
        super().__init__(
            path,
            title=f"surfaces and edges of {provenance.source}",
            history=f"tofmix {provenance.version} surfaces {provenance.source}",
            overwrite=overwrite,
            inputs=inputs,
        )
        windows, rows, cols = shape
        self._dims = {"window": windows, "row": rows, "col": cols, "layer": max_layers, "axis": AXIS}
        self._fine = {"row_fine": rows * factor, "col_fine": cols * factor}
        self._factor = factor
        self._provenance = provenance
        self._found: list[tuple[Planes, Edges]] = []
        self._surfaces = self._lines = 0

    def _begin(self, root: h5py.File) -> None:
        write_provenance(root, self._provenance)
        for name, length in self._dims.items():
            hdf5.add_scale(root, name, length)
        root["axis"].attrs["long_name"] = "x to the right, y down, z away from the sensor"
        for name, length in self._fine.items():
            self._add_places(name, length)
        for spec in IMAGE_FIELDS:
            self._add_image(spec)
        root["range_fine"].attrs["factor"] = np.int32(self._factor)
        sensor_group.write_sensor(root, self._provenance.sensor, image=(self._dims["row"], self._dims["col"]))
        hdf5.add_nexus_view(root, name="surfaces", signal="range_fine", axes=FINE_DIMS)

    def _add_places(self, name: str, length: int) -> None:
        """Add the scale of a fine axis: where its parts lie, in pixels."""
        places = (np.arange(length) + 0.5) / self._factor - 0.5
        scale = self._root.create_dataset(name, data=places, chunks=places.shape, fletcher32=True)
        scale.attrs["units"] = "pixel"
        scale.attrs["long_name"] = f"place of the part's centre; pixel {name.removesuffix('_fine')} k is at k"
        scale.make_scale(name)

    def _add_image(self, spec: Field) -> None:
        lengths = self._dims | self._fine
        whole = tuple(lengths[name] for name in spec.dims)
        row_bytes = np.dtype(spec.dtype).itemsize * math.prod(whole[2:])
        chunks = (1, min(whole[1], max(1, _CHUNK_BYTES // row_bytes)), *whole[2:])
        hdf5.add_field(self._root, spec, lengths, chunks=chunks)

    def write(self, found: WindowSurfaces) -> None:
        """Write the next window, its surfaces and lines numbered from 0; in the file they follow those before."""
        window = len(self._found)
        self._root["surface"][window] = _shifted(found.surface, self._surfaces)
        self._root["range_fine"][window] = found.range_fine
        self._root["surface_fine"][window] = _shifted(found.surface_fine, self._surfaces)
        edges = found.edges
        self._found.append((found.planes, _renumbered(edges, self._surfaces, self._lines)))
        self._surfaces += len(found.planes)
        self._lines += int(edges.line[-1]) + 1 if len(edges) else 0
        self._file.check()

    def _end(self) -> None:
        """Write planes and edges after all windows."""
        windows = range(len(self._found))
        if len(windows) != self._dims["window"]:
            raise RuntimeError(f"{counted(len(windows), 'window')} written of {self._dims['window']}")
        hdf5.add_scale(self._root, "edge_point", sum(len(edges) for _, edges in self._found))
        hdf5.add_scale(self._root, "surface_index", self._surfaces)
        arrays: dict[str, NDArray[Any]] = {
            name: np.concatenate([getattr(found[k], key) for found in self._found])
            for k, keys in enumerate((_PLANES, _EDGES))
            for name, key in keys.items()
        }
        if len(windows) > 1:
            arrays["edge_window"] = np.repeat(windows, [len(edges) for _, edges in self._found])
            arrays["surface_window"] = np.repeat(windows, [len(planes) for planes, _ in self._found])
        for spec in LIST_FIELDS:
            if spec.name in arrays:
                values = arrays[spec.name].astype(spec.dtype)
                chunks = (max(1, min(len(values), _CHUNK_BYTES // 16)), *values.shape[1:])
                hdf5.add_field(self._root, spec, data=values, chunks=chunks)
        self._file.check()


def _shifted(numbers: NDArray[np.int32], first: int) -> NDArray[np.int32]:
    return np.where(numbers == NO_SURFACE, NO_SURFACE, numbers + first).astype(np.int32)


def _renumbered(edges: Edges, surfaces: int, lines: int) -> Edges:
    return Edges(
        row=edges.row,
        col=edges.col,
        stderr=edges.stderr,
        line=(edges.line + lines).astype(np.int32),
        near=_shifted(edges.near, surfaces),
        far=_shifted(edges.far, surfaces),
    )


class SurfacesFile(ResultFile):
    """An open surfaces file; made by `open_surfaces`."""

    def __init__(self, root: h5py.File, path: Path) -> None:
        present = [spec for spec in SURFACES_FIELDS if spec.name not in OF_WINDOWS or spec.name in root]
        super().__init__(root, path, present, "surface")
        self.factor = _factor(self._datasets["range_fine"], path)
        windows, rows, cols = self.shape
        fine = {"row_fine": rows * self.factor, "col_fine": cols * self.factor}
        self._check_lengths({"axis": AXIS, "edge_point": self.edge_points, "surface_index": self.surfaces, **fine})
        pixels = windows * rows * cols
        if self.surfaces > pixels * self.max_layers:
            raise BadInputError(f"{path}: n_pixels: {self.surfaces} surfaces, more than layers")
        # Points of edges for each pixel, on average over a file: beyond it, they are no edges. A thin bar has four.
        most_points_a_pixel = 64
        if self.edge_points > pixels * most_points_a_pixel:
            points = f"{self.edge_points} points of edges in {counted(pixels, 'pixel')}"
            raise BadInputError(f"{path}: edge_row: {points}")
        self.provenance = read_surfaces_provenance(root, path)
        sensor_group.check_maps(self.provenance.sensor, self.shape[1:], path)

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

    @cached_property
    def planes(self) -> Planes:
        """Planes of the surfaces of all windows."""
        return Planes(**{key: self.read_dataset(name) for name, key in _PLANES.items()})

    @cached_property
    def surface_window(self) -> NDArray[np.uint32]:
        """Window of each surface."""
        return self.read_windows("surface_window")

    @cached_property
    def _edge_starts(self) -> NDArray[np.intp]:
        """First point of each window, and the end."""
        return np.searchsorted(self.read_windows("edge_window"), np.arange(self.shape[0] + 1))

    def read_windows(self, name: str) -> NDArray[np.uint32]:
        """Read the window of each surface (`surface_window`) or of each point of an edge (`edge_window`)."""
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
        """Read the edges of one window, numbered as in the file."""
        part = slice(int(self._edge_starts[window]), int(self._edge_starts[window + 1]))
        arrays: dict[str, Any] = {key: self.read_dataset(name, part) for name, key in _EDGES.items()}
        for key in ("near", "far"):
            self._check_numbers(f"edge_{key}", arrays[key])
        for key in ("row", "col"):
            if not np.isfinite(arrays[key]).all():
                raise BadInputError(f"{self.path}: edge_{key}: a point without a place; run tofmix verify")
        return Edges(**arrays)

    def read_image(self, name: str, window: int) -> NDArray[Any]:
        """Read `surface`, `range_fine` or `surface_fine` of one window, numbered as in the file."""
        image = self.read_dataset(name, window)
        if image.dtype.kind == "i":
            self._check_numbers(name, image)
        return image

    def read_window(self, window: int) -> WindowSurfaces:
        """Read one window; surfaces and lines are numbered as in the file, and `planes` are those of all windows."""
        images: dict[str, Any] = {spec.name: self.read_image(spec.name, window) for spec in IMAGE_FIELDS}
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
