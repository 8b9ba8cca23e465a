"""Source and options of layers and surfaces in their files and in a journal: root attributes of HDF5."""

import json
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tofmix.errors import BadInputError
from tofmix.grid import Grid
from tofmix.io import hdf5, sensor_group
from tofmix.io.guard import guard
from tofmix.layers import Provenance
from tofmix.recording import MOST_TARGETS
from tofmix.surfaces.found import SurfacesProvenance
from tofmix.windows import Windows
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
