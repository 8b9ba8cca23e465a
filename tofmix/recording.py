"""What travels as a recording: its sizes, its sensor, and blocks of samples.

Anything with the methods of `SampleSource` can be estimated: a file
(`tofmix.io.recording_file`), or an array in memory (`ArrayRecording`).
"""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import Float32Array
from tofmix.sensor import Sensor

_DIMS = ("frame", "row", "col")

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


class ArrayRecording:
    """A recording in memory.

    Parameters
    ----------
    range_mm : (frame, row, col) array_like of float32
        Samples, mm; NaN or infinite where invalid. They are copied.
    sensor : Sensor
        The camera.

    Raises
    ------
    ValueError
        If the samples do not have three dimensions, or there are none.
    """

    def __init__(self, range_mm: ArrayLike, sensor: Sensor) -> None:
        self._samples: Float32Array = np.array(range_mm, dtype=np.float32, copy=True)
        if self._samples.ndim != len(_DIMS) or self._samples.size == 0:
            raise ValueError(f"range: expected (frame, row, col), got shape {self._samples.shape}")
        self._samples[~np.isfinite(self._samples)] = np.nan
        self._sensor = sensor

    @property
    def sensor(self) -> Sensor:
        """The camera."""
        return self._sensor

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
