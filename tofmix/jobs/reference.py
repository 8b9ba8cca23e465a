"""The reference of a reconciliation: a recording, or its layers, as the model of the scene.

`reference_of_file` takes a recording or a layers file, `first_frames` the beginning of the measured recording itself.
Both give a model whose scene is what the reference saw, and the layers file that the model names.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io.hdf5 import format_of
from tofmix.io.layers.layers_file import FORMAT as LAYERS
from tofmix.io.layers.layers_file import LayersFile, open_layers
from tofmix.io.recording.recording_file import RecordingFile, open_recording
from tofmix.io.recording.recording_writer import RecordingWriter
from tofmix.io.surfaces_file import FORMAT as SURFACES
from tofmix.jobs.estimate import About
from tofmix.jobs.files import opened_recording
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.jobs.scene import estimated, measured_model, settings_of
from tofmix.reconciliation.likelihood import wander
from tofmix.reconciliation.likelihood.wander import straight_courses, straight_way, uneven_way
from tofmix.recording import CameraSource, SampleSource
from tofmix.sensor import Sensor
from tofmix.simulation import BUILTIN_MODELS
from tofmix.simulation.measured_scene import LEAST_SAMPLES, UNKNOWN_WALK, MeasuredScene, SceneTable
from tofmix.simulation.model import Model

REFERENCE = "reference.layers.h5"
"""The layers of a reference in the folder of a reconciliation."""

SELF_SHARE = 1.0 / 3.0
"""Share of a recording's first frames that is its own reference."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """A reference.

    Parameters
    ----------
    model : Model
        Its scene; the text names `REFERENCE`.
    layers : bytes
        The layers file.
    frames : int
        First frames of the measured recording that are the reference; 0 if it is another file.
    """

    model: Model
    layers: bytes
    frames: int = 0


def check_scene_file(name: str) -> None:
    """Refuse the name of a model, a recording or a layers file that does not exist."""
    if name not in BUILTIN_MODELS and not Path(name).exists():
        known = ", ".join(BUILTIN_MODELS)
        raise BadInputError(
            f"{name}: no such file; give a model (TOML), a recording or a layers file (HDF5), or a built-in model"
            f" ({known})"
        )


def is_reference(path: Path) -> bool:
    """Whether a file is HDF5, and so no model."""
    try:
        with path.open("rb") as file:
            return file.read(8) == b"\x89HDF\r\n\x1a\n"
    except OSError:
        return False


def reference_of_file(path: Path, reporter: Reporter, *, workers: int, others_mm: float = 0.0) -> Reference:
    """The reference of a recording, which is estimated as `tofmix estimate` does, or of the first window of layers.

    Parameters
    ----------
    path : Path
        The recording, or the layers file.
    workers : int
        Threads of the estimate.
    others_mm : float
        `longest_mm` of the recording that is compared with it: random values of a camera that does not say how far it
        measures reach as far as both show.

    Raises
    ------
    BadInputError
        If the file cannot be read, has another format or fewer than 8 frames, or its noise or the directions of its
        pixels are not known.
    """
    kind = format_of(path)
    if kind == SURFACES:
        raise BadInputError(f"{path}: a surfaces file is no reference; give the layers file that it was made from")
    if kind == LAYERS:
        with open_layers(path) as layers:
            frames = int(layers.window_stop[0] - layers.window_start[0])
            _check_frames(path, frames)
            if layers.shape[0] > 1:
                reporter.note(f"{path}: {layers.shape[0]} windows; the first one is the reference")
            if layers.provenance.sensor.temporal_filter is not None:
                raise BadInputError(
                    f"{path}: its camera filters ranges over time, so these layers have another noise than its samples;"
                    " give the recording"
                )
            table = SceneTable(range_max_mm=others_mm)
            made, model = measured_model(layers, path, reporter, REFERENCE, table=table)
            return Reference(model=model, layers=made.layers)
    with opened_recording(path, reporter) as recording:
        return _of_frames(recording, recording.frames, path, reporter, workers, 0, others_mm)


def first_frames(path: Path, wanted: float, reporter: Reporter, *, workers: int) -> Reference:
    """The reference of the first frames of a recording.

    Parameters
    ----------
    path : Path
        The recording.
    wanted : float
        A share of its frames, below 1, or a number of frames.
    workers : int
        Threads of the estimate.

    Raises
    ------
    BadInputError
        As for `reference_of_file`, of the first frames; also if fewer than 8 frames are left to compare.
    OptionError
        If the number is neither a share nor a number of frames.
    """
    if not 0 < wanted < np.inf or (wanted >= 1 and wanted != round(wanted)):
        raise OptionError(
            f"{reporter.option('self')} {wanted:g}: expected a share below 1, or a number of frames, {LEAST_SAMPLES} or"
            " more"
        )
    with opened_recording(path, reporter) as recording:
        frames = int(wanted) if wanted >= 1 else int(wanted * recording.frames)
        _check_frames(path, frames, "the first ")
        if recording.frames - frames < LEAST_SAMPLES:
            raise BadInputError(
                f"{path}: range: {recording.frames} frames, {recording.frames - frames} of them after the reference of"
                f" {frames}; both need {LEAST_SAMPLES}"
            )
        return _of_frames(recording, frames, path, reporter, workers, frames, longest_mm(recording))


def longest_mm(recording: CameraSource) -> float:
    """The longest range of a recording of a camera that does not say how far it measures; 0 if it says so."""
    if recording.sensor.range_max_mm is not None:
        return 0.0
    at_once, longest = 64, 0.0  # frames in memory
    for begin in range(0, recording.shape[0], at_once):
        samples = recording.read_range(slice(begin, begin + at_once), slice(None))
        longest = max(longest, float(np.nan_to_num(samples).max()))
    return longest


def _of_frames(
    recording: RecordingFile, frames: int, path: Path, reporter: Reporter, workers: int, used: int, others_mm: float
) -> Reference:
    """The reference of the first frames of a recording, of which those between independent ones are left out."""
    _check_frames(path, frames, "the first " if used else "")
    about = About(path, f"its first {frames} frames" if used else "")
    way_mm, course = _course(recording, frames, about, reporter)
    table = SceneTable(range_max_mm=others_mm, way_mm=way_mm)
    with (
        _written(recording, frames, path, 1, course) as part,
        estimated(part, workers, reporter, about=about) as layers,
    ):
        found = layers.provenance.sensor.temporal_filter
        if found is None:
            return _reference(layers, path, reporter, recording, part, table, used)
    every = found.frames_apart()
    reporter.note(f"{path}: {found.words()}: one frame of {every} is compared")
    _check_frames(path, -(-frames // every), f"one frame of {every} is independent: ")
    with (
        _written(recording, frames, path, every, course) as part,
        estimated(part, workers, reporter, about=about) as layers,
    ):
        return _reference(layers, path, reporter, recording, part, replace(table, every=every), used)


def _check_frames(path: Path, frames: int, which: str = "") -> None:
    if frames < LEAST_SAMPLES:
        raise BadInputError(f"{path}: {which}{frames} frames; a reference needs {LEAST_SAMPLES}")


def _course(recording: RecordingFile, frames: int, about: About, reporter: Reporter) -> tuple[float, FloatArray | None]:
    """The way of all means, mm, and the straight ways of pixels (frame, row, col), mm, within the first frames.

    They are said; 0 and None if the ranges do not change far. The scene is that of the middle of the time: an effect
    that moves a surface begins there.
    """
    _refuse_targets(recording, about.recording)
    time_s = recording.read_time()
    since, alpha = np.arange(frames, dtype=np.float64) if time_s is None else time_s[:frames], 0.01
    far_mm = straight_way(_of_some_pixels(recording, frames), since, alpha)
    if far_mm is None:
        return 0.0, None
    reporter.warn(
        f"{about.name}: ranges change by {far_mm:+.0f} mm within the reference: the camera or its scene moves. The"
        " scene is that of the middle of this time, and the way of each pixel is taken out"
    )
    samples = recording.read_range(slice(frames), slice(None)).astype(np.float64)
    shape, samples = samples.shape, np.where(samples > 0, samples, np.nan).reshape(frames, -1)
    ways = straight_courses(samples, since)
    moving = np.ptp(ways, axis=0) > 0
    if moving.any():
        middle = ways[:, moving] + np.nanmedian(samples[:, moving] - ways[:, moving], axis=0)
        ways[:, moving] += uneven_way(samples[:, moving] - middle, middle, since)[:, None] * middle
    return far_mm, ways.reshape(shape)


def _of_some_pixels(recording: RecordingFile, frames: int) -> FloatArray:
    """Samples (frame, pixel) of some pixels, spread over the image, NaN where there is none."""
    pixels, at_once = 1024, 64  # enough for medians, though most may be dark; frames in memory
    step = math.ceil(math.sqrt(math.prod(recording.shape[1:]) / pixels))
    blocks = (slice(k, min(k + at_once, frames)) for k in range(0, frames, at_once))
    read = [recording.read_range(block, slice(None))[:, ::step, ::step] for block in blocks]
    some = np.concatenate([block.reshape(len(block), -1) for block in read]).astype(np.float64)
    return np.where(some > 0, some, np.nan)


def _refuse_targets(recording: RecordingFile, path: Path) -> None:
    if recording.targets:
        raise BadInputError(f"{path}: range: {recording.targets} targets a pixel and frame; a scene needs one sample")


@contextmanager
def _written(
    recording: RecordingFile, frames: int, path: Path, every: int, course: FloatArray | None
) -> Iterator[Path]:
    """Every so many of the first frames of a recording, without a course, as a file for the time of the block.

    The recording itself if all frames are taken and there is no course.
    """
    _refuse_targets(recording, path)
    if frames == recording.frames and every == 1 and course is None:
        yield path
        return
    light, time_s, rows = recording.has_amplitude, recording.read_time(), slice(None)
    with TemporaryDirectory(prefix="tofmix-") as folder:
        part = Path(folder) / path.name
        whole = course is None and np.issubdtype(np.dtype(recording.stored_type), np.integer)
        writer = RecordingWriter(
            part,
            shape=(len(range(0, frames, every)), *recording.shape[1:]),
            sensor=recording.sensor if every == 1 else replace(recording.sensor, temporal_filter=None),
            has_amplitude=light,
            has_time=time_s is not None,
            dtype="u2" if whole else "f4",
            attributes={"averaged": int(recording.averaged)},
        )
        samples = recording.read_range(slice(frames), rows)
        if course is not None:
            samples = np.where(samples > 0, samples - course.astype(np.float32), np.float32(np.nan))
        samples = samples[::every]
        with writer:
            writer.write(
                0,
                np.nan_to_num(samples).astype(np.uint16) if whole else samples,
                amplitude=np.nan_to_num(recording.read_amplitude(slice(frames), rows)[::every]) if light else None,
                time_s=None if time_s is None else time_s[:frames:every] - time_s[0],
            )
        yield part


def _reference(
    layers: LayersFile,
    path: Path,
    reporter: Reporter,
    recording: RecordingFile,
    part: Path,
    table: SceneTable,
    used: int,
) -> Reference:
    """The reference of the layers of a part of a recording."""
    with open_recording(part) as first:
        noise, walks = in_common(first, layers)
    settings = settings_of(recording)
    table = replace(table, frame_noise=noise, walks=walks)
    made, model = measured_model(layers, path, reporter, REFERENCE, settings=settings, table=table)
    return Reference(model=model, layers=made.layers, frames=used)


def in_common(source: SampleSource, layers: LayersFile) -> tuple[float, tuple[float, ...]]:
    """What samples of a recording have in common: the noise of each frame, and a walk of all means.

    Parameters
    ----------
    source : SampleSource
        The recording of the layers.
    layers : LayersFile
        With one window of all its frames.

    Returns
    -------
    float
        Standard deviation of what the samples of a frame have in common beyond the noise of each, in sigma; 0 if few
        pixels see one layer.
    tuple of float
        Probability of each size of a walk (`WALKS`).

    References
    ----------
    Variance components of a two-way layout by analysis of variance; Searle, Casella and McCulloch, Variance Components,
    4.3.
    """
    one = layers.read_window(0)
    single = 0.95  # share of a pixel's samples in one layer, from which their scatter is that of the noise
    main = np.nan_to_num(one.weight[..., 0], nan=0.0) > single
    if not main.any():
        return 0.0, UNKNOWN_WALK
    samples = source.read_range(slice(None), slice(None))[:, main].astype(np.float64)
    z = (samples - one.range[..., 0][main]) / one.sigma[..., 0][main]
    far = 5.0  # sigma: a random value
    z = np.where(np.isfinite(z) & (np.abs(z) < far), z, np.nan)
    least_together = 12  # pixels of one layer, from which what they share is told from the noise of each
    noise = _in_common(z) if main.sum() >= least_together else 0.0
    learnt = layers.provenance.sensor.learnt
    memory = 0.0 if learnt is None else learnt.memory
    return noise, wander.probabilities(z, frame_noise=noise, repeats=(1.0 + memory) / (1.0 - memory))


def _in_common(z: FloatArray) -> float:
    """The standard deviation of frame effects in residuals (frame, pixel), NaN where there is none."""
    there = np.isfinite(z)
    frames = there.any(axis=1)
    z, there = z[frames], there[frames]
    if len(z) < LEAST_SAMPLES:
        return 0.0
    flat = np.where(there, z - np.nansum(z, axis=0) / np.maximum(there.sum(axis=0), 1), 0.0)
    count = there.sum(axis=1)
    mean = flat.sum(axis=1) / count
    each = float((flat**2).sum() / max(int(there.sum()), 1))
    between = float((mean**2).mean()) - each * float((1.0 / count).mean())
    return float(np.sqrt(max(between, 0.0) * len(z) / (len(z) - 1)))


def check_same_camera(
    reference: MeasuredScene, sensor: Sensor, name: str, other: Sensor, shape: tuple[int, int]
) -> None:
    """Refuse a recording of another camera, image or lens than the reference's.

    Raises
    ------
    BadInputError
        With what differs.
    """
    if shape != reference.shape:
        raise BadInputError(
            f"{name}: range: an image of {shape[0]} x {shape[1]} pixels; the reference has {reference.shape[0]} x"
            f" {reference.shape[1]}"
        )
    for key in ("name", "modulation_frequency_hz"):
        ours, theirs = getattr(sensor, key), getattr(other, key)
        unknown = ours in (None, "unknown") or theirs in (None, "unknown")
        same = unknown or (ours == theirs if isinstance(ours, str) else bool(np.isclose(ours, theirs, rtol=SAME)))
        if not same:
            raise BadInputError(f"{name}: sensor: {key}: {theirs} is another camera than the reference's {ours}")


SAME = 1e-3  # relative difference of numbers of a camera that are written in a file
