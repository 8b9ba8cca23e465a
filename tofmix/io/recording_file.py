"""Recordings (`*.h5`): reading any that fits the contract, writing ours.

Use `open_recording` for samples in blocks and `RecordingWriter` to stream frames
into a new file. The contract is docs/formats.md.
"""

import hashlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix import __version__
from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.errors import BadInputError, os_error_text
from tofmix.io import hdf5
from tofmix.io.storage import AtomicFile
from tofmix.io.truth_effects import add_effect_truth, add_range_true_frames, write_range_true_frames
from tofmix.recording import DECODED_SAMPLES
from tofmix.sensor import Sensor
from tofmix.simulation.effects import EffectTruth
from tofmix.simulation.truth import Truth

FORMAT = "tofmix-recording"
CHUNK_FRAMES = 100
"""Frames stored together; also what `simulate` holds in memory at once."""

_CHUNK_ROWS = 8
_CHUNK_COLS = 22
_NO_SAMPLE = 0
_DIMS = ("frame", "row", "col")


class RecordingFile:
    """An open recording. It is a `tofmix.recording.SampleSource`.

    Made by `open_recording`; reads are in blocks, nothing is kept.
    """

    def __init__(self, root: h5py.File, path: Path) -> None:
        self._root, self.path = root, path
        self.sensor: Sensor = hdf5.read_sensor(root, path)
        self._range = _samples(root, "range", path)
        frames, rows, cols = self._range.shape
        self.shape: tuple[int, int, int] = (frames, rows, cols)
        self._amplitude = _samples(root, "amplitude", path) if "amplitude" in root else None
        try:
            self._fill = hdf5.fill_value(self._range)
            self._no_amplitude = None if self._amplitude is None else hdf5.fill_value(self._amplitude)
        except BadInputError as error:
            raise BadInputError(f"{path}: {error}") from error
        if self._amplitude is not None and self._amplitude.shape != self.shape:
            raise BadInputError(f"{path}: amplitude: shape {self._amplitude.shape} differs from range {self.shape}")

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
        """What stands for no sample beside NaN: `_FillValue`; without one 0 for integers, None for floats."""
        if self._fill is not None:
            return float(self._fill[0])
        return None if self._range.dtype.kind == "f" else 0.0

    def attributes(self) -> dict[str, str | int | float]:
        """Root attributes that are one text or one number."""
        found: dict[str, str | int | float] = {}
        with hdf5.reading(self.path, "attributes"):
            for key in sorted(self._root.attrs):
                value = np.asarray(self._root.attrs[key]).reshape(-1)
                text = hdf5.text_attribute(self._root, key)
                if text is not None:
                    found[key] = text
                elif value.size == 1 and value.dtype.kind in "iuf":
                    found[key] = value[0].item()
        return found

    def read_time(self) -> FloatArray | None:
        """Read the start of each frame (frame,) float64 in s; None where the recording does not say.

        Raises
        ------
        BadInputError
            If it is not one number a frame.
        """
        return self._by_frame("time")

    def read_temperature(self) -> FloatArray | None:
        """Read the camera's temperature (frame,) float64 in degC; None where the recording does not say.

        Raises
        ------
        BadInputError
            If it is not one number a frame.
        """
        return self._by_frame("temperature")

    def _by_frame(self, name: str) -> FloatArray | None:
        if name not in self._root:
            return None
        dataset = hdf5.checked_dataset(self._root, name, self.path)
        if dataset.shape != self.shape[:1] or dataset.dtype.kind not in "iuf":
            raise BadInputError(
                f"{self.path}: {name}: expected one number a frame, got {dataset.dtype} of shape {dataset.shape}"
            )
        with hdf5.reading(self.path, name):
            return np.asarray(dataset[...], dtype=np.float64)

    @property
    def row_step(self) -> int:
        """Rows of a stored chunk, so that no chunk is unpacked twice."""
        return int(self._range.chunks[1]) if self._range.chunks else 1

    @property
    def frame_step(self) -> int:
        """Frames of a stored chunk, likewise."""
        return int(self._range.chunks[0]) if self._range.chunks else 1

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Read samples (frame, row, col) float32 in mm, NaN where invalid.

        Raises
        ------
        BadInputError
            If the block cannot be read, for example because it is damaged.
        """
        first_frame, end, _ = frames.indices(self.shape[0])
        first_row, bottom, _ = rows.indices(self.shape[1])
        samples = np.empty((end - first_frame, bottom - first_row, self.shape[2]), dtype=np.float32)
        high = DECODED_SAMPLES // (self.shape[2] * self.frame_step)
        for row_part in _whole_chunks(first_row, bottom, self.row_step, high):
            deep = DECODED_SAMPLES // (self.shape[2] * (row_part.stop - row_part.start))
            for part in _whole_chunks(first_frame, end, self.frame_step, deep):
                with hdf5.reading(self.path, "range"):
                    raw = self._range[part, row_part]
                out = samples[part.start - first_frame : part.stop - first_frame, row_part.start - first_row :]
                self._decode(raw, out[:, : row_part.stop - row_part.start])
        return samples

    def _decode(self, raw: NDArray[np.generic], out: Float32Array) -> None:
        with np.errstate(over="ignore"):  # beyond float32 is beyond any range: infinite, and invalid
            out[...] = raw
        invalid = _invalid(raw, self._fill)
        if raw.dtype.kind == "f":
            invalid |= ~np.isfinite(out)
        out[invalid] = np.nan

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Read amplitudes (frame, row, col) float32, NaN where they have their `_FillValue`.

        Raises
        ------
        BadInputError
            If there are none, or the block cannot be read.
        """
        if self._amplitude is None:
            raise BadInputError(f"{self.path}: no dataset amplitude")
        with hdf5.reading(self.path, "amplitude"):
            raw = self._amplitude[frames, rows]
        with np.errstate(over="ignore"):
            amplitude: Float32Array = raw.astype(np.float32)
        if self._no_amplitude is not None:
            amplitude[raw == self._no_amplitude] = np.nan
        return amplitude


@contextmanager
def open_recording(path: Path) -> Iterator[RecordingFile]:
    """Open a recording for reading.

    Raises
    ------
    BadInputError
        If the file is missing, not HDF5 or cut short, is no recording, or does not fit the contract.
    """
    with hdf5.open_for_reading(path) as root:
        with hdf5.reading(path, "header"):
            hdf5.check_format(root, path, kind=FORMAT, required=False)
            recording = RecordingFile(root, path)
        yield recording


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal.

    Raises
    ------
    BadInputError
        If it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise BadInputError(os_error_text(error, path)) from error


def _whole_chunks(start: int, stop: int, step: int, wanted: int) -> Iterator[slice]:
    """Cut [start, stop) at multiples of the stored step into parts of about `wanted`, and of one step at least."""
    size = step * max(1, wanted // step)
    while start < stop:
        end = min(start - start % step + size, stop)
        yield slice(start, end)
        start = end


def _samples(root: h5py.File, name: str, path: Path) -> h5py.Dataset:
    dataset = hdf5.checked_dataset(root, name, path)
    if dataset.ndim != len(_DIMS):
        raise BadInputError(f"{path}: {name}: expected (frame, row, col), got shape {dataset.shape}")
    if 0 in dataset.shape:
        raise BadInputError(f"{path}: {name}: shape {dataset.shape} holds no sample")
    if dataset.dtype.kind not in "iuf":
        raise BadInputError(f"{path}: {name}: expected integers or floats, got {dataset.dtype}")
    units = hdf5.text_attribute(dataset, "units")
    if name == "range" and units not in (None, "mm", "millimeter", "millimetre"):
        raise BadInputError(f"{path}: range: units {units!r}, expected 'mm'")
    return dataset


def _invalid(raw: NDArray[np.generic], fill: NDArray[np.generic] | None) -> BoolArray:
    """Which values are no samples: `_FillValue`, NaN and infinities; without it, an integer 0."""
    if raw.dtype.kind == "f":
        invalid: BoolArray = ~np.isfinite(raw)
        return invalid if fill is None else invalid | (raw == fill)
    return np.asarray(raw == (0 if fill is None else fill), dtype=np.bool_)


class RecordingWriter:
    """Streams frames into a new recording, which gets its name when the last one is in.

    Use it as a context manager; write every frame, in order, in blocks of `chunk_frames`.

    Parameters
    ----------
    path : Path
        The new file.
    shape : (int, int, int)
        Frames, rows, columns.
    sensor : Sensor
        The camera, with the noise curve at this recording's integration time.
    truth : Truth, optional
        Ground truth of a synthetic recording.
    model_text : str
        Text of the model file that a synthetic recording is made from; goes with `truth`.
    effect_truth : tuple of EffectTruth
        What effects drew for this recording; goes with `truth`.
    moving : bool
        Whether true ranges will be written frame by frame; goes with `truth`.
    title : str
        The file's title.
    has_amplitude, has_time, has_temperature : bool
        Whether amplitudes, times and temperatures will be written.
    dtype : {"u2", "f4"}
        Type of the ranges: whole mm with 0 for no sample, or float32 with NaN.
    chunk_frames : int
        Frames that are stored, and best written, together.
    attributes : dict, optional
        Further root attributes.
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
        sensor: Sensor,
        truth: Truth | None = None,
        model_text: str = "",
        effect_truth: tuple[EffectTruth, ...] = (),
        moving: bool = False,
        title: str = "time-of-flight recording",
        has_amplitude: bool = True,
        has_time: bool = True,
        has_temperature: bool = False,
        dtype: Literal["u2", "f4"] = "u2",
        chunk_frames: int = CHUNK_FRAMES,
        attributes: dict[str, str | int | float] | None = None,
        overwrite: bool = False,
        inputs: tuple[Path, ...] = (),
    ) -> None:
        self._shape = shape
        self._sensor = sensor
        self._truth = truth
        self._model_text = model_text
        self._effect_truth = effect_truth
        self._moving = moving
        self._title = title
        self._has_amplitude = has_amplitude
        self._has_time = has_time
        self._has_temperature = has_temperature
        self._dtype = dtype
        self._chunk_frames = chunk_frames
        self._attributes = attributes or {}
        self._file = AtomicFile(path, overwrite=overwrite, inputs=inputs)

    def __enter__(self) -> Self:
        history = f"written by tofmix {__version__}"
        with ExitStack() as stack:  # undone if anything below fails
            stack.enter_context(self._file)
            root = stack.enter_context(hdf5.create(self._file, kind=FORMAT, title=self._title, history=history))
            root.attrs.update(self._attributes)
            self._root = root
            self._add_frames(root)
            hdf5.write_sensor(root, self._sensor)
            if self._truth is not None:
                _write_truth(root, self._truth, self._model_text)
                self._add_more_truth(root["truth"], self._truth)
            hdf5.add_nexus_view(root, name="recording", signal="range", axes=_DIMS)
            self._stack = stack.pop_all()
        return self

    def _add_more_truth(self, group: h5py.Group, truth: Truth) -> None:
        if self._effect_truth:
            add_effect_truth(group, self._effect_truth, CHUNK_FRAMES)
        if self._moving:
            frames, rows, cols = self._shape
            layers = truth.range_true.shape[2]
            chunks = (min(frames, CHUNK_FRAMES), min(rows, _CHUNK_ROWS), min(cols, _CHUNK_COLS), layers)
            add_range_true_frames(group, (*self._shape, layers), chunks)

    def _add_frames(self, root: h5py.File) -> None:
        frames, rows, cols = self._shape
        dims = dict(zip(_DIMS, self._shape, strict=True))
        for name, length in dims.items():
            hdf5.add_scale(root, name, length)
        chunks = (min(frames, self._chunk_frames), min(rows, _CHUNK_ROWS), min(cols, _CHUNK_COLS))
        fill = _NO_SAMPLE if self._dtype == "u2" else np.nan
        hdf5.add_variable(
            root, "range", dims=dims, dtype=self._dtype, units="mm", long_name="radial range", chunks=chunks, fill=fill
        )
        if self._has_amplitude:
            hdf5.add_variable(root, "amplitude", dims=dims, dtype="f4", units="1", long_name="amplitude", chunks=chunks)
        frame = {"frame": frames}
        if self._has_time:
            hdf5.add_variable(root, "time", dims=frame, dtype="f8", units="s", long_name="start of the frame")
        if self._has_temperature:
            hdf5.add_variable(root, "temperature", dims=frame, dtype="f4", units="degC", long_name="temperature")

    def write(
        self,
        start: int,
        range_mm: NDArray[np.uint16] | Float32Array,
        *,
        time_s: FloatArray | None = None,
        amplitude: Float32Array | None = None,
        temperature_c: Float32Array | None = None,
        range_true: Float32Array | None = None,
    ) -> None:
        """Write frames [start, start + n).

        range_mm (n, row, col) uint16, 0 where invalid, or float32, NaN where invalid;
        amplitude (n, row, col); time_s and temperature_c (n,); range_true (n, row, col, layer), where surfaces move.

        Raises
        ------
        StorageError
            If the disk is full or fails.
        """
        stop = start + len(range_mm)
        self._root["range"][start:stop] = range_mm
        if time_s is not None:
            self._root["time"][start:stop] = time_s
        if amplitude is not None:
            self._root["amplitude"][start:stop] = amplitude
        if temperature_c is not None:
            self._root["temperature"][start:stop] = temperature_c
        if range_true is not None:
            write_range_true_frames(self._root["truth"], start, range_true)
        self._file.check()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)


def _write_truth(root: h5py.File, truth: Truth, model_text: str) -> None:
    group = hdf5.add_group(root, "truth")
    group.attrs["model"] = model_text
    rows, cols, layers = truth.range_true.shape
    hdf5.add_scale(group, "layer", layers)
    image = {"row": rows, "col": cols}
    layered = {**image, "layer": layers}
    hdf5.add_variable(
        group, "n_modes", dims=image, dtype="u1", units="1", long_name="surfaces in the beam", data=truth.n_modes
    )
    hdf5.add_variable(
        group, "range_true", dims=layered, dtype="f4", units="mm", long_name="range of each surface, near to far",
        fill=np.nan, data=truth.range_true,
    )  # fmt: skip
    hdf5.add_variable(
        group, "weight_true", dims=layered, dtype="f4", units="1", long_name="share of the beam, p(c_i)",
        fill=np.nan, data=truth.weight_true,
    )  # fmt: skip
    hdf5.add_variable(
        group, "weight_no_return", dims=image, dtype="f4", units="1", long_name="share without a return, p(c_0)",
        data=truth.weight_no_return,
    )  # fmt: skip
