"""A recording rearranged on disk, for windows so long that each band of rows must be read separately.

Recordings stored frame by frame would have to be unpacked once for each band. Here they are unpacked once, into a file
in which each row's samples lie together. The file has no name, so it never remains.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Self

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.errors import StorageError, os_error_text
from tofmix.recording import SAMPLE_BYTES, SampleSource, wanted_amplitudes
from tofmix.sensor import Sensor

_READ_BYTES = 8 << 20  # bytes that are read at once


class ScratchRecording:
    """A `tofmix.recording.SampleSource` over a file of (row, frame, col) float32; made by `on_scratch`."""

    frame_step = 1
    row_step = 1

    def __init__(
        self, descriptor: int, shape: tuple[int, int, int], sensor: Sensor, amplitude: Self | None = None
    ) -> None:
        self.shape = shape
        self.sensor = sensor
        self._descriptor = descriptor
        self._amplitude = amplitude

    def place(self, frame: int, row: int) -> int:
        """Offset in the file of a frame's samples of a row."""
        frames, _, cols = self.shape
        return (row * frames + frame) * cols * SAMPLE_BYTES

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

    @property
    def has_amplitude(self) -> bool:
        """Whether amplitudes were laid out, too."""
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
        return self._amplitude.read_range(frames, rows)


@contextmanager
def on_scratch(
    source: SampleSource, folder: Path, *, frames: slice, rows: slice, phasors: bool = False
) -> Iterator[ScratchRecording]:
    """Lay a part of a recording out on disk, each stored chunk read once; a sample takes 4 bytes in `folder`.

    With `phasors`, amplitudes will be read too, even if the noise curve does not need them.

    Raises
    ------
    StorageError
        If there is no room.
    """
    amplitudes = wanted_amplitudes(source, phasors=phasors)
    samples = len(range(rows.start, rows.stop)) * source.shape[0] * source.shape[2] * (2 if amplitudes else 1)
    try:
        with ExitStack() as stack:
            parts = (frames, rows)
            light = None
            if amplitudes is not None:
                light = _laid_out(stack, source, amplitudes.read_amplitude, folder, parts, None)
            yield _laid_out(stack, source, source.read_range, folder, parts, light)
    except OSError as error:
        size = f"{samples * SAMPLE_BYTES / 1e9:.1f} GB"
        raise StorageError(
            f"{os_error_text(error, folder)}; {size} of scratch space are needed there, or more --memory"
        ) from error


def _laid_out(
    stack: ExitStack,
    source: SampleSource,
    read: Callable[[slice, slice], Float32Array],
    folder: Path,
    parts: tuple[slice, slice],
    amplitude: ScratchRecording | None,
) -> ScratchRecording:
    """Write the blocks of `read` to a file that is closed with the stack."""
    frames, rows = parts
    file = stack.enter_context(tempfile.TemporaryFile(dir=folder, prefix=".tofmix-"))  # noqa: SIM115  the stack's
    scratch = ScratchRecording(file.fileno(), source.shape, source.sensor, amplitude)
    size = scratch.place(0, rows.stop) - scratch.place(0, rows.start)
    os.posix_fallocate(file.fileno(), scratch.place(0, rows.start), size)
    chunk = source.frame_step * source.row_step * source.shape[2] * SAMPLE_BYTES
    step = source.frame_step * max(1, _READ_BYTES // chunk)
    for band in _aligned(rows, source.row_step):
        for part in _aligned(frames, step):
            scratch.write(part.start, band.start, read(part, band))
    return scratch


def _aligned(part: slice, step: int) -> Iterator[slice]:
    """Cut a part at the borders of stored chunks."""
    start = part.start
    while start < part.stop:
        stop = min(start - start % step + step, part.stop)
        yield slice(start, stop)
        start = stop
