"""The recordings of ``tofmix estimate``: one after the other, one bar for all, one line each."""

import json
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import is_quiet, note, progress_bar
from tofmix.cli.recording_check import check_not_averaged, check_phasors, findings_of_samples, opened_recording
from tofmix.cli.sensor_choice import AUTO, circle_of, noise_choice, noise_of, sensor_for
from tofmix.errors import ExitCode, StorageError, TofmixError, UsageError, os_error_text
from tofmix.wording import counted

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from tqdm import tqdm

    from tofmix.estimation.settings import EstimateOptions
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.pipeline.cluster import ClusterEngine
    from tofmix.pipeline.job import Engine
    from tofmix.pipeline.run import Outcome
    from tofmix.report.summary.findings import Finding, Remedy
    from tofmix.windows import Windows

_COMPILING_AFTER_S = 4.0  # of work without a result, after which compiling is said to be the cause

_NO_PHASORS = (
    "mixing: not measured: the recording lacks amplitudes or a single modulation frequency; each sample counts as one"
    " surface"
)
"""The note on a recording whose samples are no phasors."""

_compiling_said = threading.Event()


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of all recordings; with `wrap`, each recording has the unambiguous range of its own camera."""

    options: "EstimateOptions"
    wrap: bool
    window: int | None
    stride: int | None
    noise: str | None
    outliers: str | float
    noise_shape: str
    noise_widths: str
    workers: int
    memory_bytes: int
    shard: tuple[int, int] | None
    resume: bool
    overwrite: bool
    scheduler: str | None
    force: bool


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
    pairs = _outputs(_listed(recordings), output, output_dir, request, several=several)
    failed = 0
    with _cluster(request) as cluster, progress_bar(_pixels(pairs, request), "estimate", "px") as bar:
        for recording, target in pairs:
            try:
                said = _estimate(recording, target, request, cluster, bar)
            except TofmixError as error:
                if not several:
                    raise
                failed += 1
                with bar.external_write_mode(file=sys.stderr):
                    click.echo(f"tofmix: {' '.join(str(error).split())}", err=True)
                said = "", {"status": "failed", "exit_code": int(error.exit_code), "error": str(error)}
            with bar.external_write_mode(file=sys.stderr):
                if as_json:
                    click.echo(json.dumps({"recording": str(recording), "output": str(target), **said[1]}))
                elif said[0]:
                    click.echo(said[0])
    if failed:
        click.echo(f"tofmix: {failed} of {len(pairs)} recordings failed; the others are done", err=True)
        raise SystemExit(ExitCode.SOME_FAILED)


def _listed(recordings: Sequence[Path]) -> list[Path]:
    """Put the names from stdin in the place of ``-``."""
    paths = []
    for path in recordings:
        if path == Path("-"):
            paths += [Path(line) for line in sys.stdin.read().splitlines() if line]
        else:
            paths.append(path)
    if not paths:
        raise UsageError("stdin names no recording; write one name a line")
    return paths


def _outputs(
    recordings: Sequence[Path], output: Path | None, output_dir: Path | None, request: Request, *, several: bool
) -> list[tuple[Path, Path]]:
    """Pair each recording with its output; invalid outputs are refused before any estimate."""
    from tofmix.io.atomic.storage import check_output, sync_folder

    ending = "layers.h5" if request.shard is None else "layers.{}-of-{}.part".format(*request.shard)
    if not several:
        return [(recordings[0], output or recordings[0].parent / f"{recordings[0].stem}.{ending}")]
    if output is not None:
        raise UsageError("-o takes a single recording; give --output-dir for several")
    if output_dir is None:
        raise UsageError("several recordings need --output-dir")
    try:
        output_dir.mkdir(exist_ok=True)
        sync_folder(output_dir.absolute().parent)
    except OSError as error:
        raise StorageError(os_error_text(error, output_dir)) from error
    owner: dict[Path, Path] = {}
    for recording in recordings:
        target = output_dir / f"{recording.stem}.{ending}"
        if target in owner:
            raise UsageError(f"{owner[target]} and {recording} would both be written to {target}; rename one")
        owner[target] = recording
        if not request.resume:
            check_output(target, overwrite=request.overwrite, inputs=tuple(recordings))
    return [(recording, target) for target, recording in owner.items()]


def _pixels(pairs: Sequence[tuple[Path, Path]], request: Request) -> int:
    """Pixels of all recordings and windows; a file that cannot be opened is reported at its turn."""
    from tofmix.io.recording.recording_file import open_recording

    total = 0
    for recording, _ in pairs:
        try:
            with open_recording(recording, check_units=False) as source:
                _, rows, cols = source.shape
                total += _windows(source, request).count * rows * cols // (request.shard or (1, 1))[1]
        except TofmixError:
            continue
    return total


def _windows(source: "RecordingFile", request: Request) -> "Windows":
    from tofmix.windows import plan_windows

    try:
        return plan_windows(source.frames, window=request.window, stride=request.stride)
    except ValueError as error:
        raise UsageError(f"{source.path}: {error}") from error


def _estimate(
    recording: Path, target: Path, request: Request, cluster: "ClusterEngine | None", bar: "tqdm[Any]"
) -> tuple[str, dict[str, Any]]:
    """Estimate one recording; return the result as a line and for JSON."""
    from tofmix.estimation.noise_choice import noise_options
    from tofmix.io.atomic.storage import check_output
    from tofmix.io.layers.journal import WHOLE, Shard
    from tofmix.pipeline.job import plan_job
    from tofmix.pipeline.local import LocalEngine
    from tofmix.pipeline.run import run_job
    from tofmix.report.summary.findings import Remedy

    say = partial(_say, bar)
    with opened_recording(recording, say=say) as source:
        _check_frames(source, request)
        if not request.resume:
            check_output(target, overwrite=request.overwrite, inputs=(recording,))
        noise = noise_choice(source, request.noise)
        windows = _windows(source, request)
        options, from_samples = _settled(source, request, noise, windows, bar)
        if from_samples:
            noise = AUTO
        remedy = Remedy(
            recording=str(recording), noise=noise, window_frames=windows.length, windows=windows.count,
            paper=options.paper,
        )  # fmt: skip
        with bar.external_write_mode(file=sys.stderr), announced():
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
            with bar.external_write_mode(file=sys.stderr):
                _compile(options)
            engine = LocalEngine(
                source=source, workers=request.workers, memory_bytes=request.memory_bytes, folder=target.parent
            )
        shard = Shard(number=request.shard[0], count=request.shard[1]) if request.shard else WHOLE
        outcome = run_job(
            job, engine, target, shard=shard, overwrite=request.overwrite, resume=request.resume,
            progress=bar.update, say=say, settle=source.settle,
        )  # fmt: skip
    if not job.provenance.is_unmixed and options.mixing == "auto" and not is_quiet():
        say(f"{recording}: {_NO_PHASORS}")
    if outcome.mixture is not None and not is_quiet():
        say(f"{recording}: mixing: {outcome.mixture.words()}")
    if outcome.continued and not is_quiet():
        say(f"{target}: blocks from the interrupted run: {outcome.continued} of {outcome.cells}")
    if windows.frames_left_out:
        say(f"{recording}: {counted(windows.frames_left_out, 'frame')} after the last whole window left out")
    if request.shard is None:
        findings += say_findings(target, findings_of(target, remedy), say)
    return describe(outcome, findings, request.shard)


def _check_frames(source: "RecordingFile", request: Request) -> None:
    """Refuse frames that the law of mixing cannot use."""
    if request.options.mixing == "phasor":
        check_phasors(source)
    elif not request.force:
        check_not_averaged(source)


def _settled(
    source: "RecordingFile", request: Request, noise: str, windows: "Windows", bar: "tqdm[Any]"
) -> "tuple[EstimateOptions, bool]":
    """Give the recording its sensor; return the options with its own unambiguous range, and whether noise is learnt."""
    from tofmix.estimation.blocks.sample_span import sensor_with_span
    from tofmix.estimation.noise_choice import NoiseRequest

    options = request.options
    if request.wrap:
        options = replace(options, unambiguous_range_mm=circle_of(source))
    source.sensor = sensor_with_span(source, options.unambiguous_range_mm)
    with bar.external_write_mode(file=sys.stderr):
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


def _say(bar: "tqdm[Any]", text: str) -> None:
    with bar.external_write_mode(file=sys.stderr):
        click.echo(f"tofmix: {text}", err=True)


def say_findings(path: Path, findings: list["Finding"], say: Callable[[str], object]) -> list["Finding"]:
    """Print the doubts about a file, a line each; return them."""
    for finding in findings:
        say(f"{path}: {finding.line}")
    return findings


def findings_of(layers: Path, remedy: "Remedy | None" = None) -> list["Finding"]:
    """The doubts about a layers file, in the words of `tofmix report`."""
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.report.summary.summary import find

    with open_layers(layers) as file:
        return list(find(file, remedy))


def describe(
    outcome: "Outcome", findings: Sequence["Finding"] = (), shard: tuple[int, int] | None = None
) -> tuple[str, dict[str, Any]]:
    """Describe the result, as a line and for JSON."""
    (rows, cols), windows = outcome.grid.image, outcome.windows
    undecided = () if outcome.mixture is None else _undecided(outcome.target)
    decided = [count - without for count, without in zip_longest(outcome.tally, undecided, fillvalue=0)]
    found = ", ".join(f"{n}: {count:,}" for n, count in enumerate(decided) if count) or "none"
    found += f"; {sum(undecided):,} undecided, not counted" if any(undecided) else ""
    part = f"part {shard[0]} of {shard[1]} of " if shard else ""
    line = (
        f"{outcome.target}: {part}{rows} x {cols} pixels, {counted(windows.count, 'window')}"
        f" of {counted(windows.length, 'frame')}; pixels by surfaces {found}"
    )
    said: dict[str, Any] = {
        "status": "done", "exit_code": 0, "rows": rows, "cols": cols, "windows": windows.count,
        "window_frames": windows.length, "frames_left_out": windows.frames_left_out,
        "pixels_by_surfaces": list(outcome.tally), "blocks": outcome.cells, "blocks_continued": outcome.continued,
        "warnings": [finding.as_dict() for finding in findings],
    }  # fmt: skip
    if outcome.mixture is not None:
        said["mixing"] = outcome.mixture.as_dict()
        said["undecided_by_surfaces"] = list(undecided)
    return line, said | ({"targets": outcome.targets} if outcome.targets else {})


def _undecided(layers: Path) -> tuple[int, ...]:
    """Pixels of a layers file by their number of surfaces that are undecided; their layers are not to be relied on."""
    from tofmix.io.layers.layers_file import open_layers

    with open_layers(layers) as file:
        return file.undecided_tally()


def _cluster(request: Request) -> "AbstractContextManager[ClusterEngine | None]":
    if request.scheduler is None:
        return nullcontext()
    from tofmix.pipeline.cluster import open_cluster

    return open_cluster(request.scheduler, memory_bytes=request.memory_bytes)


def _compile(options: "EstimateOptions") -> None:
    """Compile the kernels, or load them from their cache; print a line if that takes long."""
    from tofmix.estimation.layering import warm_up

    with announced():
        warm_up(options)


def _say_compiling() -> None:
    if not _compiling_said.is_set():
        _compiling_said.set()
        click.echo("tofmix: compiling the kernels; a first run takes half a minute or more", err=True)


@contextmanager
def announced() -> Iterator[None]:
    """Print one line on stderr if compiling takes long; once in a run."""
    timer = threading.Timer(_COMPILING_AFTER_S, _say_compiling)
    if not is_quiet():  # asked here, for the timer's thread knows no command
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
