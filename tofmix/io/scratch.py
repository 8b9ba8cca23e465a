"""A recording laid out anew on disk, for windows so long that a band of rows must be read alone.

Recordings stored frame by frame would have to be unpacked once for each band. Here
they are unpacked once, into a file in which each row's samples lie together. The file
has no name, so that nothing is left of it whatever happens.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.errors import StorageError, os_error_text
from tofmix.recording import SampleSource
from tofmix.sensor import Sensor

_SAMPLE_BYTES = 4
_READ_BYTES = 8 << 20


class ScratchRecording:
    """A `tofmix.recording.SampleSource` over a file of (row, frame, col) float32; made by `on_scratch`."""

    frame_step = 1
    row_step = 1

    def __init__(self, descriptor: int, shape: tuple[int, int, int], sensor: Sensor) -> None:
        self.shape = shape
        self.sensor = sensor
        self._descriptor = descriptor

    def place(self, frame: int, row: int) -> int:
        """Where in the file a frame's samples of a row begin."""
        frames, _, cols = self.shape
        return (row * frames + frame) * cols * _SAMPLE_BYTES

    def write(self, frame: int, row: int, samples: Float32Array) -> None:
        """Write samples (frame, row, col) from a frame and a row on."""
        for offset in range(samples.shape[1]):
            data = memoryview(samples[:, offset].tobytes())
            place = self.place(frame, row + offset)
            while data:
                done = os.pwrite(self._descriptor, data, place)
                data, place = data[done:], place + done

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        """Samples (frame, row, col) float32 in mm, NaN where invalid."""
        cols = self.shape[2]
        samples = np.empty((rows.stop - rows.start, frames.stop - frames.start, cols), dtype=np.float32)
        for row, values in zip(range(rows.start, rows.stop), samples, strict=True):
            data, place = memoryview(values).cast("B"), self.place(frames.start, row)
            while data:
                done = os.preadv(self._descriptor, [data], place)
                data, place = data[done:], place + done
        return samples.transpose(1, 0, 2)


@contextmanager
def on_scratch(source: SampleSource, folder: Path, *, frames: slice, rows: slice) -> Iterator[ScratchRecording]:
    """Lay a part of a recording out on disk, each stored chunk read once.

    Parameters
    ----------
    source : SampleSource
        The recording.
    folder : Path
        Where there is room for 4 bytes a sample.
    frames, rows : slice
        The part that will be read.

    Raises
    ------
    StorageError
        If there is not.
    """
    samples = len(range(rows.start, rows.stop)) * source.shape[0] * source.shape[2]
    try:
        with tempfile.TemporaryFile(dir=folder, prefix=".tofmix-") as file:
            scratch = ScratchRecording(file.fileno(), source.shape, source.sensor)
            os.posix_fallocate(file.fileno(), scratch.place(0, rows.start), samples * _SAMPLE_BYTES)
            chunk = source.frame_step * source.row_step * source.shape[2] * _SAMPLE_BYTES
            step = source.frame_step * max(1, _READ_BYTES // chunk)
            for band in _aligned(rows, source.row_step):
                for part in _aligned(frames, step):
                    scratch.write(part.start, band.start, source.read_range(part, band))
            yield scratch
    except OSError as error:
        size = f"{samples * _SAMPLE_BYTES / 1e9:.1f} GB"
        raise StorageError(
            f"{os_error_text(error, folder)}; {size} of scratch space are needed there, or more --memory"
        ) from error


def _aligned(part: slice, step: int) -> Iterator[slice]:
    """Cut a part at the borders of stored chunks."""
    start = part.start
    while start < part.stop:
        stop = min(start - start % step + step, part.stop)
        yield slice(start, stop)
        start = stop
