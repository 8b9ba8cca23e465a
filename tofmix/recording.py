"""What travels as a recording: its sizes, its sensor, and blocks of samples.

Anything with the methods of `SampleSource` can be estimated: a file
(`tofmix.io.recording_file`), or an array in memory (`ArrayRecording`).
"""

from copy import copy
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import Float32Array
from tofmix.sensor import Sensor

_DIMS = ("frame", "row", "col")

MOST_PIXELS_A_SIDE = 4096
"""Of an image, as for a camera; a damaged header must not ask for terabytes."""

MOST_FRAMES = 1 << 26

MOST_TARGETS = 64
"""Targets that a pixel returns in one frame; lidars and zone sensors return up to four."""

DECODED_SAMPLES = 1 << 20
"""About how many samples a source may hold in their stored form while it reads, where stored chunks are smaller."""


class SampleSource(Protocol):
    """A recording that can be read in blocks."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""

    @property
    def sensor(self) -> Sensor:
        """The camera."""

    @property
    def row_step(self) -> int:
        """Rows that are stored together: blocks of a multiple of it are read fastest."""

    @property
    def frame_step(self) -> int:
        """Frames that are stored together, likewise."""

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid."""


@runtime_checkable
class AmplitudeSource(Protocol):
    """A recording that may know the amplitude of its samples."""

    @property
    def has_amplitude(self) -> bool:
        """Whether it does."""

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes (frame, row, col) float32; NaN where one is not known."""


def amplitude_source(source: SampleSource) -> AmplitudeSource | None:
    """Return the recording itself where it knows the amplitude of its samples."""
    return source if isinstance(source, AmplitudeSource) and source.has_amplitude else None


def wanted_amplitudes(source: SampleSource) -> AmplitudeSource | None:
    """The recording's amplitudes, where its noise curve asks for them."""
    noise = source.sensor.noise
    return None if noise is None or noise.law is None else amplitude_source(source)


class ArrayRecording:
    """A recording in memory.

    Parameters
    ----------
    range_mm : (frame, row, col) array_like of float32
        Samples, mm; NaN or infinite where invalid. They are copied.
    sensor : Sensor
        The camera.
    amplitude : (frame, row, col) array_like of float32, optional
        Amplitude of each sample. They are copied.

    Raises
    ------
    ValueError
        If the samples do not have three dimensions, or there are none, or the amplitudes have another shape.
    """

    def __init__(self, range_mm: ArrayLike, sensor: Sensor, amplitude: ArrayLike | None = None) -> None:
        self._samples: Float32Array = np.array(range_mm, dtype=np.float32, copy=True)
        if self._samples.ndim != len(_DIMS) or self._samples.size == 0:
            raise ValueError(f"range: expected (frame, row, col), got shape {self._samples.shape}")
        self._samples[~np.isfinite(self._samples)] = np.nan
        self._sensor = sensor
        self._amplitude = None if amplitude is None else np.array(amplitude, dtype=np.float32, copy=True)
        if self._amplitude is not None and self._amplitude.shape != self._samples.shape:
            raise ValueError(f"amplitude: shape {self._amplitude.shape} differs from range {self._samples.shape}")

    @property
    def sensor(self) -> Sensor:
        """The camera."""
        return self._sensor

    def with_sensor(self, sensor: Sensor) -> "ArrayRecording":
        """Return the same samples, not copied, of another camera."""
        other = copy(self)
        other._sensor = sensor  # noqa: SLF001  of its own class
        return other

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""
        frames, rows, cols = self._samples.shape
        return frames, rows, cols

    @property
    def row_step(self) -> int:
        """Any number of rows is as good."""
        return 1

    @property
    def frame_step(self) -> int:
        """Any number of frames is as good."""
        return 1

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid."""
        return self._samples[frames, rows]

    @property
    def has_amplitude(self) -> bool:
        """Whether amplitudes were given."""
        return self._amplitude is not None

    def read_amplitude(self, frames: slice, rows: slice) -> Float32Array:
        """Amplitudes (frame, row, col) float32.

        Raises
        ------
        ValueError
            If there are none.
        """
        if self._amplitude is None:
            raise ValueError("the recording has no amplitudes")
        return self._amplitude[frames, rows]


class FrameSpan:
    """Some frames of a recording, as a recording of their own; nothing is copied.

    Parameters
    ----------
    source : SampleSource
        The recording.
    start, stop : int
        Its frames [start, stop).

    Raises
    ------
    ValueError
        If the recording has no such frames.
    """

    def __init__(self, source: SampleSource, start: int, stop: int) -> None:
        if not 0 <= start < stop <= source.shape[0]:
            raise ValueError(f"frames {start} to {stop} asked for, the recording has {source.shape[0]}")
        self._source, self._start, self._stop = source, start, stop

    @property
    def sensor(self) -> Sensor:
        """The camera."""
        return self._source.sensor

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows, columns."""
        return self._stop - self._start, *self._source.shape[1:]

    @property
    def row_step(self) -> int:
        """Rows that are stored together."""
        return self._source.row_step

    @property
    def frame_step(self) -> int:
        """Frames that are stored together."""
        return self._source.frame_step

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid."""
        first, last, step = frames.indices(self._stop - self._start)
        return self._source.read_range(slice(self._start + first, self._start + last, step), rows)
