"""Layers files (`*.layers.h5`): written by `estimate`, read by `report`.

The datasets are those of `tofmix.layers.layer_fields`. The same layers and the same provenance give the same bytes, for
any blocks of writing.

`write_provenance` and its readers are for the source and options of layers and surfaces: root attributes of their files
and of a journal.
"""

import json
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.flags import Mixing, MixingLaw, Status, law_over_windows, mixing_name, status_name
from tofmix.grid import Grid, Windows
from tofmix.io import hdf5, sensor_group
from tofmix.io.guard import guard
from tofmix.io.hdf5 import ResultFile, open_result
from tofmix.io.schema import LAW_FIELDS, LAYERS, WINDOW_FIELDS, Field, field_of
from tofmix.layers import (
    ENDS,
    LAYER_DIMS,
    LAYER_FIELDS,
    OPTIONAL_FIELDS,
    SUSPECT,
    SUSPECT_FRAMES,
    LayerField,
    Layers,
    Provenance,
)
from tofmix.recording import MOST_TARGETS
from tofmix.surfaces.found import SurfacesProvenance
from tofmix.suspicion import SUSPICIONS
from tofmix.wording import readable

_CHECKSUM = "provenance_crc32"


def header_image(provenance: Provenance, grid: Grid) -> bytes:
    """The header of a layers file, before its first value, as a small file; equal for equal runs."""

    def write(root: h5py.File) -> None:
        write_provenance(root, provenance)
        sensor_group.write_sensor(root, provenance.sensor, image=grid.image)
        plan = grid.windows
        root.attrs["windows"] = [plan.length, plan.stride, plan.count, plan.frames_left_out]
        root.attrs["image"], root.attrs["step"] = grid.image, grid.step

    return hdf5.image_of(write)


def read_header_image(image: bytes, path: Path) -> tuple[Provenance, Grid]:
    """Read the result of `header_image`; `path` is the file that holds it."""
    with guard.open_image(image, path) as root:
        windows, rows_cols, step = (root.attrs[key].tolist() for key in ("windows", "image", "step"))
        grid = Grid(Windows(*windows), (rows_cols[0], rows_cols[1]), (step[0], step[1]))
        return read_provenance(root, path), grid


def write_provenance(root: h5py.File, provenance: Provenance | SurfacesProvenance) -> None:
    """Write it as root attributes, with a checksum; the sensor is written elsewhere."""
    root.attrs["source"] = readable(provenance.source)
    root.attrs["source_sha256"] = provenance.source_sha256
    root.attrs["tofmix_version"] = provenance.version
    root.attrs["options"] = json.dumps(provenance.options, sort_keys=True)
    if isinstance(provenance, Provenance):
        root.attrs["frames_left_out"] = provenance.frames_left_out
        if provenance.targets:
            root.attrs["targets"] = provenance.targets
        if provenance.has_amplitude:
            root.attrs["has_amplitude"] = np.uint8(1)
    root.attrs[_CHECKSUM] = np.uint32(_checksum(root))


def _checksum(root: h5py.File) -> int:
    """CRC-32 of the provenance's texts: HDF5 stores texts where no checksum is over them, but numbers under one."""
    texts = [hdf5.text_attribute(root, key) for key in ("source", "source_sha256", "tofmix_version", "options")]
    return zlib.crc32("\n".join(text or "" for text in texts).encode("utf-8", "replace"))


def read_provenance(root: h5py.File, path: Path) -> Provenance:
    """Read it from an open file."""
    return Provenance(
        **_texts(root, path),
        sensor=sensor_group.read_sensor(root, path),
        frames_left_out=int(root.attrs.get("frames_left_out", 0)),
        targets=_targets(root, path),
        has_amplitude="has_amplitude" in root.attrs,
    )


def read_surfaces_provenance(root: h5py.File, path: Path) -> SurfacesProvenance:
    """Read the source and options of surfaces."""
    return SurfacesProvenance(**_texts(root, path), sensor=sensor_group.read_sensor(root, path))


def _texts(root: h5py.File, path: Path) -> dict[str, Any]:
    """Source, its checksum, version and options, compared with their checksum."""
    if _CHECKSUM in root.attrs and int(root.attrs[_CHECKSUM]) != _checksum(root):
        raise BadInputError(f"{path}: attribute options or source is damaged: their checksum differs")
    try:
        options = json.loads(hdf5.text_attribute(root, "options") or "{}")
    except ValueError as error:
        raise BadInputError(f"{path}: attribute options: not JSON ({error})") from error
    if not isinstance(options, dict):
        raise BadInputError(f"{path}: attribute options: expected an object")
    return {
        "source": hdf5.text_attribute(root, "source") or "unknown",
        "source_sha256": hdf5.text_attribute(root, "source_sha256") or "unknown",
        "version": hdf5.text_attribute(root, "tofmix_version") or "unknown",
        "options": options,
    }


def _targets(root: h5py.File, path: Path) -> int:
    value = np.asarray(root.attrs.get("targets", 0))
    if value.size != 1 or value.dtype.kind not in "iu" or not 0 <= int(value.reshape(-1)[0]) <= MOST_TARGETS:
        raise BadInputError(f"{path}: attribute targets: expected a whole number up to {MOST_TARGETS}")
    return int(value.reshape(-1)[0])


FORMAT = LAYERS

_FLAGS: dict[str, dict[str, tuple[list[int], list[str]]]] = {
    "status": {"flag_values": ([int(s) for s in Status], [status_name(s) for s in Status])},
    "mixing": {"flag_values": ([int(s) for s in Mixing], [mixing_name(s) for s in Mixing])},
    SUSPECT.name: {"flag_masks": ([s.flag for s in SUSPICIONS], [s.name for s in SUSPICIONS])},
}
"""CF's attributes of datasets of flags: values or masks, and their names."""


class LayersWriter(hdf5.FileWriter):
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
        As for `AtomicFile`, also for its errors.
    """

    kind = LAYERS

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
        super().__init__(
            path,
            title=f"surfaces of {provenance.source}",
            history=f"tofmix {provenance.version} estimate {provenance.source}",
            overwrite=overwrite,
            inputs=inputs,
            temporary=temporary,
        )
        self._windows = windows
        self._dims = dict(zip(LAYER_DIMS, (windows.count, *image, max_layers), strict=True))
        self._tile = tile
        self._provenance = provenance

    def _begin(self, root: h5py.File) -> None:
        write_provenance(root, self._provenance)
        for name, length in self._dims.items():
            hdf5.add_scale(root, name, length)
        for spec in self._provenance.fields:
            self._add(spec)
        plan = self._windows
        starts = np.arange(plan.count, dtype=np.uint64) * np.uint64(plan.stride)
        for field, values in zip(WINDOW_FIELDS, (starts, starts + np.uint64(plan.length)), strict=True):
            hdf5.add_field(root, field, data=values)
        for field in LAW_FIELDS if self._provenance.is_unmixed else ():
            empty = np.nan if field.dtype == "f4" else 0
            hdf5.add_field(root, field, data=np.full(plan.count, empty, dtype=field.dtype))
        sensor_group.write_sensor(root, self._provenance.sensor, image=(self._dims["row"], self._dims["col"]))
        hdf5.add_nexus_view(root, name="layers", signal="range", axes=LAYER_DIMS)

    def _add(self, spec: LayerField) -> None:
        if spec.ends and ENDS not in self._root:
            hdf5.add_scale(self._root, ENDS, 2)
        lengths = self._dims | {ENDS: 2}
        whole = tuple(lengths[name] for name in spec.dims)
        chunks = (min(self._tile[0], whole[0]), min(self._tile[1], whole[1]), *whole[2:])
        dataset = hdf5.add_field(self._root, field_of(spec), lengths, chunks=chunks)
        for key, (values, names) in _FLAGS.get(spec.name, {}).items():
            dataset.attrs[key] = np.array(values, dtype=spec.dtype)
            dataset.attrs["flag_meanings"] = " ".join(names)

    def write_law(self, window: int, phasor_share: float, pixels: int) -> None:
        """Write the mixing of a window: share of phasor sums, and the pixels that determine it."""
        self._root["phasor_share"][window] = phasor_share
        self._root["phasor_pixels"][window] = pixels
        self._file.check()

    def write_suspects(self, windows: slice, suspect: NDArray[np.uint8], frames: NDArray[np.uint32] | None) -> None:
        """Write marks of windows (window, row, col, layer), and the frames of passing layers if there are any."""
        for spec, values in ((SUSPECT, suspect), (SUSPECT_FRAMES, frames)):
            if values is not None:
                if spec.name not in self._root:
                    self._add(spec)
                self._root[spec.name][windows] = values
        self._file.check()

    def write(self, windows: slice, rows: slice, layers: Layers) -> None:
        """Write layers of the leading shape (window, row, col)."""
        for spec in layers.fields:
            self._root[spec.name][windows, rows] = getattr(layers, spec.name)
        self._file.check()

    def write_chunks(self, windows: slice, rows: slice, chunks: tuple[bytes, ...]) -> None:
        """Write the chunks of one tile, as `tofmix.io.layers.chunks.encode_cell` makes them."""
        fields = self._provenance.fields
        for spec, data in zip(fields, chunks[: len(fields)], strict=True):
            place = (windows.start, rows.start, 0, 0)[: 4 if spec.per_layer else 3]
            self._root[spec.name].id.write_direct_chunk(place, data)
        self._file.check()


class LayersFile(ResultFile):
    """An open layers file; made by `open_layers`."""

    def __init__(self, root: h5py.File, path: Path) -> None:
        present = (*LAYER_FIELDS, *(spec for spec in OPTIONAL_FIELDS if spec.name in root))
        super().__init__(root, path, map(field_of, present), "range")
        self._check_lengths({ENDS: 2})
        self.window_start, self.window_stop = (
            self._of_windows(root, field).astype(np.uint64, copy=False) for field in WINDOW_FIELDS
        )
        self.provenance = read_provenance(root, path)
        self.phasor_share, self.phasor_pixels = (
            self._of_windows(root, field) if field.name in root else None for field in LAW_FIELDS
        )
        sensor_group.check_maps(self.provenance.sensor, self.shape[1:], path)

    def _of_windows(self, root: h5py.File, field: Field) -> NDArray[Any]:
        """Numbers of each window, of any type."""
        name, expected = field.name, self.shape[:1]
        dataset = guard.checked_dataset(root, name, self.path)
        if dataset.shape != expected or dataset.dtype.kind not in "iuf":
            raise BadInputError(
                f"{self.path}: {name}: shape {dataset.shape} of {dataset.dtype}, expected numbers {expected}"
            )
        with guard.reading(self.path, name):
            return np.asarray(dataset[...])

    def read_window(self, window: int) -> Layers:
        """Read the layers of one window, of the leading shape (row, col)."""
        return Layers(**{name: self.read_dataset(name, window) for name in self.names})

    @property
    def mixing_law(self) -> MixingLaw | None:
        """The law of mixing over all windows; None where it was not measured."""
        return law_over_windows(self.phasor_share, self.phasor_pixels)

    @property
    def step(self) -> tuple[int, int]:
        """Windows and rows of a stored chunk."""
        chunks = self._datasets["range"].chunks
        return (int(chunks[0]), int(chunks[1])) if chunks else (1, 1)

    def read_block(self, windows: slice, rows: slice) -> Layers:
        """Read the layers of some windows and rows, of the leading shape (window, row, col)."""
        return Layers(**{name: self.read_dataset(name, windows, rows) for name in self.names})

    def read_field(self, name: str, window: int) -> NDArray[Any]:
        """Read one dataset for one window, (row, col) or (row, col, layer)."""
        return self.read_dataset(name, window)

    def tally(self) -> tuple[int, ...]:
        """Pixels by their number of surfaces, each window counted."""
        counts = np.zeros(self.max_layers + 1, dtype=np.int64)
        for window in range(self.shape[0]):
            counts += np.bincount(self.read_field("n_modes", window).ravel(), minlength=len(counts))
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
