"""Recordings (`*.h5`): reading any that fits the contract, in blocks.

Use `open_recording`. The contract is docs/reference/formats.md; `tofmix.io.recording.recording_writer` writes ours.
"""

import hashlib
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from typing import Self

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.errors import BadInputError, os_error_text
from tofmix.io import hdf5, sensor_group
from tofmix.io.guard import guard
from tofmix.io.guard.watchdog import watched
from tofmix.io.next_command import import_command
from tofmix.io.recording.range_check import UNITS_MM, check_range, unit_mm_of
from tofmix.io.schema import FRAME_DIMS, RECORDING, TARGET
from tofmix.recording import DECODED_SAMPLES, MOST_FRAMES, MOST_PIXELS_A_SIDE, MOST_TARGETS
from tofmix.sensor import Sensor

FORMAT, DIMS = RECORDING, FRAME_DIMS

_HASHED_BYTES = 1 << 20  # bytes that are hashed at once

_MM = ("mm", "millimeter", "millimetre", "millimeters", "millimetres")


class RecordingFile:
    """An open recording, a `tofmix.recording.CameraSource`.

    Made by `open_recording`; reads are in blocks, nothing is kept. `units` is the attribute of `range`; `remarks` are
    lines for the user. Where pixels return several targets, the targets of a frame are samples that
    follow each other: `shape`, `frame_step` and blocks count samples, not frames.
    """

    def __init__(self, root: h5py.File, path: Path, name: str = "") -> None:
        self._root, self.path, self.name = root, path, name or str(path)
        self._identity = guard.identity(root)
        self.verified = False
        self._sensor = sensor_group.read_sensor(root, path)
        self._range = _samples(root, "range", path)
        self.units = hdf5.text_attribute(self._range, "units")
        self.remarks: tuple[str, ...] = ()
        self.frames = int(self._range.shape[0])
        self.targets = int(self._range.shape[1]) if self._range.ndim > len(DIMS) else 0
        rows, cols = self._range.shape[-2:]
        sensor_group.check_maps(self.sensor, (rows, cols), path)
        self.shape: tuple[int, int, int] = (self.frames * max(1, self.targets), rows, cols)
        self._amplitude = _samples(root, "amplitude", path) if "amplitude" in root else None
        try:
            self._fill = hdf5.fill_value(self._range)
            self._no_amplitude = None if self._amplitude is None else hdf5.fill_value(self._amplitude)
        except BadInputError as error:
            raise BadInputError(f"{path}: {error}") from error
        if self._amplitude is not None and self._amplitude.shape != self._range.shape:
            raise BadInputError(
                f"{path}: amplitude: shape {self._amplitude.shape} differs from range {self._range.shape}"
            )

    @property
    def sensor(self) -> Sensor:
        """The camera: the file's, or that of `with_sensor`."""
        return self._sensor

    def with_sensor(self, sensor: Sensor) -> Self:
        """The same open file with another camera."""
        other = copy(self)
        other._sensor = sensor  # noqa: SLF001  of its own class
        return other

    @property
    def averaged(self) -> bool:
        """Whether the root attribute `averaged` marks the frames as means that the camera made."""
        return self.attributes().get("averaged", 0) not in (0, "0", "")

    def check_unchanged(self) -> None:
        """Refuse the data if the file was written to during reading."""
        guard.check_unchanged(self._root, self._identity, self.path)

    def verify_unchanged(self) -> None:
        """Declare the end of reading: later changes of the file do not matter."""
        self.check_unchanged()
        self.verified = True

    def sha256(self) -> str:
        """SHA-256 of the open file, even if its path now leads to another one."""
        try:
            with os.fdopen(os.dup(self._root.id.get_vfd_handle()), "rb", buffering=0) as file:
                file.seek(0)
                digest = _digest(file, self.path)
        except OSError as error:
            raise BadInputError(os_error_text(error, self.path)) from error
        self.check_unchanged()
        return digest

    @property
    def has_amplitude(self) -> bool:
        """Whether the recording holds amplitudes."""
        return self._amplitude is not None

    @property
    def has_truth(self) -> bool:
        """Whether the recording is synthetic and carries its truth, which `estimate` never reads."""
        return "truth" in self._root

    @property
    def stored_type(self) -> str:
        """Type of the stored ranges, such as ``uint16``."""
        return str(self._range.dtype)

    @property
    def fill(self) -> float | None:
        """Value of invalid samples in addition to NaN: `_FillValue`; without one 0 for integers, None for floats."""
        if self._fill is not None:
            return float(self._fill[0])
        return None if self._range.dtype.kind == "f" else 0.0

    def attributes(self) -> dict[str, str | int | float]:
        """Root attributes that are one text or one number."""
        found: dict[str, str | int | float] = {}
        with guard.reading(self.path, "attributes"):
            for key in sorted(self._root.attrs):
                value = np.asarray(self._root.attrs[key]).reshape(-1)
                text = hdf5.text_attribute(self._root, key)
                if text is not None:
                    found[key] = text
                elif value.size == 1 and value.dtype.kind in "iuf":
                    found[key] = value[0].item()
        return found

    def read_time(self) -> FloatArray | None:
        """Read the start of each frame (frame,) float64 in s; None if unknown."""
        return self._by_frame("time")

    def read_temperature(self) -> FloatArray | None:
        """Read the camera's temperature (frame,) float64 in degC; None if unknown."""
        return self._by_frame("temperature")

    def _by_frame(self, name: str) -> FloatArray | None:
        if name not in self._root:
            return None
        dataset = guard.checked_dataset(self._root, name, self.path)
        if dataset.shape != (self.frames,) or dataset.dtype.kind not in "iuf":
            raise BadInputError(
                f"{self.path}: {name}: expected one number a frame, got {dataset.dtype} of shape {dataset.shape}"
            )
        with guard.reading(self.path, name):
            return np.asarray(dataset[...], dtype=np.float64)

    @property
    def row_step(self) -> int:
        """Rows of a stored chunk, so that no chunk is unpacked twice."""
        return int(self._range.chunks[-2]) if self._range.chunks else 1

    @property
    def frame_step(self) -> int:
        """Samples of a pixel in a stored chunk, or in neighbouring chunks; likewise."""
        return (int(self._range.chunks[0]) if self._range.chunks else 1) * max(1, self.targets)

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Read samples (frame, row, col) float32 in mm, NaN where invalid."""
        first_frame, end, _ = frames.indices(self.shape[0])
        first_row, bottom, _ = rows.indices(self.shape[1])
        samples = np.empty((end - first_frame, bottom - first_row, self.shape[2]), dtype=np.float32)
        high = DECODED_SAMPLES // (self.shape[2] * self.frame_step)
        for row_part in _whole_chunks(first_row, bottom, self.row_step, high):
            deep = DECODED_SAMPLES // (self.shape[2] * (row_part.stop - row_part.start))
            for part in _whole_chunks(first_frame, end, self.frame_step, deep):
                with guard.reading(self.path, "range"):
                    raw = self._block(self._range, part, row_part)
                out = samples[part.start - first_frame : part.stop - first_frame, row_part.start - first_row :]
                self._decode(raw, out[:, : row_part.stop - row_part.start])
        return samples

    def _block(self, dataset: h5py.Dataset, samples: slice, rows: slice) -> NDArray[np.generic]:
        """Stored values (sample, row, col) of some samples and rows."""
        if not self.targets:
            return np.asarray(dataset[samples, rows])
        first = samples.start // self.targets
        raw = np.asarray(dataset[first : -(-samples.stop // self.targets), :, rows])
        flat = raw.reshape(-1, *raw.shape[2:])
        return flat[samples.start - first * self.targets : samples.stop - first * self.targets]

    def _decode(self, raw: NDArray[np.generic], out: Float32Array) -> None:
        with np.errstate(over="ignore"):  # beyond float32 is beyond any range: infinite, and invalid
            out[...] = raw
        invalid = _invalid(raw, self._fill)
        if raw.dtype.kind == "f":
            invalid |= ~np.isfinite(out)
        out[invalid] = np.nan

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Read amplitudes (frame, row, col) float32, NaN where they have their `_FillValue`."""
        if self._amplitude is None:
            raise BadInputError(f"{self.path}: no dataset amplitude")
        first, end, _ = frames.indices(self.shape[0])
        with guard.reading(self.path, "amplitude"):
            raw = self._block(self._amplitude, slice(first, end), rows)
        with np.errstate(over="ignore"):
            amplitude: Float32Array = raw.astype(np.float32)
        if self._no_amplitude is not None:
            amplitude[raw == self._no_amplitude] = np.nan
        return amplitude


@contextmanager
def open_recording(path: Path, *, check_units: bool = True, name: str = "") -> Iterator[RecordingFile]:
    """Open a recording for reading.

    Parameters
    ----------
    path : Path
        The file.
    check_units : bool
        Whether floats without `units` are held against mm (`tofmix.io.recording.range_check`).
    name : str
        In place of the path, for messages about its samples.

    Raises
    ------
    BadInputError
        If the file is missing, not HDF5 or cut short, is no recording, or does not fit the contract; with
        `check_units`, if its ranges are not in mm, as it seems.
    """
    recording: RecordingFile | None = None
    with guard.open_for_reading(path, verified=lambda: recording is not None and recording.verified) as root:
        with guard.reading(path, "header"):
            hdf5.check_format(root, path, kind=FORMAT, required=False)
            recording = RecordingFile(root, path, name)
        if check_units:
            recording.remarks = check_range(recording)
        yield recording


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    try:
        with path.open("rb", buffering=0) as file:
            return _digest(file, path)
    except OSError as error:
        raise BadInputError(os_error_text(error, path)) from error


def _digest(file: io.FileIO, path: Path) -> str:
    """SHA-256 of the rest of a file; each piece has its own time limit, because the whole may take long."""
    digest, piece = hashlib.sha256(), memoryview(bytearray(_HASHED_BYTES))
    while True:
        with watched(str(path)):
            size = file.readinto(piece)
        if not size:
            return digest.hexdigest()
        digest.update(piece[:size])


def _whole_chunks(start: int, stop: int, step: int, wanted: int) -> Iterator[slice]:
    """Divide [start, stop) at multiples of the stored step into parts of about `wanted`, at least one step each."""
    size = step * max(1, wanted // step)
    while start < stop:
        end = min(start - start % step + size, stop)
        yield slice(start, end)
        start = end


def _samples(root: h5py.File, name: str, path: Path) -> h5py.Dataset:
    if name == "range" and name not in root:
        raise BadInputError(f"{path}: no dataset range; import a file of another layout: {import_command(path)}")
    dataset = guard.checked_dataset(root, name, path)
    if dataset.ndim == len(DIMS) + 1:
        _check_targets(dataset, name, path)
    elif dataset.ndim != len(DIMS):
        raise BadInputError(f"{path}: {name}: expected (frame, row, col), got shape {dataset.shape}")
    if 0 in dataset.shape:
        raise BadInputError(f"{path}: {name}: shape {dataset.shape} holds no sample")
    if max(dataset.shape[-2:]) > MOST_PIXELS_A_SIDE or dataset.shape[0] > MOST_FRAMES:
        raise BadInputError(
            f"{path}: {name}: shape {dataset.shape}; no more than {MOST_FRAMES} frames of {MOST_PIXELS_A_SIDE} pixels"
            " a side"
        )
    if dataset.dtype.kind not in "iuf":
        raise BadInputError(f"{path}: {name}: expected integers or floats, got {dataset.dtype}")
    units = hdf5.text_attribute(dataset, "units")
    if name == "range" and units not in (None, *_MM):
        remedy = _conversion(path, units)
        raise BadInputError(f"{path}: range: units {units!r}, expected 'mm'{': ' * bool(remedy)}{remedy}")
    return dataset


def _conversion(path: Path, units: str) -> str:
    """The command that converts from another unit than mm; empty if the unit is not known."""
    unit_mm = unit_mm_of(units)
    if unit_mm is None:
        return ""
    name = next((name for name, mm in UNITS_MM.items() if mm == unit_mm), None)
    return import_command(path, *(("--scale", f"{unit_mm:g}") if name is None else ("--units", name)))


def _check_targets(dataset: h5py.Dataset, name: str, path: Path) -> None:
    """Refuse four axes without the scale `target` on the second one: another order would be read without notice."""
    with guard.reading(path, name):
        scales = [Path(dim[0].name).name if len(dim) else "" for dim in dataset.dims]
    if scales != [DIMS[0], TARGET, *DIMS[1:]]:
        raise BadInputError(
            f"{path}: {name}: got shape {dataset.shape}, four axes without the scales frame, {TARGET}, row,"
            f" col; if this is their order: {import_command(path, '--axes', ','.join((DIMS[0], TARGET, *DIMS[1:])))}"
        )
    if dataset.shape[1] > MOST_TARGETS:
        raise BadInputError(f"{path}: {name}: {dataset.shape[1]} targets; no more than {MOST_TARGETS}")


def _invalid(raw: NDArray[np.generic], fill: NDArray[np.generic] | None) -> BoolArray:
    """Which values are no samples: `_FillValue`, NaN and infinities; without it, an integer 0."""
    if raw.dtype.kind == "f":
        invalid: BoolArray = ~np.isfinite(raw)
        return invalid if fill is None else invalid | (raw == fill)
    return np.asarray(raw == (0 if fill is None else fill), dtype=np.bool_)
