"""Cells computed in this process: one thread reads, the others work."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tofmix.errors import UsageError
from tofmix.estimation.blocks.reading import MemoryTooSmallError, plan_reading
from tofmix.estimation.blocks.sequence import estimate_cells, resolved_mixing
from tofmix.estimation.settings import MixingChoice
from tofmix.grid import Cell, Grid
from tofmix.independent_samples import independent_samples
from tofmix.io.layers.chunks import EncodedCell, encode_cell
from tofmix.io.recording.scratch import on_scratch
from tofmix.pipeline.job import Job
from tofmix.recording import SampleSource

PROGRAM_BYTES = 220_000_000
"""Memory of the interpreter, the libraries and the kernels, bytes, without a recording."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalEngine:
    """An `Engine` on this machine.

    Parameters
    ----------
    source : SampleSource
        The open recording, with the sensor of the job.
    workers : int
        Threads.
    memory_bytes : int
        Limit of the process's memory.
    folder : Path
        Folder for scratch files.
    """

    source: SampleSource
    workers: int
    memory_bytes: int
    folder: Path

    def __call__(self, job: Job, wanted: Sequence[Cell]) -> Iterator[tuple[Cell, EncodedCell]]:
        """Yield each wanted cell when it is done.

        Raises
        ------
        UsageError
            If one row of one window does not fit into memory.
        BadInputError
            If the recording cannot be read.
        """
        buffer_bytes, source = self.memory_bytes - PROGRAM_BYTES, independent_samples(self.source)
        phasors = resolved_mixing(job.options, source).mixing is not MixingChoice.EVENTS
        with ExitStack() as stack:
            try:
                plan = plan_reading(source, job.grid, buffer_bytes=buffer_bytes, workers=self.workers, phasors=True)
                if plan.rereads:
                    frames, rows = _extent(job.grid, wanted)
                    source = stack.enter_context(
                        on_scratch(source, self.folder, frames=frames, rows=rows, phasors=True)
                    )
            except MemoryTooSmallError as error:
                least = -(-(error.needed_bytes + PROGRAM_BYTES) // 1_000_000)
                raise UsageError(f"{job.recording}: {error}; pass --memory {least}MB or more") from error
            finish = partial(encode_cell, shape=job.chunk)
            yield from estimate_cells(
                source,
                job.grid,
                job.options,
                finish,
                workers=self.workers,
                buffer_bytes=buffer_bytes,
                wanted=wanted,
                phasors=phasors,
                each=job.provenance.samples_a_frame,
                evidence=True,
            )


def _extent(grid: Grid, cells: Sequence[Cell]) -> tuple[slice, slice]:
    """Frames and rows that the cells need."""
    frames = [grid.frames(cell.windows) for cell in cells]
    return (
        slice(min(part.start for part in frames), max(part.stop for part in frames)),
        slice(min(cell.rows.start for cell in cells), max(cell.rows.stop for cell in cells)),
    )
