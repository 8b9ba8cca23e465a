"""The job on one recording, and the engine that does it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tofmix.estimation.blocks.sequence import resolved_mixing
from tofmix.estimation.settings import EstimateOptions
from tofmix.grid import Cell, Grid, plan_grid
from tofmix.io.layers.chunks import EncodedCell
from tofmix.io.layers.provenance import header_image
from tofmix.layers import Provenance
from tofmix.recording import CameraSource
from tofmix.version import __version__
from tofmix.windows import Windows


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
    options : EstimateOptions
        The estimator's.
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
    options, recording = resolved_mixing(options, source), Path(source.name)
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
