"""Writing of surfaces files. The same surfaces and the same provenance give the same bytes."""

import math
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tofmix.io import hdf5, sensor_group
from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.layers.provenance import write_surfaces_provenance
from tofmix.io.surfaces.fields import AXIS, EDGE_KEYS, FIELDS, FINE_DIMS, FORMAT, PLANE_KEYS, SurfaceField
from tofmix.surfaces.found import NO_SURFACE, Edges, Planes, SurfacesProvenance, WindowSurfaces
from tofmix.wording import counted

_CHUNK_BYTES = 1 << 20
"""Approximate bytes of a stored chunk: a reader of a few rows unpacks little."""


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
            "window": windows,
            "row": rows,
            "col": cols,
            "layer": max_layers,
            "row_fine": rows * factor,
            "col_fine": cols * factor,
            "axis": AXIS,
        }
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
            hdf5.add_nexus_view(self._root, name="surfaces", signal="range_fine", axes=FINE_DIMS)
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
            self._root,
            spec.name,
            dims=dims,
            dtype=spec.dtype,
            units=spec.units,
            long_name=spec.long_name,
            chunks=chunks,
            fill=np.nan if spec.dtype.startswith("f") else None,
        )

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
            f"edge_{key}": np.concatenate([getattr(edges, key) for _, edges in self._found]) for key in EDGE_KEYS
        }
        arrays |= {
            name: np.concatenate([getattr(planes, key) for planes, _ in self._found])
            for key, name in PLANE_KEYS.items()
        }
        windows = np.arange(len(self._found))
        arrays["edge_window"] = windows.repeat([len(edges) for _, edges in self._found])
        arrays["surface_window"] = windows.repeat([len(planes) for planes, _ in self._found])
        for spec in FIELDS:
            if spec.name in arrays and (len(windows) > 1 or not spec.of_windows):
                dims = {name: self._dims[name] for name in spec.dims}
                chunks = (max(1, min(len(arrays[spec.name]), _CHUNK_BYTES // 16)), *list(dims.values())[1:])
                hdf5.add_variable(
                    self._root,
                    spec.name,
                    dims=dims,
                    dtype=spec.dtype,
                    units=spec.units,
                    long_name=spec.long_name,
                    data=arrays[spec.name].astype(spec.dtype),
                    chunks=chunks,
                )
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
        row=edges.row,
        col=edges.col,
        stderr=edges.stderr,
        line=(edges.line + lines).astype(np.int32),
        near=_shifted(edges.near, surfaces),
        far=_shifted(edges.far, surfaces),
    )
