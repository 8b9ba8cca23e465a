"""Estimate a recording: checks, camera, windows, and what is doubtful about samples and layers.

`prepare` does all that comes before the layers, `estimate_file` writes a layers file, and `say_findings` ends the job.
The command calls the three for files, `tofmix.estimate` calls the first and the last for samples in memory.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from tofmix.circle import unambiguous_range_mm
from tofmix.errors import BadInputError
from tofmix.estimation.noise.measurement import no_return_constant
from tofmix.estimation.noise_choice import (
    AUTO,
    FILE,
    NoiseChoice,
    NoiseRequest,
    check_parts,
    choose_sensor,
    noise_options,
)
from tofmix.estimation.samples import sensor_with_span
from tofmix.estimation.settings import EstimateOptions, MixingChoice
from tofmix.grid import Windows, plan_windows
from tofmix.io.layers.journal import WHOLE, Shard
from tofmix.io.layers.layers_file import open_layers
from tofmix.io.recording.recording_file import open_recording
from tofmix.io.storage import check_output
from tofmix.jobs.files import findings_of_samples, opened_recording
from tofmix.jobs.reporter import OptionError, Reporter
from tofmix.layers import LayersSource
from tofmix.pipeline.cluster import ClusterEngine, open_cluster
from tofmix.pipeline.first_run import compile_for
from tofmix.pipeline.job import Engine, Job, LocalEngine, plan_job
from tofmix.pipeline.run import Outcome, merge_parts, run_job
from tofmix.recording import CameraSource
from tofmix.report.summary.findings import OPTIONS, Finding, Remedy, lacking
from tofmix.report.summary.lost import cause_of_loss
from tofmix.report.summary.moved_frames import moved_frames
from tofmix.report.summary.summary import find
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensor_schema import share_law_of
from tofmix.sensors import PROFILES, noise_of_profile, profiles_with_noise
from tofmix.wording import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateRequest:
    """The options of an estimate, whoever asks for it."""

    options: EstimateOptions
    noise: str | NoiseCurve | None = None  # file, auto, the name of a built-in camera, or a curve
    outliers: str | float = FILE  # file, auto, or p(c_r)
    noise_shape: str = AUTO
    noise_widths: str = AUTO
    shares: str | None = None  # a member of `ShareLaw`; the recording's without it
    wrap: bool = False  # whether ranges fold at the unambiguous range of the recording's own camera
    window: int | None = None  # frames
    stride: int | None = None  # frames
    force: bool = False  # whether means are used as samples
    workers: int = 1  # threads


@dataclass(frozen=True, slots=True, kw_only=True)
class FileRequest:
    """The options of layers files, and of the machines that make them."""

    memory_bytes: int
    shard: Shard = WHOLE
    resume: bool = False
    overwrite: bool = False
    scheduler: str | None = None

    def cluster(self) -> AbstractContextManager[ClusterEngine | None]:
        """The cluster of the scheduler; None without one."""
        return nullcontext() if self.scheduler is None else open_cluster(self.scheduler, memory_bytes=self.memory_bytes)


class About(NamedTuple):
    """The recording that messages name: the one that the user gave, if the file in hand was made of it."""

    recording: Path
    part: str = ""  # which part of it the file is

    @property
    def name(self) -> str:
        """The recording and its part."""
        return f"{self.recording}: {self.part}" if self.part else str(self.recording)


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A recording with the camera of its estimate, the job on it, and the findings of its samples."""

    source: CameraSource
    job: Job
    windows: Windows  # in frames
    remedy: Remedy
    findings: list[Finding]
    has_commands: bool = True  # whether a command estimates what the findings are about


def check_request(request: EstimateRequest, reporter: Reporter) -> None:
    """Refuse options that exclude each other, before any recording is opened."""
    if request.stride is not None and request.window is None:
        raise OptionError(f"{reporter.option('stride')} needs {reporter.option('window')}")
    noise, outliers = request.noise, request.outliers
    if outliers not in (FILE, AUTO) and (isinstance(outliers, str) or not 0.0 <= outliers < 1.0):
        raise OptionError(f"{reporter.option('outliers')}: '{outliers}' is not file, auto or a probability in [0, 1)")
    if isinstance(noise, str) and noise not in (FILE, AUTO, *PROFILES):
        known = ", ".join(profiles_with_noise())
        raise OptionError(f"{reporter.option('noise')}: unknown profile {noise!r}; choose file, auto or one of {known}")
    other = None if noise in (None, AUTO) else noise if isinstance(noise, str) else "NoiseCurve"
    shape, widths = request.noise_shape, request.noise_widths
    try:
        check_parts(request.options, shape=shape, widths=widths, other_noise=other, spell=reporter.spell)
    except ValueError as error:
        raise OptionError(str(error)) from error


def prepare(
    source: CameraSource, request: EstimateRequest, reporter: Reporter, *, about: About | None = None
) -> Prepared:
    """Settle the camera, the windows and the job of a recording.

    Parameters
    ----------
    source : CameraSource
        The open recording.
    request : EstimateRequest
        Checked by `check_request`.
    reporter : Reporter
        Receives doubts about the samples and their noise, and notes.
    about : About, optional
        What a remedy's command names; without it, the open recording. No command estimates a part of one.
    """
    options = request.options
    _check_frames(source, request, reporter)
    windows = windows_of(source, request)
    if request.wrap:
        options = replace(options, unambiguous_range_mm=_circle_of(source))
    source = source.with_sensor(sensor_with_span(source, options.unambiguous_range_mm))
    if request.shares is not None:
        source = source.with_sensor(replace(source.sensor, share_law=share_law_of(request.shares)))
    asked = request.noise if request.noise is not None else AUTO if source.sensor.noise is None else FILE
    with reporter.aside():
        wanted = NoiseRequest(
            noise=_named(source, asked, reporter),
            outliers=request.outliers,
            asked=request.noise is not None,
            window_frames=windows.length,
            stride_frames=windows.stride,
            shape=request.noise_shape,
            widths=request.noise_widths,
            workers=request.workers,
        )
        choice = choose_camera(source, options, wanted, reporter)
        sensor = choice.sensor
        if options.unambiguous_range_mm is None and not options.paper and sensor.no_return_mm is None:
            found = no_return_constant(source.with_sensor(sensor))
            sensor = replace(sensor, no_return_mm=found)
            if found is not None:
                reporter.note(f"{source.name}: range: {found:g} mm is the constant of samples without a return")
        source = source.with_sensor(sensor)
        noise = AUTO if choice.from_samples else asked if isinstance(asked, str) else "given"
        remedy = Remedy(
            recording=source.name if about is None else str(about.recording),
            noise=noise,
            window_frames=windows.length,
            windows=windows.count,
            paper=options.paper,
            unmix=options.mixing == MixingChoice.AUTO,
            has_amplitude=source.has_amplitude,
        )
        findings = findings_of_samples(source, sensor, options.unambiguous_range_mm, remedy)
    has_commands = about is None or not about.part
    for finding in findings:
        reporter.finding(source.name, finding if has_commands else finding.without_commands())
    of_sensor = noise_options(noise, request.outliers, shape=request.noise_shape, widths=request.noise_widths)
    job = plan_job(source, windows, options, of_sensor)
    return Prepared(
        source=source, job=job, windows=windows, remedy=remedy, findings=findings, has_commands=has_commands
    )


def estimate_file(
    recording: Path,
    target: Path,
    request: EstimateRequest,
    files: FileRequest,
    cluster: ClusterEngine | None,
    reporter: Reporter,
    *,
    about: About | None = None,
) -> tuple[Outcome, list[Finding]]:
    """Write the layers file of a recording, or a part of it.

    With `about`, the layers are for the time of a job: the doubts about that recording were said when it was opened,
    and all else is said of it.

    Returns
    -------
    (Outcome, list of Finding)
        The result, and what was found doubtful.
    """
    opened = opened_recording(recording, reporter) if about is None else open_recording(recording, name=about.name)
    with opened as source:
        if not files.resume:
            check_output(target, overwrite=files.overwrite, inputs=(recording,))
        ready = prepare(source, request, reporter, about=about)
        job, engine = ready.job, cluster or _local_engine(ready, request, files, target, reporter)
        outcome = run_job(
            job,
            engine,
            target,
            shard=files.shard,
            overwrite=files.overwrite,
            resume=files.resume,
            progress=reporter.progress,
            say=reporter.warn,
            verify_source=source.verify_unchanged,
        )
        if outcome.mixture is not None:
            reporter.note(f"{source.name}: mixing: {outcome.mixture.words()}")
        if outcome.continued:
            reporter.note(f"{target}: blocks from the interrupted run: {outcome.continued} of {outcome.cells}")
        if files.shard != WHOLE:
            _say_left_out(ready, reporter)
            return outcome, ready.findings
        with open_layers(target) as layers:
            return outcome, say_findings(layers, target if about is None else about.name, ready, reporter)


def merge_files(
    parts: Sequence[Path], target: Path, reporter: Reporter, *, overwrite: bool
) -> tuple[Outcome, list[Finding]]:
    """Join the parts of a sharded run, as `tofmix.pipeline.run.merge_parts`; return what is doubtful too."""
    outcome = merge_parts(parts, target, overwrite=overwrite)
    if outcome.mixture is not None:
        reporter.note(f"{target}: mixing: {outcome.mixture.words()}")
    with open_layers(target) as layers:
        findings = list(find(layers))
    for finding in findings:
        reporter.finding(target, finding)
    return outcome, findings


def _local_engine(
    ready: Prepared, request: EstimateRequest, files: FileRequest, target: Path, reporter: Reporter
) -> Engine:
    with reporter.aside():
        compile_for(ready.job.options, ready.source.sensor, unmixes=ready.job.provenance.is_unmixed)
    return LocalEngine(
        source=ready.source, workers=request.workers, memory_bytes=files.memory_bytes, folder=target.parent
    )


def say_findings(layers: LayersSource, name: object, ready: Prepared, reporter: Reporter) -> list[Finding]:
    """Say what is doubtful about the layers, named `name`; return it after the findings of the samples."""
    _say_left_out(ready, reporter)
    source = ready.source
    found = find(layers, ready.remedy, cause=partial(cause_of_loss, source), frames=partial(moved_frames, source))
    for finding in found:
        reporter.finding(name, finding if ready.has_commands else finding.without_commands())
    return [*ready.findings, *found]


def _say_left_out(ready: Prepared, reporter: Reporter) -> None:
    if left_out := ready.windows.frames_left_out:
        reporter.warn(f"{ready.source.name}: {counted(left_out, 'frame')} after the last whole window left out")


def windows_of(source: CameraSource, request: EstimateRequest) -> Windows:
    """Plan the windows of a recording."""
    try:
        return plan_windows(source.shape[0] // max(1, source.targets), window=request.window, stride=request.stride)
    except ValueError as error:
        raise OptionError(f"{source.name}: {error}") from error


def choose_camera(
    source: CameraSource, options: EstimateOptions, wanted: NoiseRequest, reporter: Reporter
) -> NoiseChoice:
    """Choose the recording's camera, and say what there is to say of its noise."""
    with reporter.learning() as progress:
        choice = choose_sensor(
            source.name,
            source.with_sensor,
            source.sensor,
            options,
            wanted,
            spell=reporter.spell,
            progress=progress,
            before_learning=reporter.before_learning,
        )
    for said in choice.notes:
        (reporter.warn if said.is_warning else reporter.note)(said.text)
    return choice


def learnt_sensor(source: CameraSource, reporter: Reporter) -> Sensor:
    """The recording's camera with the noise of its samples."""
    frames = source.shape[0]
    wanted = NoiseRequest(noise=AUTO, outliers=FILE, asked=True, window_frames=frames, stride_frames=frames)
    source = source.with_sensor(sensor_with_span(source, None))
    return choose_camera(source, EstimateOptions(), wanted, reporter).sensor


def _named(source: CameraSource, noise: str | NoiseCurve, reporter: Reporter) -> str | NoiseCurve:
    """The noise, with the curve of a built-in camera in place of its name."""
    if isinstance(noise, NoiseCurve) or noise in (FILE, AUTO):
        return noise
    try:
        curve, doubt = noise_of_profile(noise, source.sensor.integration_time_ms)
    except ValueError as error:
        raise OptionError(f"{reporter.option('noise')}: {error}") from error
    if doubt is not None:
        reporter.warn(f"{source.name}: {doubt}")
    return curve


def _circle_of(source: CameraSource) -> float:
    """The unambiguous range of the recording's camera, mm."""
    frequency = source.sensor.modulation_frequency_hz
    if frequency is None:
        raise BadInputError(
            f"{source.name}: sensor: no modulation_frequency_hz, which --wrap needs; give --unambiguous-range MM"
        )
    return unambiguous_range_mm(frequency)


def _check_frames(source: CameraSource, request: EstimateRequest, reporter: Reporter) -> None:
    """Refuse frames that the law of mixing cannot use: a mean is no sample, a phasor has an amplitude."""
    phasor = reporter.spell("mixing", MixingChoice.PHASOR.value)
    if request.options.mixing != MixingChoice.PHASOR:
        if source.averaged and not request.force:
            raise BadInputError(
                f"{source.name}: marked as averaged: a mean does not separate surfaces;"
                f" unmix them with {phasor}, record at an integration time that the camera does not average,"
                f" or use the means as samples with {reporter.spell('force', '')}"
            )
        return
    if source.targets:
        raise BadInputError(f"{source.name}: several targets a frame, and {phasor} needs one sample a frame")
    sensor = source.sensor
    if sensor.is_lock_in is False:
        raise BadInputError(
            f"{source.name}: {sensor.name} is no lock-in camera (measurement: {sensor.measurement}), and {phasor}"
            " needs one"
        )
    if missing := lacking(sensor, has_amplitude=source.has_amplitude):
        raise BadInputError(
            f"{source.name}: no {' and no '.join(missing)}, which {phasor} needs; import the recording with"
            f" {' and '.join(OPTIONS[name][0] for name in missing)}"
        )
