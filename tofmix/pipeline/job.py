"""The job on one recording, and the engine of this process that does it.

One thread reads, the others work. `tofmix.pipeline.cluster` has the engine of several machines.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from tofmix.errors import UsageError
from tofmix.estimation.blocks.reading import MemoryTooSmallError, plan_reading
from tofmix.estimation.blocks.sequence import estimate_cells, resolved_mixing
from tofmix.estimation.settings import EstimateOptions, MixingChoice
from tofmix.grid import Cell, Grid, Windows, plan_grid
from tofmix.io.layers.chunks import EncodedCell, encode_cell
from tofmix.io.layers.layers_file import header_image
from tofmix.io.recording.recording_file import RecordingFile
from tofmix.io.recording.scratch import on_scratch
from tofmix.layers import Provenance
from tofmix.recording import CameraSource, SampleSource, independent_samples
from tofmix.version import __version__


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """The estimate of one recording.

    Parameters
    ----------
    recording : Path
        The recording.
    options : EstimateOptions
        The estimator's.
    provenance : Provenance
        Provenance in the layers file; its sensor is the one that is used.
    grid : Grid
        The cells.
        In samples of a pixel: a frame has as many as targets.
    chunk_frames : int
        Samples of a pixel that the recording stores together.
    """

    recording: Path
    options: EstimateOptions
    provenance: Provenance
    grid: Grid
    chunk_frames: int = 1

    @property
    def chunk(self) -> tuple[int, int, int]:
        """Windows, rows and columns that the layers file stores together."""
        return (*self.grid.step, self.grid.image[1])

    def header(self) -> bytes:
        """Key of the job: equal for jobs with equal results."""
        return header_image(self.provenance, self.grid)


def plan_job(
    source: CameraSource, windows: Windows, options: EstimateOptions, of_sensor: dict[str, str | float]
) -> Job:
    """Plan the estimate of an open recording.

    Parameters
    ----------
    source : CameraSource
        The recording, with the sensor that is to be used.
    windows : Windows
        Its windows, in frames.
    of_sensor : dict
        Options by which the sensor was chosen, for the record.

    Returns
    -------
    Job
        The whole recording is read once for its checksum.

    Raises
    ------
    BadInputError
        If the recording cannot be read.
    ValueError
        If phasor sums are insisted on, and it has no phasors.
    """
    options = resolved_mixing(options, source)
    recording = source.path if isinstance(source, RecordingFile) else Path(source.name)
    provenance = Provenance(
        source=recording.name,
        source_sha256=source.sha256(),
        version=__version__,
        sensor=source.sensor,
        options=options.as_dict() | of_sensor | {"window": windows.length, "stride": windows.stride},
        frames_left_out=windows.frames_left_out,
        targets=source.targets,
        has_amplitude=source.has_amplitude,
    )
    grid = plan_grid(windows.of_samples(provenance.samples_a_frame), source.shape[1:], row_step=source.row_step)
    return Job(recording=recording, options=options, provenance=provenance, grid=grid, chunk_frames=source.frame_step)


class Engine(Protocol):
    """Computes cells, somewhere."""

    def __call__(self, job: Job, wanted: Sequence[Cell]) -> Iterator[tuple[Cell, EncodedCell]]:
        """Yield each wanted cell when it is done, in any order."""


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
