"""The runs of ``tofmix estimate``: recordings one after the other, one bar for all, one line each."""

import json
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.estimate.frames import check_frames
from tofmix.cli.estimate.noise import circle_of, noise_choice, noise_of, sensor_for
from tofmix.cli.estimate.outputs import count_pixels, listed, paired_outputs, windows_of
from tofmix.cli.estimate.request import Request
from tofmix.cli.estimate.results import describe, findings_of, say_findings
from tofmix.cli.import_camera import with_share_law
from tofmix.cli.options import AUTO, is_quiet, note
from tofmix.cli.progress import Progress
from tofmix.cli.recording_check import findings_of_samples, opened_recording
from tofmix.errors import ExitCode, TofmixError
from tofmix.wording import counted

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from tofmix.estimation.settings import EstimateOptions
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.pipeline.cluster import ClusterEngine
    from tofmix.pipeline.job import Engine
    from tofmix.windows import Windows


def estimate_files(
    recordings: Sequence[Path], output: Path | None, output_dir: Path | None, request: Request, *, as_json: bool
) -> None:
    """Estimate recordings, and print the results on stdout.

    Raises
    ------
    UsageError
        If the outputs do not fit, before any estimate.
    TofmixError
        The fault of a single recording. Of several, the others are done, and the exit code is 5.
    """
    several = len(recordings) > 1 or output_dir is not None or Path("-") in recordings
    pairs = paired_outputs(listed(recordings), output, output_dir, request, several=several)
    failed = 0
    with _cluster(request) as cluster, Progress(count_pixels(pairs, request), "estimate", "px") as bar:
        for recording, target in pairs:
            try:
                said = _estimate(recording, target, request, cluster, bar)
            except TofmixError as error:
                if not several:
                    raise
                failed += 1
                with bar.aside():
                    click.echo(f"tofmix: {' '.join(str(error).split())}", err=True)
                said = "", {"status": "failed", "exit_code": int(error.exit_code), "error": str(error)}
            with bar.aside():
                if as_json:
                    click.echo(json.dumps({"recording": str(recording), "output": str(target), **said[1]}))
                elif said[0]:
                    click.echo(said[0])
    if failed:
        click.echo(f"tofmix: {failed} of {len(pairs)} recordings failed; the others are done", err=True)
        raise SystemExit(ExitCode.SOME_FAILED)


def _estimate(
    recording: Path, target: Path, request: Request, cluster: "ClusterEngine | None", bar: Progress
) -> tuple[str, dict[str, Any]]:
    """Estimate one recording; return the result as a line and for JSON."""
    from tofmix.estimation.noise_choice import noise_options
    from tofmix.io.atomic.storage import check_output
    from tofmix.io.layers.journal import WHOLE, Shard
    from tofmix.pipeline.first_run import compile_for
    from tofmix.pipeline.job import plan_job
    from tofmix.pipeline.local import LocalEngine
    from tofmix.pipeline.run import run_job
    from tofmix.report.summary.findings import Remedy

    say = partial(_say, bar)
    with opened_recording(recording, say=say) as source:
        check_frames(source, request)
        if not request.resume:
            check_output(target, overwrite=request.overwrite, inputs=(recording,))
        noise = noise_choice(source, request.noise)
        windows = windows_of(source, request)
        options, from_samples = _with_sensor(source, request, noise, windows, bar)
        if from_samples:
            noise = AUTO
        remedy = Remedy(
            recording=str(recording), noise=noise, window_frames=windows.length, windows=windows.count,
            paper=options.paper, unmix=options.mixing == "auto", has_amplitude=source.has_amplitude,
        )  # fmt: skip
        with bar.aside():
            findings = findings_of_samples(source, source.sensor, options.unambiguous_range_mm, remedy)
        say_findings(recording, findings, say)
        job = plan_job(
            source, windows, options,
            noise_options(noise, request.outliers, shape=request.noise_shape, widths=request.noise_widths),
        )  # fmt: skip
        engine: Engine
        if cluster is not None:
            engine = cluster
        else:
            with bar.aside():
                compile_for(job.options, source.sensor, unmixes=job.provenance.is_unmixed)
            engine = LocalEngine(
                source=source, workers=request.workers, memory_bytes=request.memory_bytes, folder=target.parent
            )
        shard = Shard(number=request.shard[0], count=request.shard[1]) if request.shard else WHOLE
        outcome = run_job(
            job, engine, target, shard=shard, overwrite=request.overwrite, resume=request.resume,
            progress=bar.update, say=say, verify_source=source.verify_unchanged,
        )  # fmt: skip
        of_layers = findings_of(target, remedy, source) if request.shard is None else []
    if outcome.mixture is not None and not is_quiet():
        say(f"{recording}: mixing: {outcome.mixture.words()}")
    if outcome.continued and not is_quiet():
        say(f"{target}: blocks from the interrupted run: {outcome.continued} of {outcome.cells}")
    if windows.frames_left_out:
        say(f"{recording}: {counted(windows.frames_left_out, 'frame')} after the last whole window left out")
    findings += say_findings(target, of_layers, say)
    return describe(outcome, findings, request.shard)


def _with_sensor(
    source: "RecordingFile", request: Request, noise: str, windows: "Windows", bar: Progress
) -> "tuple[EstimateOptions, bool]":
    """Give the recording its sensor; return the options with its own unambiguous range, and whether noise is learnt."""
    from tofmix.estimation.blocks.sample_span import sensor_with_span
    from tofmix.estimation.noise_choice import NoiseRequest

    options = request.options
    if request.wrap:
        options = replace(options, unambiguous_range_mm=circle_of(source))
    source.sensor = with_share_law(sensor_with_span(source, options.unambiguous_range_mm), request.shares)
    with bar.aside():
        wanted = NoiseRequest(
            noise=noise_of(source, noise), outliers=request.outliers, asked=request.noise is not None,
            window_frames=windows.length, stride_frames=windows.stride, shape=request.noise_shape,
            widths=request.noise_widths, workers=request.workers,
        )  # fmt: skip
        choice = sensor_for(source, options, wanted)
        source.sensor = choice.sensor
        if options.unambiguous_range_mm is None and not options.paper:
            source.sensor = replace(source.sensor, no_return_mm=_no_return(source))
    return options, choice.from_samples


def _no_return(source: "RecordingFile") -> float | None:
    """The file's constant of samples without a return, or the one that its samples show."""
    from tofmix.estimation.noise.no_return import no_return_constant

    if source.sensor.no_return_mm is not None:
        return source.sensor.no_return_mm
    found = no_return_constant(source)
    if found is not None:
        note(f"{source.path}: range: {found:g} mm is the constant of samples without a return")
    return found


def _say(bar: Progress, text: str) -> None:
    with bar.aside():
        click.echo(f"tofmix: {text}", err=True)


def _cluster(request: Request) -> "AbstractContextManager[ClusterEngine | None]":
    if request.scheduler is None:
        return nullcontext()
    from tofmix.pipeline.cluster import open_cluster

    return open_cluster(request.scheduler, memory_bytes=request.memory_bytes)
