"""Opening recordings, and whether one goes with a layers file; shared by the commands that read recordings."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.sensor_choice import AUTO

if TYPE_CHECKING:
    from tofmix.io.layers.layers_file import LayersFile
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.report.summary.findings import Finding, Remedy
    from tofmix.sensor import Sensor


def echo(text: str) -> None:
    """Say something on stderr."""
    click.echo(f"tofmix: {text}", err=True)


@contextmanager
def opened_recording(path: Path, *, say: Callable[[str], object] = echo) -> Iterator["RecordingFile"]:
    """Open a recording, and say what is doubtful about it.

    Raises
    ------
    BadInputError
        As `tofmix.io.recording.recording_file.open_recording`.
    """
    from tofmix.io.recording.recording_file import open_recording

    with open_recording(path) as recording:
        for line in recording.remarks:
            say(line)
        yield recording


def check_not_averaged(recording: "RecordingFile") -> None:
    """Refuse a recording whose frames are marked as averages.

    Raises
    ------
    BadInputError
        If its root attribute `averaged` is a number other than 0.
    """
    from tofmix.errors import BadInputError

    if recording.attributes().get("averaged", 0) in (0, "0", ""):
        return
    raise BadInputError(
        f"{recording.path}: marked as averaged: a mean does not separate surfaces;"
        " unmix them with --mixing phasor, record at an integration time that the camera does not average,"
        " or use the means as samples with --force"
    )


def findings_of_samples(
    source: "RecordingFile", sensor: "Sensor", circle_mm: float | None, remedy: "Remedy"
) -> list["Finding"]:
    """Doubts from some of the samples: scatter off the noise curve of `sensor`, and drift within a window."""
    from tofmix.estimation.learnt.model import follows_drift
    from tofmix.estimation.noise.consistency import check_consistency
    from tofmix.report.summary.findings import sample_findings

    seen = check_consistency(
        source, sensor.noise, window_frames=remedy.window_frames, unambiguous_range_mm=circle_mm,
        follows_drift=follows_drift(sensor),
    )  # fmt: skip
    # A curve that the samples gave is theirs.
    scatter = None if remedy.noise == AUTO else seen.scatter_over_curve
    return sample_findings(scatter_over_curve=scatter, drift_sigmas=seen.drift_sigmas, remedy=remedy)


def check_recording(file: "LayersFile", source: "RecordingFile") -> None:
    """Refuse a recording of another size; say so where it is merely another one.

    Raises
    ------
    BadInputError
        If its image or its frames are not those of the layers.
    """
    from tofmix.errors import BadInputError
    from tofmix.io.recording.recording_file import file_sha256

    if source.shape[1:] != file.shape[1:] or source.frames < int(file.window_stop[-1]):
        raise BadInputError(
            f"{source.path}: range: shape {source.shape} does not go with {file.path}, which has"
            f" {file.shape[1]} x {file.shape[2]} pixels and windows up to frame {int(file.window_stop[-1])}"
        )
    if file_sha256(source.path) != file.provenance.source_sha256:
        click.echo(f"tofmix: {source.path} is not the recording that {file.path} was made from", err=True)
