"""Writing of recordings: frames are streamed into a new file, which gets its name after the last frame.

Use `RecordingWriter`; `tofmix.io.recording.recording_file` reads its files. The contract is docs/reference/formats.md.
"""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.io import hdf5, sensor_group
from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.recording.recording_file import DIMS, FORMAT, TARGET
from tofmix.io.recording.truth_effects import add_effect_truth, add_range_true_frames, write_range_true_frames
from tofmix.sensor import Sensor
from tofmix.simulation.effects import EffectTruth
from tofmix.simulation.truth import Truth
from tofmix.version import __version__

CHUNK_FRAMES = 100
"""Frames of a stored chunk; `simulate` holds as many in memory at once."""

_CHUNK_ROWS = 8  # rows of a chunk: a band of rows is read without the rest
_CHUNK_COLS = 22  # columns of a chunk: an eighth of a 176-pixel row
_NO_SAMPLE = 0  # value of a lost sample where ranges are uint16


class RecordingWriter:
    """Streams frames into a new recording, which gets its name after the last frame.

    Use it as a context manager; write every frame, in order, in blocks of `chunk_frames`.

    Parameters
    ----------
    path : Path
        The new file.
    shape : (int, int, int)
        Frames, rows, columns.
    targets : int
        Length of the axis of targets, (frame, target, row, col); 0 for no such axis.
    sensor : Sensor
        The camera, with the noise curve at this recording's integration time.
    truth : Truth, optional
        Ground truth of a synthetic recording.
    model_text : str
        Text of the model file of a synthetic recording; needs `truth`.
    effect_truth : tuple of EffectTruth
        Draws of effects for this recording; need `truth`.
    moving : bool
        Whether true ranges will be written frame by frame; needs `truth`.
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
        targets: int = 0,
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
        self._targets = targets
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
            written = replace(self._sensor, temporal_filter=None)  # it is that of other samples
            sensor_group.write_sensor(root, written, image=self._shape[1:])
            if self._truth is not None:
                _write_truth(root, self._truth, self._model_text)
                self._add_more_truth(root["truth"], self._truth)
            hdf5.add_nexus_view(root, name="recording", signal="range", axes=DIMS)
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
        dims = dict(zip(DIMS, self._shape, strict=True))
        chunks: tuple[int, ...] = (min(frames, self._chunk_frames), min(rows, _CHUNK_ROWS), min(cols, _CHUNK_COLS))
        if self._targets:
            dims = {"frame": frames, TARGET: self._targets, "row": rows, "col": cols}
            chunks = (chunks[0], self._targets, *chunks[1:])
        for name, length in dims.items():
            hdf5.add_scale(root, name, length)
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

        range_mm (n, row, col) or (n, target, row, col) uint16, 0 where invalid, or float32, NaN where invalid;
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
        group,
        "range_true",
        dims=layered,
        dtype="f4",
        units="mm",
        long_name="range of each surface, near to far",
        fill=np.nan,
        data=truth.range_true,
    )
    hdf5.add_variable(
        group,
        "weight_true",
        dims=layered,
        dtype="f4",
        units="1",
        long_name="share of the beam, p(c_i)",
        fill=np.nan,
        data=truth.weight_true,
    )
    hdf5.add_variable(
        group,
        "weight_no_return",
        dims=image,
        dtype="f4",
        units="1",
        long_name="share without a return, p(c_0)",
        data=truth.weight_no_return,
    )
