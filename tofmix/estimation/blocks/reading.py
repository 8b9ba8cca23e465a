"""Reading a recording in slabs, each stored chunk once, within a limit of memory.

A slab is some frames of a band of rows. Bands are read one after the other, each
from its first frame to its last; slabs stay in memory while a window needs them,
so that overlapping windows share them. `plan_reading` chooses the sizes. It changes
when a sample is read, never a result.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, groupby

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.grid import Cell, Grid
from tofmix.recording import DECODED_SAMPLES, SAMPLE_BYTES, SampleSource, wanted_amplitudes

PIECE_SAMPLES = 1 << 20
"""Most samples for one call of the kernels, unless one pixel has more: this limits their scratch memory."""

_SLAB_BYTES = 8 << 20, 1 << 18, 0
"""About a slab's size where stored chunks are smaller, in the order of preference."""


class MemoryTooSmallError(ValueError):
    """One row of one window does not fit; `needed_bytes` would do."""

    def __init__(self, needed_bytes: int) -> None:
        super().__init__(f"one row of one window takes {needed_bytes / 1e6:.0f} MB of memory")
        self.needed_bytes = needed_bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadPlan:
    """Sizes in which a recording is read.

    Parameters
    ----------
    band : int
        Rows of a band; whole cells.
    frames : int
        Frames of a slab; whole stored chunks.
    ahead : int
        Groups of cells (a band of the windows of one cell) that may be in memory.
    rereads : bool
        Whether stored chunks reach over several bands, so that each would be unpacked once a band.
    """

    band: int
    frames: int
    ahead: int
    rereads: bool


@dataclass(frozen=True, slots=True)
class Slab:
    """Samples (frame, row, col) float32 in mm, NaN where invalid, from `frame` and `row` on, and their amplitudes."""

    frame: int
    row: int
    range_mm: Float32Array
    amplitude: Float32Array | None = None

    def overlap(self, frames: slice, rows: slice) -> tuple[slice, slice]:
        """Where in its arrays those samples are that lie in `frames` and `rows`."""
        first, end = max(frames.start - self.frame, 0), max(frames.stop - self.frame, 0)
        return slice(first, end), slice(rows.start - self.row, rows.stop - self.row)


@dataclass(frozen=True, slots=True)
class Group:
    """Cells of the same windows and band, and the slabs with all their samples."""

    cells: tuple[Cell, ...]
    slabs: tuple[Slab, ...]

    def samples(self, frames: slice, rows: slice, cols: slice) -> Float32Array:
        """Copy samples (frame, row, col) into one array."""
        return np.concatenate([slab.range_mm[(*slab.overlap(frames, rows), cols)] for slab in self.slabs])

    def amplitudes(self, frames: slice, rows: slice, cols: slice) -> Float32Array | None:
        """Copy the amplitudes of samples into one array, if they were read."""
        parts = [
            slab.amplitude[(*slab.overlap(frames, rows), cols)] for slab in self.slabs if slab.amplitude is not None
        ]
        return np.concatenate(parts) if parts else None


def plan_reading(
    source: SampleSource, grid: Grid, *, buffer_bytes: int, workers: int, phasors: bool = False
) -> ReadPlan:
    """Choose bands and slabs for a limit of memory.

    Parameters
    ----------
    grid : Grid
        The cells.
    buffer_bytes : int
        Memory for slabs, for reading them and for the workers.
    workers : int
        Threads that work on cells.
    phasors : bool
        Whether amplitudes are read too, even if the noise curve does not need them.

    Returns
    -------
    ReadPlan
        With bands as high as fit; if it can be, no stored chunk is read twice.

    Raises
    ------
    MemoryTooSmallError
        If not even one row of cells fits.
    """
    rows = grid.image[0]
    whole = [band for band in _bands(grid) if band == rows or band % source.row_step == 0]
    chunk = source.frame_step, source.row_step
    # Amplitudes take as much as the samples.
    times = 2 if wanted_amplitudes(source, phasors=phasors) else 1
    plans = chain(
        _plans(grid, whole, chunk, workers, rereads=False), _plans(grid, _bands(grid), (1, 1), workers, rereads=True)
    )
    for plan, needed in plans:
        if times * needed <= buffer_bytes:
            return plan
    raise MemoryTooSmallError(times * needed)


def _plans(
    grid: Grid, bands: list[int], chunk: tuple[int, int], workers: int, *, rereads: bool
) -> Iterator[tuple[ReadPlan, int]]:
    """Plans from the best to the smallest, and the memory that each needs.

    Reading ahead comes before high bands: without it, nothing is computed while a band is read.
    """
    for overlap in (True, False):
        for band in bands:
            wanted = _wanted_ahead(grid, band, workers)
            for ahead in dict.fromkeys((wanted, min(2, wanted)) if overlap else (1,)):
                for slab_bytes in _SLAB_BYTES:
                    frames = _slab_frames(grid, band, chunk[0], slab_bytes)
                    plan = ReadPlan(band=band, frames=frames, ahead=ahead, rereads=rereads)
                    yield plan, _needed(grid, plan, chunk, workers)


def _bands(grid: Grid) -> list[int]:
    """Heights that a band may have, the highest first."""
    rows, step = grid.image[0], grid.step[1]
    return [min(n * step, rows) for n in range(grid.bands, 0, -1)]


def _wanted_ahead(grid: Grid, band: int, workers: int) -> int:
    """Groups that keep all workers busy while the next one is read."""
    cells = -(-band // grid.step[1])
    most_ahead = 64  # most groups of slabs that are read ahead of the workers
    return min(1 + -(-2 * workers // cells), most_ahead, max(1, grid.groups * -(-grid.image[0] // band)))


def _slab_frames(grid: Grid, band: int, frame_step: int, slab_bytes: int) -> int:
    """Frames of about `slab_bytes`, and of one stored chunk at least."""
    chunk = frame_step * band * grid.image[1] * SAMPLE_BYTES
    return frame_step * max(1, slab_bytes // chunk)


def _needed(grid: Grid, plan: ReadPlan, chunk: tuple[int, int], workers: int) -> int:
    """Most memory of a plan: slabs of the groups in memory, decoding buffers, and the workers."""
    # At the end of a band its last groups and the first of the next are in memory together.
    frames = _held(grid, plan, plan.ahead) if plan.band == grid.image[0] else plan.ahead * _held(grid, plan, 1)
    cols = grid.image[1]
    decoded = max(chunk[0] * chunk[1] * cols, DECODED_SAMPLES)
    reading = min(decoded, plan.frames * plan.band * cols, grid.windows.stop(grid.windows.count - 1) * plan.band * cols)
    decoding_bytes = 10  # a sample while it is decoded: as it is stored, and whether it is valid
    return plan.band * cols * frames * SAMPLE_BYTES + reading * decoding_bytes + workers * working_bytes(grid)


def _held(grid: Grid, plan: ReadPlan, groups: int) -> int:
    """Most frames of the slabs that some consecutive groups need."""
    windows, step = grid.windows, grid.step[0]
    starts = np.arange(0, windows.count, step, dtype=np.int64)
    stops = np.minimum(starts + groups * step, windows.count)
    first = starts * windows.stride // plan.frames
    last = ((stops - 1) * windows.stride + windows.length - 1) // plan.frames
    total = windows.stop(windows.count - 1)
    return min(int((last - first).max() + 1) * plan.frames, -(-total // plan.frames) * plan.frames)


def working_bytes(grid: Grid) -> int:
    """Memory that a worker takes for the piece of a cell that it works on."""
    rows, length = min(grid.step[1], grid.image[0]), grid.windows.length
    # bytes of a sample in the order and precision of the kernels, with its layers
    return 24 * min(rows * grid.image[1] * length, max(PIECE_SAMPLES, length))


def read_groups(
    source: SampleSource, grid: Grid, plan: ReadPlan, wanted: Iterable[Cell], *, phasors: bool = False
) -> Iterator[Group]:
    """Read the samples of some cells, group by group: band after band, each in the order of time.

    Frames and rows that no wanted cell needs are not read.
    """
    high = -(-plan.band // grid.step[1])

    def band(cell: Cell) -> int:
        return cell.index % grid.bands // high

    reader = _SlabReader(source, plan, phasors=phasors)
    for _, members in groupby(sorted(wanted, key=lambda cell: (band(cell), cell.index)), key=band):
        in_band = list(members)
        rows = slice(min(cell.rows.start for cell in in_band), max(cell.rows.stop for cell in in_band))
        for _, group in groupby(in_band, key=lambda cell: cell.windows.start):
            cells = tuple(group)
            yield Group(cells, reader.slabs(grid.frames(cells[0].windows), rows))


class _SlabReader:
    """Keeps the slabs that the last group had, as the next one may need them."""

    def __init__(self, source: SampleSource, plan: ReadPlan, *, phasors: bool) -> None:
        self._source = source
        self._amplitudes = wanted_amplitudes(source, phasors=phasors)
        self._frames = plan.frames
        self._kept: dict[tuple[int, int], Slab] = {}

    def slabs(self, frames: slice, rows: slice) -> tuple[Slab, ...]:
        """Slabs that cover some frames of a band."""
        step, end = self._frames, self._source.shape[0]
        starts = range(frames.start - frames.start % step, frames.stop, step)
        self._kept = {key: slab for key, slab in self._kept.items() if key[0] == rows.start and key[1] >= starts[0]}
        for start in starts:
            if (rows.start, start) not in self._kept:
                part = slice(start, min(start + step, end))
                light = self._amplitudes.read_amplitude(part, rows) if self._amplitudes else None
                self._kept[rows.start, start] = Slab(start, rows.start, self._source.read_range(part, rows), light)
        return tuple(self._kept[rows.start, start] for start in starts)
