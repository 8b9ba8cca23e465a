"""``tofmix estimate``: a recording in, a layers file out; ``tofmix merge``: the parts of a sharded one.

Recordings have one bar for all, and a line each; both commands give their results as a line and for JSON.
"""

import json
import sys
from collections.abc import Callable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from tofmix.cli.options import (
    HDF5_PATH,
    MEMORY,
    PATH,
    SHARD,
    F,
    declared,
    default_workers,
    examples,
    give_way,
    json_option,
    nearer_of,
    overwrite_option,
    shares_option,
)
from tofmix.cli.reporter import CommandReporter, Progress
from tofmix.errors import ExitCode, StorageError, TofmixError, UsageError, os_error_text
from tofmix.options import COUNTERS, ESTIMATE, NOISE
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.estimation.peaks.counters import Counter
    from tofmix.io.layers.journal import Shard
    from tofmix.jobs.estimate import EstimateRequest, FileRequest
    from tofmix.pipeline.run import Outcome
    from tofmix.report.summary.findings import Finding


_NOT_OF_THE_PAPER = (
    "sigma",
    "refine",
    "false_alarm",
    "counter",
    "epsilon",
    "max_iter",
    "tol",
    "unambiguous_range",
    "wrap",
    "mixing",
)
"""Options that the paper's algorithm does not have."""


def _of_counter(kind: str, name: str) -> Callable[[F], F]:
    """The decorator of an option of one counter."""
    return declared(COUNTERS[kind], name, before=f"{kind}: ")


@examples(
    """
tofmix estimate sample_data/three_boards.h5 -o boards.layers.h5
tofmix estimate long.h5 --window 100 --stride 50 --resume
tofmix estimate monday/*.h5 --output-dir layers
tofmix estimate foreign.h5 --noise auto --outliers auto
tofmix estimate foreign.h5 --noise auto --noise-shape gaussian --noise-widths common
tofmix estimate foreign.h5 --noise sr3000 --sigma tied
tofmix estimate folded.h5 --wrap
tofmix estimate boards.h5 --counter cpdf --bins 30 -o cpdf.layers.h5
tofmix estimate boards.h5 --paper --gamma 0.1 -o paper.layers.h5
"""
)
@click.command(short_help="Recover the surfaces in each pixel of a recording.")
@click.argument("recordings", type=PATH, nargs=-1, required=True)
@click.option("-o", "--output", type=HDF5_PATH, help="Layers file to write.  [default: RECORDING with .layers.h5]")
@click.option(
    "--output-dir", type=PATH, help="Folder for the layers files of several recordings; a missing folder is made."
)
@click.option("--window", type=click.IntRange(1), help="Frames of one estimate.  [default: all]")
@click.option("--stride", type=click.IntRange(1), help="Frames from one window to the next.  [default: the window]")
@declared(ESTIMATE, "sigma")
@click.option(
    "--noise",
    metavar="file|auto|PROFILE",
    help="Source of the noise curve: the file, its samples (auto), or a built-in sensor such as sr3000."
    "  [default: file; auto where the file has no curve]",
)
@declared(NOISE, "noise_shape")
@declared(NOISE, "noise_widths")
@click.option(
    "--outliers",
    default="file",
    show_default=True,
    metavar="file|auto|P",
    help="Share of random values p(c_r): from the file, counted in its samples (auto), or a number.",
)
@declared(ESTIMATE, "max_layers")
@declared(ESTIMATE, "refine")
@declared(ESTIMATE, "false_alarm")
@click.option(
    "--counter",
    type=click.Choice(tuple(COUNTERS)),
    default="kde",
    show_default=True,
    help="Method that finds the peaks: the kernel density, or one of the paper's two others, for comparison.",
)
@_of_counter("kde", "gamma")
@_of_counter("kde", "epsilon")
@_of_counter("cpdf", "bins")
@_of_counter("cpdf", "ratio")
@_of_counter("fourier", "order")
@_of_counter("fourier", "level")
@declared(ESTIMATE, "unambiguous_range_mm", "--unambiguous-range", metavar="MM")
@click.option(
    "--wrap",
    is_flag=True,
    help="Set --unambiguous-range to c / 2f, from the recording's modulation frequency f.",
)
@declared(ESTIMATE, "mixing")
@shares_option
@declared(ESTIMATE, "paper")
@declared(ESTIMATE, "max_iter")
@declared(ESTIMATE, "tol")
@declared(ESTIMATE, "min_samples")
@click.option(
    "--force",
    is_flag=True,
    allow_from_autoenv=False,
    help="Use averaged frames as samples; not needed with --mixing phasor.",
)
@click.option(
    "--workers", type=click.IntRange(1), help="Threads; their number changes no result.  [default: all cores]"
)
@click.option(
    "--memory",
    type=MEMORY,
    default="1GB",
    show_default=True,
    metavar="SIZE",
    help="Limit of the memory, such as 300MB or 1.5GB; the limit changes no result.",
)
@click.option(
    "--resume",
    is_flag=True,
    allow_from_autoenv=False,
    help="Continue an interrupted run of the same options; a finished output stays.",
)
@click.option(
    "--shard",
    type=SHARD,
    metavar="I/N",
    help="Compute only part I of N, for job arrays; `tofmix merge` joins the parts.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS|FILE",
    help="Compute on the workers of a dask.distributed scheduler: its address or its scheduler file.",
)
@json_option
@overwrite_option
@click.pass_context
def estimate(
    context: click.Context,
    /,
    recordings: tuple[Path, ...],
    output: Path | None,
    output_dir: Path | None,
    window: int | None,
    stride: int | None,
    noise: str | None,
    outliers: str,
    noise_shape: str,
    noise_widths: str,
    shares: str | None,
    unambiguous_range: float | None,
    wrap: bool,
    workers: int | None,
    memory: int,
    shard: tuple[int, int] | None,
    resume: bool,
    scheduler: str | None,
    force: bool,
    overwrite: bool,
    as_json: bool,
    **choices: float | str | bool,
) -> None:
    """Recover the surfaces in each pixel of RECORDINGS, HDF5 files.

    The peaks of the kernel density of a pixel's samples give the first surfaces.
    Expectation-maximisation fits their ranges, shares and sigmas, and the
    likelihood decides which surfaces stay. The result is a layers file with the
    dimensions window, row, col and layer, near to far. Several recordings need
    --output-dir; - reads their names from stdin, one a line.
    """
    from tofmix.estimation.settings import EstimateOptions
    from tofmix.io.layers.journal import WHOLE, Shard
    from tofmix.jobs.estimate import EstimateRequest, FileRequest, check_request

    shard, scheduler = nearer_of(shard=shard, scheduler=scheduler)
    if scheduler is not None and shard is not None:
        raise UsageError("--shard and --scheduler exclude each other: a shard is computed on this machine")
    settled = give_way({**choices, "wrap": wrap, "unambiguous_range": unambiguous_range}, "paper", _NOT_OF_THE_PAPER)
    if settled["refine"] == "none":
        settled = give_way(settled, "refine", ["false_alarm"])
    settled = give_way(
        settled, "counter", [n for kind, names in COUNTERS.items() if kind != settled["counter"] for n in names]
    )
    wrap, unambiguous_range = settled.pop("wrap"), settled.pop("unambiguous_range")
    choices = settled
    if choices["refine"] == "none" and context.get_parameter_source("false_alarm") is not ParameterSource.DEFAULT:
        raise UsageError("--false-alarm belongs to --refine likelihood, not to --refine none")
    if choices["paper"]:
        _check_paper(context)
    if wrap and unambiguous_range is not None:
        raise UsageError("--wrap takes the unambiguous range from the recording; leave out --unambiguous-range")
    try:
        counter = _counter(context, choices)
        options = EstimateOptions(counter=counter, unambiguous_range_mm=unambiguous_range, **choices)  # type: ignore[arg-type]  # click has checked the types
    except ValueError as error:
        raise UsageError(str(error)) from error
    request = EstimateRequest(
        options=options,
        noise=noise,
        outliers=_number(outliers),
        noise_shape=noise_shape,
        noise_widths=noise_widths,
        shares=shares,
        wrap=wrap,
        window=window,
        stride=stride,
        force=force,
        workers=workers or default_workers(),
    )
    check_request(request, CommandReporter())
    files = FileRequest(
        memory_bytes=memory,
        shard=WHOLE if shard is None else Shard(number=shard[0], count=shard[1]),
        resume=resume,
        overwrite=overwrite,
        scheduler=scheduler,
    )
    estimate_files(recordings, output, output_dir, request, files, as_json=as_json)


def _number(text: str) -> float | str:
    """The number that a text is, or the text."""
    try:
        return float(text)
    except ValueError:
        return text


def _check_paper(context: click.Context) -> None:
    """Refuse options that the paper's algorithm does not have."""
    for name in _NOT_OF_THE_PAPER:
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise UsageError(
                f"--{name.replace('_', '-')} and --paper exclude each other: the paper's algorithm has no such option"
            )


def _counter(context: click.Context, choices: dict[str, Any]) -> "Counter":
    """Take the counter and its options out of the choices; options of another counter are refused."""
    from tofmix.estimation.peaks.counters import COUNTERS as MAKERS

    kind, own = choices.pop("counter"), {}
    for owner, names in COUNTERS.items():
        for name in names:
            value = choices.pop(name)
            if owner == kind:
                own[name] = value
            elif context.get_parameter_source(name) is not ParameterSource.DEFAULT:
                raise UsageError(f"--{name} belongs to --counter {owner}, not to --counter {kind}")
    return MAKERS[kind](**own)


@examples(
    """
tofmix merge long.layers.*.part -o long.layers.h5
"""
)
@click.command(short_help="Join the parts of estimate --shard.")
@click.argument("parts", type=PATH, nargs=-1, required=True)
@click.option("-o", "--output", type=HDF5_PATH, required=True, help="Layers file to write.")
@json_option
@overwrite_option
def merge(parts: tuple[Path, ...], output: Path, *, as_json: bool, overwrite: bool) -> None:
    """Join PARTS, the files that `tofmix estimate --shard I/N` wrote of one recording.

    The layers file has the same bytes as the result of a single run. Missing or duplicate parts, and parts of another
    run, are refused. The parts are kept.
    """
    from tofmix.io.layers.journal import WHOLE
    from tofmix.jobs.estimate import merge_files

    line, values = describe(*merge_files(parts, output, CommandReporter(), overwrite=overwrite), WHOLE)
    click.echo(json.dumps({"output": str(output), **values}) if as_json else line)


def describe(outcome: "Outcome", findings: Sequence["Finding"], shard: "Shard") -> tuple[str, dict[str, Any]]:
    """Describe the result, as a line and for JSON."""
    from tofmix.io.layers.journal import WHOLE
    from tofmix.report.summary.findings import split_notes

    (rows, cols), windows = outcome.grid.image, outcome.windows
    undecided = () if shard != WHOLE else _undecided(outcome.target)
    decided = [count - without for count, without in zip_longest(outcome.tally, undecided, fillvalue=0)]
    found = ", ".join(f"{n}: {count:,}" for n, count in enumerate(decided) if count) or "none"
    found += f"; {sum(undecided):,} undecided, not counted" if any(undecided) else ""
    part = "" if shard == WHOLE else f"part {shard.number} of {shard.count} of "
    line = (
        f"{outcome.target}: {part}{rows} x {cols} pixels, {counted(windows.count, 'window')}"
        f" of {counted(windows.length, 'frame')}; pixels by surfaces {found}"
    )
    warnings, notes = split_notes(findings)
    said: dict[str, Any] = {
        "status": "done",
        "exit_code": 0,
        "rows": rows,
        "cols": cols,
        "windows": windows.count,
        "window_frames": windows.length,
        "frames_left_out": windows.frames_left_out,
        "pixels_by_surfaces": list(outcome.tally),
        "blocks": outcome.cells,
        "blocks_continued": outcome.continued,
        "warnings": [finding.as_dict() for finding in warnings],
        "notes": [finding.as_dict() for finding in notes],
    }
    if outcome.mixture is not None:
        said["mixing"] = outcome.mixture.as_dict()
    if outcome.mixture is not None or any(undecided):
        said["undecided_by_surfaces"] = list(undecided)
    return line, said | ({"targets": outcome.targets} if outcome.targets else {})


def _undecided(layers: Path) -> tuple[int, ...]:
    """Pixels of a layers file by their number of surfaces that are undecided; their layers are not to be relied on."""
    from tofmix.io.layers.layers_file import open_layers

    with open_layers(layers) as file:
        return file.undecided_tally()


def estimate_files(
    recordings: Sequence[Path],
    output: Path | None,
    output_dir: Path | None,
    request: "EstimateRequest",
    files: "FileRequest",
    *,
    as_json: bool,
) -> None:
    """Estimate recordings, and print the results on stdout."""
    from tofmix.jobs.estimate import estimate_file

    several = len(recordings) > 1 or output_dir is not None or Path("-") in recordings
    pairs = _paired_outputs(_listed(recordings), output, output_dir, files, several=several)
    failed = 0
    with files.cluster() as cluster, Progress(_count_pixels(pairs, request, files), "estimate", "px") as bar:
        reporter = CommandReporter(bar)
        for recording, target in pairs:
            said: tuple[str, dict[str, Any]]
            try:
                outcome, findings = estimate_file(recording, target, request, files, cluster, reporter)
                said = describe(outcome, findings, files.shard)
            except TofmixError as error:
                if not several:
                    raise
                failed += 1
                reporter.warn(" ".join(str(error).split()))
                said = "", {"status": "failed", "exit_code": int(error.exit_code), "error": str(error)}
            with bar.aside():
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


def _paired_outputs(
    recordings: Sequence[Path], output: Path | None, output_dir: Path | None, files: "FileRequest", *, several: bool
) -> list[tuple[Path, Path]]:
    """Pair each recording with its output; invalid outputs are refused before any estimate."""
    from tofmix.io.layers.journal import WHOLE
    from tofmix.io.storage import check_output, sync_folder

    shard = files.shard
    ending = "layers.h5" if shard == WHOLE else f"layers.{shard.number}-of-{shard.count}.part"
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
        if not files.resume:
            check_output(target, overwrite=files.overwrite, inputs=tuple(recordings))
    return [(recording, target) for target, recording in owner.items()]


def _count_pixels(pairs: Sequence[tuple[Path, Path]], request: "EstimateRequest", files: "FileRequest") -> int:
    """Pixels of all recordings and windows; a file that cannot be opened is reported at its turn."""
    from tofmix.io.recording.recording_file import open_recording
    from tofmix.jobs.estimate import windows_of

    total = 0
    for recording, _ in pairs:
        try:
            with open_recording(recording, check_units=False) as source:
                _, rows, cols = source.shape
                total += windows_of(source, request).count * rows * cols // files.shard.count
        except TofmixError:
            continue
    return total
