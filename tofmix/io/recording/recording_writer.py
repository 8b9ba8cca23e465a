"""Writing of recordings: frames are streamed into a new file, which gets its name after the last frame.

Use `RecordingWriter`; `tofmix.io.recording.recording_file` reads its files. The contract is docs/reference/formats.md.
"""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, FloatArray
from tofmix.io import hdf5, sensor_group
from tofmix.io.schema import (
    FRAME_DIMS,
    RANGE_TRUE_FRAMES,
    RECORDING,
    RECORDING_FIELDS,
    TARGET,
    TRUTH_FIELDS,
    Field,
)
from tofmix.sensor import Sensor
from tofmix.simulation.effects import EffectTruth
from tofmix.simulation.events import Truth
from tofmix.version import __version__

CHUNK_FRAMES = 100
"""Frames of a stored chunk; `simulate` holds as many in memory at once."""


class RecordingWriter(hdf5.FileWriter):
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
        As for `AtomicFile`, also for its errors.
    """

    kind = RECORDING

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
        history = f"written by tofmix {__version__}"
        super().__init__(path, title=title, history=history, overwrite=overwrite, inputs=inputs)
        self._shape = shape
        self._sensor = sensor
        self._truth = truth
        self._model_text = model_text
        self._effect_truth = effect_truth
        self._moving = moving
        self._attributes = attributes or {}
        chunk_rows = 8  # rows of a chunk: a band of rows is read without the rest
        chunk_cols = 22  # columns of a chunk: an eighth of a 176-pixel row
        rows, cols = min(shape[1], chunk_rows), min(shape[2], chunk_cols)
        self._chunks = {"frame": min(shape[0], chunk_frames), TARGET: targets, "row": rows, "col": cols}
        dims = ("frame", TARGET, "row", "col") if targets else FRAME_DIMS
        self._lengths = {
            dim: {"frame": shape[0], TARGET: targets, "row": shape[1], "col": shape[2]}[dim] for dim in dims
        }
        there = {"range": True, "amplitude": has_amplitude, "time": has_time, "temperature": has_temperature}
        self._fields = [
            spec._replace(dims=dims) if spec.dims == FRAME_DIMS else spec
            for spec in RECORDING_FIELDS
            if there[spec.name]
        ]
        if dtype == "f4":
            self._fields[0] = self._fields[0]._replace(dtype=dtype, fill=np.nan)

    def _begin(self, root: h5py.File) -> None:
        root.attrs.update(self._attributes)
        for name, length in self._lengths.items():
            hdf5.add_scale(root, name, length)
        for spec in self._fields:
            chunks = tuple(self._chunks[dim] for dim in spec.dims) if len(spec.dims) > 1 else None
            hdf5.add_field(root, spec, self._lengths, chunks=chunks)
        # filters are those of other samples
        written = replace(self._sensor, temporal_filter=None, neighbour_correlation=None)
        sensor_group.write_sensor(root, written, image=self._shape[1:])
        if self._truth is not None:
            self._write_truth(root, self._truth)
        hdf5.add_nexus_view(root, name="recording", signal="range", axes=FRAME_DIMS)

    def _write_truth(self, root: h5py.File, truth: Truth) -> None:
        group = hdf5.add_group(root, "truth")
        group.attrs["model"] = self._model_text
        layers = truth.range_true.shape[2]
        hdf5.add_scale(group, "layer", layers)
        for spec in TRUTH_FIELDS:
            hdf5.add_field(group, spec, data=getattr(truth, spec.name))
        if self._effect_truth:
            effects = hdf5.add_group(group, "effects")
            for drawn in self._effect_truth:
                _write_drawn(effects, drawn)
        if self._moving:
            lengths = self._lengths | {"layer": layers}
            deep = {"frame": min(self._shape[0], CHUNK_FRAMES), "layer": layers}
            chunks = tuple((self._chunks | deep)[dim] for dim in RANGE_TRUE_FRAMES.dims)
            hdf5.add_field(group, RANGE_TRUE_FRAMES, lengths, chunks=chunks)

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
        """
        part = slice(start, start + len(range_mm))
        given = {"range": range_mm, "time": time_s, "amplitude": amplitude, "temperature": temperature_c}
        for name, values in (given | {f"truth/{RANGE_TRUE_FRAMES.name}": range_true}).items():
            if values is not None:
                self._root[name][part] = values
        self._file.check()


def _write_drawn(group: h5py.Group, drawn: EffectTruth) -> None:
    """Write what an effect has drawn once a recording."""
    values = drawn.values
    fill = np.nan if values.dtype.kind == "f" else None
    spec = Field(drawn.name, values.dtype.str[1:], drawn.unit, drawn.dims, drawn.long_name, fill)
    sizes = zip(drawn.dims, values.shape, strict=True)
    chunks = tuple(min(n, CHUNK_FRAMES) if dim == "frame" else n for dim, n in sizes)
    hdf5.add_field(group, spec, data=values, chunks=chunks)
