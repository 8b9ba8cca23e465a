"""The results of ``tofmix estimate``: doubts about a file on stderr, and an outcome as a line and for JSON."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tofmix.cli.options import is_quiet
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.pipeline.run import Outcome
    from tofmix.recording import SampleSource
    from tofmix.report.summary.findings import Finding, Remedy


def say_findings(path: Path, findings: list["Finding"], say: Callable[[str], object]) -> list["Finding"]:
    """Print the doubts about a file, a line each, and the notes unless --quiet is set; return them."""
    for finding in findings:
        if finding.is_note and is_quiet():
            continue
        say(f"{path}: {finding.line}")
    return findings


def findings_of(layers: Path, remedy: "Remedy | None" = None, source: "SampleSource | None" = None) -> list["Finding"]:
    """The doubts about a layers file, in the words of `tofmix report`; `source` is its recording, if at hand."""
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.report.summary.lost import cause_of_loss
    from tofmix.report.summary.summary import find

    with open_layers(layers) as file:
        return list(find(file, remedy, cause=None if source is None else partial(cause_of_loss, source)))


def describe(
    outcome: "Outcome", findings: Sequence["Finding"] = (), shard: tuple[int, int] | None = None
) -> tuple[str, dict[str, Any]]:
    """Describe the result, as a line and for JSON."""
    from tofmix.report.summary.findings import split_notes

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
    warnings, notes = split_notes(findings)
    said: dict[str, Any] = {
        "status": "done", "exit_code": 0, "rows": rows, "cols": cols, "windows": windows.count,
        "window_frames": windows.length, "frames_left_out": windows.frames_left_out,
        "pixels_by_surfaces": list(outcome.tally), "blocks": outcome.cells, "blocks_continued": outcome.continued,
        "warnings": [finding.as_dict() for finding in warnings], "notes": [finding.as_dict() for finding in notes],
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
