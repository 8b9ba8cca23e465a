"""Surfaces files (`*.surfaces.h5`), written by `tofmix surfaces`.

`FIELDS` is the one list of datasets. Surfaces and lines are numbered within the file. The same surfaces and the same
provenance give the same bytes.
"""

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io import hdf5, sensor_group
from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.guard import guard
from tofmix.io.layers.provenance import read_surfaces_provenance, write_surfaces_provenance
from tofmix.io.result_file import open_result, typed_dataset
from tofmix.layers import MAX_LAYERS_LIMIT
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE
from tofmix.surfaces.found import NO_SURFACE, Edges, Planes, SurfacesProvenance, WindowSurfaces
from tofmix.wording import counted

FORMAT = "tofmix-surfaces"

LEAST_FACTOR, MOST_FACTOR = 2, 32
"""Parts along each side of a pixel that `tofmix surfaces` offers."""

MOST_POINTS_A_PIXEL = 64
"""Points of edges for each pixel, on average over a file: beyond it, they are no edges. A thin bar has four."""

_CHUNK_BYTES = 1 << 20
"""Approximate bytes of a stored chunk: a reader of a few rows unpacks little."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceField:
    """One dataset of a surfaces file; with `of_windows`, only where there is more than one window."""

    name: str
    dtype: str
    units: str
    long_name: str
    dims: tuple[str, ...]
    of_windows: bool = False


_IMAGE, _FINE, _POINT, _OF_SURFACE = (
    ("window", "row", "col", "layer"),
    ("window", "row_fine", "col_fine"),
    ("edge_point",),
    ("surface_index",),
)

FIELDS: tuple[SurfaceField, ...] = (
    SurfaceField(name="surface", dtype="i4", units="1", dims=_IMAGE, long_name="surface of the layer, -1 = none"),
    SurfaceField(name="range_fine", dtype="f4", units="mm", dims=_FINE, long_name="range of the nearest surface"),
    SurfaceField(name="surface_fine", dtype="i4", units="1", dims=_FINE, long_name="nearest surface, -1 = none"),
    SurfaceField(name="edge_row", dtype="f4", units="pixel", dims=_POINT, long_name="row of the point of an edge"),
    SurfaceField(name="edge_col", dtype="f4", units="pixel", dims=_POINT, long_name="column of the point of an edge"),
    SurfaceField(
        name="edge_stderr", dtype="f4", units="pixel", dims=_POINT, long_name="standard error across the edge"
    ),
    SurfaceField(name="edge_near", dtype="i4", units="1", dims=_POINT, long_name="surface that ends at the edge"),
    SurfaceField(
        name="edge_far", dtype="i4", units="1", dims=_POINT, long_name="surface behind the edge, -1 = no return"
    ),
    SurfaceField(name="edge_line", dtype="i4", units="1", dims=_POINT, long_name="line that the point belongs to"),
    SurfaceField(
        name="edge_window", dtype="u4", units="1", dims=_POINT, long_name="window of the point", of_windows=True
    ),
    SurfaceField(name="n_pixels", dtype="u4", units="1", dims=_OF_SURFACE, long_name="layers that are of the surface"),
    SurfaceField(
        name="plane_normal", dtype="f4", units="1", dims=(*_OF_SURFACE, "axis"), long_name="unit normal n of the plane"
    ),
    SurfaceField(
        name="plane_offset_mm", dtype="f4", units="mm", dims=_OF_SURFACE, long_name="offset of the plane, n . x"
    ),
    SurfaceField(
        name="rms_mm", dtype="f4", units="mm", dims=_OF_SURFACE, long_name="rms distance of layers along the beams"
    ),
    SurfaceField(
        name="surface_window", dtype="u4", units="1", dims=_OF_SURFACE, long_name="window of the surface",
        of_windows=True,
    ),
)  # fmt: skip
"""Every dataset, in the order of the file."""

_EDGE_KEYS = ("row", "col", "stderr", "near", "far", "line")
_PLANE_KEYS = {"n_pixels": "n_pixels", "normal": "plane_normal", "offset_mm": "plane_offset_mm", "rms_mm": "rms_mm"}
_AXIS = 3  # x, y, z


class SurfacesWriter:
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
        As for `AtomicFile`.

    Raises
    ------
    UsageError, StorageError
        As for `AtomicFile`.
    """

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
        windows, rows, cols = shape
        self._dims = {
            "window": windows, "row": rows, "col": cols, "layer": max_layers,
            "row_fine": rows * factor, "col_fine": cols * factor, "axis": _AXIS,
        }  # fmt: skip
        self._factor = factor
        self._provenance = provenance
        self._found: list[tuple[Planes, Edges]] = []
        self._surfaces = self._lines = 0
        self._file = AtomicFile(path, overwrite=overwrite, inputs=inputs)

    def __enter__(self) -> Self:
        origin = self._provenance
        title, history = f"surfaces and edges of {origin.source}", f"tofmix {origin.version} surfaces {origin.source}"
        with ExitStack() as stack:  # undone if anything below fails
            stack.enter_context(self._file)
            self._root = stack.enter_context(hdf5.create(self._file, kind=FORMAT, title=title, history=history))
            write_surfaces_provenance(self._root, origin)
            for name in ("window", "row", "col", "layer", "axis"):
                hdf5.add_scale(self._root, name, self._dims[name])
            self._root["axis"].attrs["long_name"] = "x to the right, y down, z away from the sensor"
            for name in ("row_fine", "col_fine"):
                self._add_places(name)
            for spec in FIELDS:
                if spec.dims[0] == "window":
                    self._add_image(spec)
            self._root["range_fine"].attrs["factor"] = np.int32(self._factor)
            sensor_group.write_sensor(self._root, origin.sensor, image=(self._dims["row"], self._dims["col"]))
            hdf5.add_nexus_view(self._root, name="surfaces", signal="range_fine", axes=_FINE)
            self._stack = stack.pop_all()
        return self

    def _add_places(self, name: str) -> None:
        """Add the scale of a fine axis: where its parts lie, in pixels."""
        places = (np.arange(self._dims[name]) + 0.5) / self._factor - 0.5
        scale = self._root.create_dataset(name, data=places, chunks=places.shape, fletcher32=True)
        scale.attrs["units"] = "pixel"
        scale.attrs["long_name"] = f"place of the part's centre; pixel {name.removesuffix('_fine')} k is at k"
        scale.make_scale(name)

    def _add_image(self, spec: SurfaceField) -> None:
        dims = {name: self._dims[name] for name in spec.dims}
        whole = tuple(dims.values())
        row_bytes = np.dtype(spec.dtype).itemsize * math.prod(whole[2:])
        chunks = (1, min(whole[1], max(1, _CHUNK_BYTES // row_bytes)), *whole[2:])
        hdf5.add_variable(
            self._root, spec.name, dims=dims, dtype=spec.dtype, units=spec.units, long_name=spec.long_name,
            chunks=chunks, fill=np.nan if spec.dtype.startswith("f") else None,
        )  # fmt: skip

    def write(self, found: WindowSurfaces) -> None:
        """Write the next window, its surfaces and lines numbered from 0; in the file they follow those before.

        Raises
        ------
        StorageError
            If the disk is full or fails.
        """
        window = len(self._found)
        self._root["surface"][window] = _shifted(found.surface, self._surfaces)
        self._root["range_fine"][window] = found.range_fine
        self._root["surface_fine"][window] = _shifted(found.surface_fine, self._surfaces)
        edges = found.edges
        self._found.append((found.planes, _renumbered(edges, self._surfaces, self._lines)))
        self._surfaces += len(found.planes)
        self._lines += int(edges.line[-1]) + 1 if len(edges) else 0
        self._file.check()

    def _write_rest(self) -> None:
        """Write planes and edges after all windows."""
        if len(self._found) != self._dims["window"]:
            raise RuntimeError(f"{counted(len(self._found), 'window')} written of {self._dims['window']}")
        self._dims["surface_index"] = self._surfaces
        self._dims["edge_point"] = sum(len(edges) for _, edges in self._found)
        for name in ("edge_point", "surface_index"):
            hdf5.add_scale(self._root, name, self._dims[name])
        arrays: dict[str, NDArray[Any]] = {
            f"edge_{key}": np.concatenate([getattr(edges, key) for _, edges in self._found]) for key in _EDGE_KEYS
        }
        arrays |= {
            name: np.concatenate([getattr(planes, key) for planes, _ in self._found])
            for key, name in _PLANE_KEYS.items()
        }
        windows = np.arange(len(self._found))
        arrays["edge_window"] = windows.repeat([len(edges) for _, edges in self._found])
        arrays["surface_window"] = windows.repeat([len(planes) for planes, _ in self._found])
        for spec in FIELDS:
            if spec.name in arrays and (len(windows) > 1 or not spec.of_windows):
                dims = {name: self._dims[name] for name in spec.dims}
                chunks = (max(1, min(len(arrays[spec.name]), _CHUNK_BYTES // 16)), *list(dims.values())[1:])
                hdf5.add_variable(
                    self._root, spec.name, dims=dims, dtype=spec.dtype, units=spec.units, long_name=spec.long_name,
                    data=arrays[spec.name].astype(spec.dtype), chunks=chunks,
                )  # fmt: skip
        self._file.check()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            with self._stack:
                self._write_rest()
        else:
            self._stack.__exit__(kind, error, trace)


def _shifted(numbers: NDArray[np.int32], first: int) -> NDArray[np.int32]:
    return np.where(numbers == NO_SURFACE, NO_SURFACE, numbers + first).astype(np.int32)


def _renumbered(edges: Edges, surfaces: int, lines: int) -> Edges:
    return Edges(
        row=edges.row, col=edges.col, stderr=edges.stderr, line=(edges.line + lines).astype(np.int32),
        near=_shifted(edges.near, surfaces), far=_shifted(edges.far, surfaces),
    )  # fmt: skip


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
        sensor_group.check_background(self.provenance.sensor, self.shape[1:], path)

    def _check_lengths(self, specs: list[SurfaceField]) -> None:
        windows, rows, cols = self.shape
        lengths = {
            "window": windows, "row": rows, "col": cols, "layer": self.max_layers, "axis": _AXIS,
            "row_fine": rows * self.factor, "col_fine": cols * self.factor,
            "edge_point": len(self._datasets["edge_row"]), "surface_index": len(self._datasets["n_pixels"]),
        }  # fmt: skip
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
        return Planes(**{key: self.read_dataset(name) for key, name in _PLANE_KEYS.items()})

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
        arrays: dict[str, Any] = {key: self.read_dataset(f"edge_{key}", part) for key in _EDGE_KEYS}
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
