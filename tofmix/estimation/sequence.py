"""Layers of a whole recording: windows of frames, blocks of rows, worker threads.

The recording is read in slabs (all frames of a few windows, a band of rows) of
about `chunk_mb`. A slab is cut into pieces that threads work on side by side, as
the kernels hold no lock, while the next slab is read. Results come window by window in
order, so a writer can store them as they come.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.estimation.layering import layer_pixels, warm_up
from tofmix.estimation.settings import EstimateOptions
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.recording import AmplitudeSource, SampleSource, amplitude_source
from tofmix.windows import Windows

_BYTES_PER_SAMPLE = 16
"""What one sample of a slab takes while it is worked on: stored, decoded, validity, one copy."""

_BYTES_PER_AMPLITUDE = 12
"""The same of its amplitude, where the noise curve asks for it: stored, decoded, one copy."""

_TILE_PIXELS = 2048
"""Pixels that are stored together and make one task."""


@dataclass(frozen=True, slots=True)
class WindowBatch:
    """Layers of consecutive windows, of the leading shape (window, row, col)."""

    windows: slice
    layers: Layers


def tile_shape(windows: int, rows: int, cols: int) -> tuple[int, int]:
    """Windows and rows that are stored and computed together; it depends on the sizes alone."""
    tile_rows = max(1, min(rows, _TILE_PIXELS // cols))
    return max(1, min(windows, _TILE_PIXELS // (rows * cols))), tile_rows


def estimate_windows(
    source: SampleSource,
    windows: Windows,
    options: EstimateOptions | None = None,
    *,
    workers: int = 1,
    chunk_mb: float = 64.0,
    progress: Callable[[int], object] | None = None,
) -> Iterator[WindowBatch]:
    """Estimate the layers of a recording, window by window.

    Parameters
    ----------
    source : SampleSource
        The recording; its sensor must have a noise curve.
    windows : Windows
        From `tofmix.windows.plan_windows`.
    options : EstimateOptions, optional
        Defaults without it.
    workers : int
        Threads, at least 1. It changes no value.
    chunk_mb : float
        Memory for a slab of samples, above 0; at least one row of one window is read. It changes no value.
    progress : callable, optional
        Called with the number of pixels done since the last call.

    Yields
    ------
    WindowBatch
        In the order of the windows; all pixels of the image.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or a number is out of its bounds.
    """
    options = options or EstimateOptions()
    if workers < 1 or not 0 < chunk_mb < math.inf:
        raise ValueError(f"workers {workers} must be at least 1 and chunk_mb {chunk_mb} above 0 and finite")
    # Compile or load the kernels before there are threads: several at once would wait for each other.
    warm_up(options)
    _, rows, cols = source.shape
    batch, tile_rows = tile_shape(windows.count, rows, cols)
    with ThreadPoolExecutor(workers, thread_name_prefix="tofmix") as pool:
        try:
            for first in range(0, windows.count, batch):
                chosen = slice(first, min(first + batch, windows.count))
                job = _Batch(source, windows, chosen, options, tile_rows)
                yield WindowBatch(chosen, job.run(pool, workers, chunk_mb, progress))
        finally:
            pool.shutdown(cancel_futures=True)


@dataclass(frozen=True, slots=True)
class _Batch:
    """A few windows over the whole image."""

    source: SampleSource
    windows: Windows
    chosen: slice
    options: EstimateOptions
    tile_rows: int

    def run(
        self, pool: ThreadPoolExecutor, workers: int, chunk_mb: float, progress: Callable[[int], object] | None
    ) -> Layers:
        _, rows, cols = self.source.shape
        count = self.chosen.stop - self.chosen.start
        out = Layers.empty((count, rows, cols), self.options.max_layers)
        waiting: deque[Future[int]] = deque()
        amplitudes = self._amplitudes()
        for band in self._bands(chunk_mb, _BYTES_PER_SAMPLE + (_BYTES_PER_AMPLITUDE if amplitudes else 0)):
            slab = self.source.read_range(self._frames(), band)
            light = amplitudes.read_amplitude(self._frames(), band) if amplitudes else None
            for window in range(count):
                for piece in _cut(band, self.tile_rows):
                    waiting.append(pool.submit(self._work, (slab, light), band, window, piece, out))
            # One slab is worked on while the next is read, and no more than that.
            while len(waiting) > workers:
                _report(waiting.popleft().result(), progress)
        while waiting:
            _report(waiting.popleft().result(), progress)
        return out

    def _frames(self) -> slice:
        return slice(self.windows.start(self.chosen.start), self.windows.stop(self.chosen.stop - 1))

    def _amplitudes(self) -> AmplitudeSource | None:
        """The recording's amplitudes, where the noise curve asks for them."""
        noise = self.source.sensor.noise
        return None if noise is None or noise.law is None else amplitude_source(self.source)

    def _bands(self, chunk_mb: float, sample_bytes: int) -> Iterator[slice]:
        """Bands of rows of about `chunk_mb`, along the stored chunks where they fit."""
        _, rows, cols = self.source.shape
        frames = self._frames()
        row_bytes = (frames.stop - frames.start) * cols * sample_bytes
        fitting = max(1, int(chunk_mb * 1e6 / row_bytes))
        for step in (self.source.row_step, self.tile_rows):
            if fitting >= step:
                fitting -= fitting % step
                break
        return _cut(slice(0, rows), fitting)

    def _work(
        self, slab: tuple[Float32Array, Float32Array | None], band: slice, window: int, rows: slice, out: Layers
    ) -> int:
        """Fill the layers of some rows of one window from samples and amplitudes; return their pixels."""
        origin = self.windows.start(self.chosen.start)
        start = self.windows.start(self.chosen.start + window) - origin
        piece = slice(start, start + self.windows.length), slice(rows.start - band.start, rows.stop - band.start)
        amplitude = None if slab[1] is None else slab[1][piece]
        layers = layer_pixels(slab[0][piece], self.source.sensor, self.options, amplitude=amplitude)
        for spec in LAYER_FIELDS:
            getattr(out, spec.name)[window, rows] = getattr(layers, spec.name)
        return int(np.prod(layers.shape))


def _cut(rows: slice, step: int) -> Iterator[slice]:
    for start in range(rows.start, rows.stop, step):
        yield slice(start, min(start + step, rows.stop))


def _report(pixels: int, progress: Callable[[int], object] | None) -> None:
    if progress is not None:
        progress(pixels)


def estimate_layers(
    source: SampleSource,
    options: EstimateOptions | None = None,
    *,
    windows: Windows | None = None,
    workers: int = 1,
) -> Layers:
    """Layers of a whole recording in memory, of the leading shape (window, row, col).

    A short form of `estimate_windows` for scripts; parameters and refusals are its own.

    Raises
    ------
    ValueError
        As `estimate_windows`.
    """
    options = options or EstimateOptions()
    frames, rows, cols = source.shape
    plan = windows or Windows(length=frames, stride=frames, count=1, frames_left_out=0)
    out = Layers.empty((plan.count, rows, cols), options.max_layers)
    for batch in estimate_windows(source, plan, options, workers=workers):
        for spec in LAYER_FIELDS:
            getattr(out, spec.name)[batch.windows] = getattr(batch.layers, spec.name)
    return out
