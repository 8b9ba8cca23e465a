"""Recordings and layers files that a job reads: opened with their doubts said, and held against each other."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import LayersFile
from tofmix.io.next_command import next_command
from tofmix.io.recording.range_check import check_whole_numbers
from tofmix.io.recording.recording_file import RecordingFile, file_sha256, open_recording
from tofmix.jobs.reporter import Reporter
from tofmix.recording import SampleSource
from tofmix.report.summary.findings import Finding, Remedy, sample_findings
from tofmix.sensor import Sensor


@contextmanager
def opened_recording(path: Path, reporter: Reporter) -> Iterator[RecordingFile]:
    """Open a recording, and say the doubts about it."""
    with open_recording(path) as recording:
        for line in (*recording.remarks, *check_whole_numbers(recording)):
            reporter.warn(line)
        yield recording


def findings_of_samples(source: SampleSource, sensor: Sensor, circle_mm: float | None, remedy: Remedy) -> list[Finding]:
    """Doubts from some of the samples: scatter off the noise curve of `sensor`, and drift within a window."""
    from tofmix.estimation.noise.consistency import check_consistency  # slow to import, and a report may need none
    from tofmix.independent_samples import independent_samples

    seen = check_consistency(
        independent_samples(source, for_noise=True),
        sensor.noise,
        step=sensor.step,
        window_frames=remedy.window_frames,
        unambiguous_range_mm=circle_mm,
        follows_drift=sensor.follows_drift,
    )
    scatter = None if remedy.noise == "auto" else seen.scatter_over_curve  # a curve that the samples gave is theirs
    return sample_findings(scatter_over_curve=scatter, drift_sigmas=seen.drift_sigmas, remedy=remedy)


def check_recording(file: LayersFile, source: RecordingFile) -> None:
    """Refuse a recording that the layers were not made from: its samples would be shown as those of the layers."""
    if source.shape[1:] != file.shape[1:] or source.frames < int(file.window_stop[-1]):
        raise BadInputError(
            f"{source.path}: range: shape {source.shape} does not match {file.path}, which has"
            f" {file.shape[1]} x {file.shape[2]} pixels and windows up to frame {int(file.window_stop[-1])}"
        )
    if file_sha256(source.path) != file.provenance.source_sha256:
        raise BadInputError(
            f"{source.path} is not the recording that {file.path} was made from, {file.provenance.source} of SHA-256"
            f" {file.provenance.source_sha256[:8]}...; give that one, or estimate this one:"
            f" {next_command('estimate', source.path)}"
        )
