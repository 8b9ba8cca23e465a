"""Layers files (`*.layers.h5`): written by `estimate`, read by `report`.

The datasets are those of `tofmix.layers.layer_fields`. The same layers and the same provenance give the same bytes, for
any blocks of writing.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.flags import Mixing, Status, mixing_name, status_name
from tofmix.grid import Grid
from tofmix.io import hdf5, sensor_group
from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.guard import guard
from tofmix.io.layers.provenance import header_image, read_provenance, write_provenance
from tofmix.io.result_file import open_result, typed_dataset
from tofmix.layers import (
    ENDS,
    LAW_TEXTS,
    LAYER_DIMS,
    LAYER_FIELDS,
    OPTIONAL_FIELDS,
    SUSPECT,
    SUSPECT_FRAMES,
    LayerField,
    Layers,
    Provenance,
)
from tofmix.mixing import MixingLaw, law_over_windows
from tofmix.options import MAX_LAYERS_LIMIT
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE
from tofmix.suspicion.registry import SUSPICIONS
from tofmix.windows import Windows

FORMAT = "tofmix-layers"


class LayersWriter:
    """Writes a layers file block by block; the file gets its name after the last block.

    Use it as a context manager. Blocks must come in one order for any number of workers.

    Parameters
    ----------
    path : Path
        The new file.
    windows : Windows
        The windows of the recording.
    image : (int, int)
        Rows, columns.
    max_layers : int
        Length of the layer axis.
    tile : (int, int)
        Windows and rows of one stored chunk.
    provenance : Provenance
        Source and options of the layers.
    overwrite, inputs, temporary
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
        windows: Windows,
        image: tuple[int, int],
        max_layers: int,
        tile: tuple[int, int],
        provenance: Provenance,
        overwrite: bool = False,
        inputs: tuple[Path, ...] = (),
        temporary: Path | None = None,
    ) -> None:
        self._windows = windows
        self._dims = dict(zip(LAYER_DIMS, (windows.count, *image, max_layers), strict=True))
        self._tile = tile
        self._provenance = provenance
        self._file = AtomicFile(path, overwrite=overwrite, inputs=inputs, temporary=temporary)

    def __enter__(self) -> Self:
        history = f"tofmix {self._provenance.version} estimate {self._provenance.source}"
        title = f"surfaces of {self._provenance.source}"
        with ExitStack() as stack:  # undone if anything below fails
            stack.enter_context(self._file)
            self._root = stack.enter_context(hdf5.create(self._file, kind=FORMAT, title=title, history=history))
            write_provenance(self._root, self._provenance)
            for name, length in self._dims.items():
                hdf5.add_scale(self._root, name, length)
            for spec in self._provenance.fields:
                self._add(spec)
            self._add_windows()
            if self._provenance.is_unmixed:
                self._add_law()
            sensor_group.write_sensor(self._root, self._provenance.sensor, image=(self._dims["row"], self._dims["col"]))
            hdf5.add_nexus_view(self._root, name="layers", signal="range", axes=LAYER_DIMS)
            self._stack = stack.pop_all()
        return self

    def _add(self, spec: LayerField) -> None:
        if spec.ends and ENDS not in self._root:
            hdf5.add_scale(self._root, ENDS, 2)
        dims = {name: 2 if name == ENDS else self._dims[name] for name in spec.dims}
        whole = tuple(dims.values())
        chunks = (min(self._tile[0], whole[0]), min(self._tile[1], whole[1]), *whole[2:])
        fill = np.nan if spec.dtype.startswith("f") else None
        dataset = hdf5.add_variable(
            self._root,
            spec.name,
            dims=dims,
            dtype=spec.dtype,
            units=spec.units,
            long_name=spec.long_name,
            chunks=chunks,
            fill=fill,
        )
        if spec.name == "status":
            dataset.attrs["flag_values"] = np.array([int(s) for s in Status], dtype=spec.dtype)
            dataset.attrs["flag_meanings"] = " ".join(status_name(s) for s in Status)
        if spec.name == "mixing":
            dataset.attrs["flag_values"] = np.array([int(s) for s in Mixing], dtype=spec.dtype)
            dataset.attrs["flag_meanings"] = " ".join(mixing_name(s) for s in Mixing)
        if spec.name == SUSPECT.name:
            dataset.attrs["flag_masks"] = np.array([s.flag for s in SUSPICIONS], dtype=spec.dtype)
            dataset.attrs["flag_meanings"] = " ".join(s.name for s in SUSPICIONS)

    def _add_windows(self) -> None:
        plan = self._windows
        starts = np.arange(plan.count, dtype=np.uint64) * np.uint64(plan.stride)
        for name, values, text in (
            ("window_start", starts, "first frame of the window"),
            ("window_stop", starts + np.uint64(plan.length), "one past the last frame of the window"),
        ):
            hdf5.add_variable(
                self._root, name, dims={"window": plan.count}, dtype="u8", units="1", long_name=text, data=values
            )

    def _add_law(self) -> None:
        for (name, text), dtype in zip(LAW_TEXTS.items(), ("f4", "u4"), strict=True):
            empty = np.full(self._windows.count, np.nan if dtype == "f4" else 0, dtype=dtype)
            hdf5.add_variable(
                self._root,
                name,
                dims={"window": self._windows.count},
                dtype=dtype,
                units="1",
                long_name=text,
                data=empty,
            )

    def write_law(self, window: int, phasor_share: float, pixels: int) -> None:
        """Write the mixing of a window: share of phasor sums, and the pixels that determine it."""
        self._root["phasor_share"][window] = phasor_share
        self._root["phasor_pixels"][window] = pixels
        self._file.check()

    def write_suspects(self, windows: slice, suspect: NDArray[np.uint8], frames: NDArray[np.uint32] | None) -> None:
        """Write marks of windows (window, row, col, layer), and the frames of passing layers; files without have none.

        Raises
        ------
        StorageError
            If the disk is full or fails.
        """
        for spec, values in ((SUSPECT, suspect), (SUSPECT_FRAMES, frames)):
            if values is not None:
                if spec.name not in self._root:
                    self._add(spec)
                self._root[spec.name][windows] = values
        self._file.check()

    def write(self, windows: slice, rows: slice, layers: Layers) -> None:
        """Write layers of the leading shape (window, row, col).

        Raises
        ------
        StorageError
            If the disk is full or fails.
        """
        for spec in layers.fields:
            self._root[spec.name][windows, rows] = getattr(layers, spec.name)
        self._file.check()

    def write_chunks(self, windows: slice, rows: slice, chunks: tuple[bytes, ...]) -> None:
        """Write the chunks of one tile, as `tofmix.io.layers.chunks.encode_cell` makes them.

        Raises
        ------
        StorageError
            If the disk is full or fails.
        """
        fields = self._provenance.fields
        for spec, data in zip(fields, chunks[: len(fields)], strict=True):
            place = (windows.start, rows.start, 0, 0)[: 4 if spec.per_layer else 3]
            self._root[spec.name].id.write_direct_chunk(place, data)
        self._file.check()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)


class LayersFile:
    """An open layers file; made by `open_layers`."""

    def __init__(self, root: h5py.File, path: Path) -> None:
        self.path = path
        present = (*LAYER_FIELDS, *(spec for spec in OPTIONAL_FIELDS if spec.name in root))
        self._datasets = {
            spec.name: typed_dataset(root, spec.name, path, dtype=spec.dtype, dims=spec.dims) for spec in present
        }
        shape = self._datasets["range"].shape
        self.shape: tuple[int, int, int] = shape[:3]
        self.max_layers = int(shape[3])
        if max(shape[1:3]) > MOST_PIXELS_A_SIDE or shape[0] > MOST_FRAMES or shape[3] > MAX_LAYERS_LIMIT:
            raise BadInputError(
                f"{path}: range: shape {shape}; no more than {MOST_FRAMES} windows of {MOST_PIXELS_A_SIDE} pixels"
                f" a side and {MAX_LAYERS_LIMIT} layers"
            )
        if 0 in shape:
            raise BadInputError(f"{path}: range: shape {shape} holds no layer")
        for name, dataset in self._datasets.items():
            if dataset.shape != (*shape, 2)[: dataset.ndim]:
                raise BadInputError(f"{path}: {name}: shape {dataset.shape} does not match range {shape}")
        self.window_start = _window_bounds(root, "window_start", shape[0], path)
        self.window_stop = _window_bounds(root, "window_stop", shape[0], path)
        self.provenance = read_provenance(root, path)
        self.phasor_share = _law(root, "phasor_share", shape[0], path)
        self.phasor_pixels = _law(root, "phasor_pixels", shape[0], path)
        sensor_group.check_maps(self.provenance.sensor, self.shape[1:], path)

    def read_window(self, window: int) -> Layers:
        """Read the layers of one window, of the leading shape (row, col).

        Raises
        ------
        BadInputError
            If they cannot be read, for example because the file is damaged.
        """
        arrays: dict[str, Any] = {}
        for name, dataset in self._datasets.items():
            with guard.reading(self.path, name):
                arrays[name] = dataset[window]
        return Layers(**arrays)

    @property
    def mixing_law(self) -> MixingLaw | None:
        """The law of mixing over all windows; None where it was not measured."""
        return law_over_windows(self.phasor_share, self.phasor_pixels)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the datasets of the layers, in their order."""
        return tuple(self._datasets)

    @property
    def step(self) -> tuple[int, int]:
        """Windows and rows of a stored chunk."""
        chunks = self._datasets["range"].chunks
        return (int(chunks[0]), int(chunks[1])) if chunks else (1, 1)

    def read_block(self, windows: slice, rows: slice) -> Layers:
        """Read the layers of some windows and rows, of the leading shape (window, row, col).

        Raises
        ------
        BadInputError
            If they cannot be read.
        """
        arrays: dict[str, Any] = {name: self.read_dataset(name, windows, rows) for name in self._datasets}
        return Layers(**arrays)

    def read_dataset(self, name: str, windows: slice, rows: slice) -> NDArray[Any]:
        """Read one dataset for some windows and rows.

        Raises
        ------
        BadInputError
            If it cannot be read.
        """
        with guard.reading(self.path, name):
            return np.asarray(self._datasets[name][windows, rows])

    def read_field(self, name: str, window: int) -> NDArray[Any]:
        """Read one dataset for one window, (row, col) or (row, col, layer).

        Raises
        ------
        BadInputError
            If it cannot be read.
        """
        with guard.reading(self.path, name):
            return np.asarray(self._datasets[name][window])

    def tally(self) -> tuple[int, ...]:
        """Pixels by their number of surfaces, each window counted."""
        counts = np.zeros(self.max_layers + 1, dtype=np.int64)
        for window in range(self.shape[0]):
            with guard.reading(self.path, "n_modes"):
                counts += np.bincount(self._datasets["n_modes"][window].ravel(), minlength=len(counts))
        return tuple(counts.tolist())

    def undecided_tally(self) -> tuple[int, ...]:
        """The undecided pixels of `tally`."""
        counts = np.zeros(self.max_layers + 1, dtype=np.int64)
        if "mixing" in self.names:
            for window in range(self.shape[0]):
                undecided = self.read_field("mixing", window) == int(Mixing.UNDECIDED)
                counts += np.bincount(self.read_field("n_modes", window)[undecided], minlength=len(counts))
        return tuple(counts.tolist())

    def suspects(self, window: int) -> int:
        """Suspect layers of a window."""
        return int(np.count_nonzero(self.read_field(SUSPECT.name, window))) if SUSPECT.name in self.names else 0

    def header_image(self) -> bytes:
        """`header_image` of a run that would write this file."""
        starts, stops, step = self.window_start, self.window_stop, self._datasets["range"].chunks
        length, stride = int(stops[0] - starts[0]), int(starts[1]) if len(starts) > 1 else 0
        stride = stride or int(self.provenance.options.get("stride", length))
        plan = Windows(length, stride, len(starts), self.provenance.frames_left_out)
        plan = plan.of_samples(self.provenance.samples_a_frame)
        return header_image(self.provenance, Grid(plan, self.shape[1:], step[:2] if step else (1, 1)))


@contextmanager
def open_layers(path: Path) -> Iterator[LayersFile]:
    """Open a layers file for reading.

    Raises
    ------
    BadInputError
        If the file is missing, not HDF5 or cut short, or is not a layers file.
    """
    with open_result(path, kind=FORMAT, make=LayersFile) as layers:
        yield layers


def _law(root: h5py.File, name: str, count: int, path: Path) -> NDArray[Any] | None:
    """Law of mixing of each window; None in files without it."""
    if name not in root:
        return None
    dataset = guard.checked_dataset(root, name, path)
    if dataset.shape != (count,) or dataset.dtype.kind not in "fu":
        raise BadInputError(f"{path}: {name}: {dataset.dtype} of shape {dataset.shape}, expected numbers ({count},)")
    with guard.reading(path, name):
        return np.asarray(dataset[...])


def _window_bounds(root: h5py.File, name: str, count: int, path: Path) -> NDArray[np.uint64]:
    dataset = guard.checked_dataset(root, name, path)
    if dataset.shape != (count,):
        raise BadInputError(f"{path}: {name}: shape {dataset.shape}, expected ({count},)")
    with guard.reading(path, name):
        return np.asarray(dataset[...], dtype=np.uint64)
