"""Runs of ``tofmix estimate``, one recording after the other, and their results as a line and for JSON.

Recordings have one bar for all, and a line each. ``tofmix merge`` has the same results.
"""

import json
import sys
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.reporter import CommandReporter, Progress
from tofmix.errors import ExitCode, StorageError, TofmixError, UsageError, os_error_text
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.layers.journal import Shard
    from tofmix.jobs.estimate import EstimateRequest, FileRequest
    from tofmix.pipeline.run import Outcome
    from tofmix.report.summary.findings import Finding


def describe(outcome: "Outcome", findings: Sequence["Finding"], shard: "Shard") -> tuple[str, dict[str, Any]]:
    """Describe the result, as a line and for JSON."""
    from tofmix.io.layers.journal import WHOLE
    from tofmix.report.summary.findings import split_notes

    (rows, cols), windows = outcome.grid.image, outcome.windows
    undecided = () if outcome.mixture is None else _undecided(outcome.target)
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
