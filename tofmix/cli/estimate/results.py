"""The result of ``tofmix estimate`` and ``merge``, as a line and for JSON."""

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.layers.journal import Shard
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
