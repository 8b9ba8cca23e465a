"""Recordings and layers files that a job reads: opened with their doubts said, compared, and with their view.

The view of a layers file is where its pixels look, by its camera or a field of view.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tofmix.errors import BadInputError
from tofmix.io.layers.layers_file import LayersFile
from tofmix.io.next_command import next_command
from tofmix.io.recording.range_check import check_whole_numbers
from tofmix.io.recording.recording_file import RecordingFile, file_sha256, open_recording
from tofmix.io.surfaces_file import SurfacesFile
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import Projection, view_doubt
from tofmix.recording import SampleSource
from tofmix.report.summary.findings import Finding, Remedy, motion_findings, repeat_findings, sample_findings
from tofmix.sensor import Sensor, with_view

_VIEW_REMEDY = "import the recording with --fov HxV or --intrinsics, and estimate again"


def check_view(file: LayersFile, *, own_remedy: str = "") -> None:
    """Refuse a layers file without the directions of its pixels, with the remedies: the command's own comes first."""
    try:
        optics = file.provenance.sensor.optics
        if optics is not None:
            optics.check(file.shape[1:])
    except ValueError as error:
        raise BadInputError(f"{file.path}: sensor: {error}; {own_remedy}{_VIEW_REMEDY}") from error
    if optics is None:
        raise BadInputError(f"{file.path}: the directions of its pixels are not known; {own_remedy}{_VIEW_REMEDY}")


def view_note(view_deg: tuple[float, float], projection: str, shape: tuple[int, int]) -> str:
    """Note on a ``--fov`` that may be in radians; empty if it may not."""
    doubt = view_doubt(view_deg, projection, shape)
    return doubt and f"--fov: {doubt}"


def viewed(sensor: Sensor, view_deg: tuple[float, float], projection: str, shape: tuple[int, int]) -> Sensor:
    """The camera with the directions of an image's pixels by a field of view; `OptionError` if no pinhole sees it."""
    try:
        return with_view(sensor, view_deg, projection, shape)
    except ValueError as error:
        raise OptionError(f"--fov: {error}") from error


def view_words(optics: Projection, shape: tuple[int, int], view_deg: tuple[float, float] | None) -> str:
    """A projection in words; an ideal pinhole by its field of view, if that is what was given."""
    if not isinstance(optics, Pinhole):
        return f"field of view {optics.words(shape)}, equal angles"
    how = "pinhole" if view_deg is None else f"an ideal pinhole of {view_deg[0]:g} x {view_deg[1]:g} degrees,"
    lens = "" if not optics.distortion else f" distortion {' '.join(f'{k:g}' for k in optics.distortion)}"
    return f"{how} fx {optics.fx:g} fy {optics.fy:g} cx {optics.cx:g} cy {optics.cy:g}{lens}"


def sensor_of_view(
    file: LayersFile, view_deg: tuple[float, float] | None, projection: str, reporter: Reporter
) -> Sensor:
    """The camera of a layers file, with a given field of view, if any; a doubt about it is said."""
    sensor, image = file.provenance.sensor, file.shape[1:]
    if view_deg is None:
        return sensor
    sensor = viewed(sensor, view_deg, projection, image)
    if doubt := view_note(view_deg, projection, image):
        reporter.warn(doubt)
    return sensor


def placed_words(sensor: Sensor, view_deg: tuple[float, float] | None, shape: tuple[int, int]) -> str:
    """How pixels were placed by a given field of view, for the end of a line; empty without one."""
    if view_deg is None or sensor.optics is None:
        return ""
    return f"; {view_words(sensor.optics, shape, view_deg)}"


def check_window(file: LayersFile | SurfacesFile, window: int | None, reporter: Reporter) -> None:
    """Refuse the number of a window that the file does not have."""
    if window is not None and window >= file.shape[0]:
        raise OptionError(f"{reporter.option('window')} {window}: {file.path} has windows 0 to {file.shape[0] - 1}")


def surfaces_path(layers: Path) -> Path:
    """Default path of the surfaces of a layers file."""
    return layers.parent / f"{layers.name.removesuffix('.layers.h5').removesuffix('.h5')}.surfaces.h5"


@contextmanager
def opened_recording(path: Path, reporter: Reporter) -> Iterator[RecordingFile]:
    """Open a recording, and say the doubts about it."""
    with open_recording(path) as recording:
        for line in (*recording.remarks, *check_whole_numbers(recording)):
            reporter.warn(line)
        yield recording


def findings_of_samples(source: SampleSource, sensor: Sensor, circle_mm: float | None, remedy: Remedy) -> list[Finding]:
    """Doubts from some of the samples: repeats, scatter off the noise curve of `sensor`, and drift within a window."""
    from tofmix.estimation.filters import common_motion, find_repeats
    from tofmix.estimation.noise.curve_check import check_consistency  # slow to import, and a report may need none
    from tofmix.recording import independent_samples

    seen = check_consistency(
        independent_samples(source, for_noise=True),
        sensor.noise,
        step=sensor.step,
        window_frames=remedy.window_frames,
        unambiguous_range_mm=circle_mm,
        follows_drift=sensor.follows_drift,
    )
    scatter = None if remedy.noise == "auto" else seen.scatter_over_curve  # a curve that the samples gave is theirs
    found = sample_findings(scatter_over_curve=scatter, drift_sigmas=seen.drift_sigmas, remedy=remedy)
    filters = sensor.temporal_filter is not None and sensor.temporal_filter.blends
    repeats = None if filters else find_repeats(source)
    motion = common_motion(source) if sensor.temporal_filter is None and circle_mm is None else None
    return [
        *([] if repeats is None else repeat_findings(repeats.share, repeats.frames, remedy)),
        *([] if motion is None else motion_findings(*motion, remedy)),
        *found,
    ]


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
