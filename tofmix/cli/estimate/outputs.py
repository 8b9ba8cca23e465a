"""Recordings from the command line or stdin, the output of each, and the pixels of all."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tofmix.cli.estimate.request import Request
from tofmix.errors import StorageError, TofmixError, UsageError, os_error_text

if TYPE_CHECKING:
    from tofmix.io.recording.recording_file import RecordingFile
    from tofmix.windows import Windows


def listed(recordings: Sequence[Path]) -> list[Path]:
    """Put the names from stdin in the place of ``-``.

    Raises
    ------
    UsageError
        If stdin has none.
    """
    paths = []
    for path in recordings:
        if path == Path("-"):
            paths += [Path(line) for line in sys.stdin.read().splitlines() if line]
        else:
            paths.append(path)
    if not paths:
        raise UsageError("stdin names no recording; write one name a line")
    return paths


def paired_outputs(
    recordings: Sequence[Path], output: Path | None, output_dir: Path | None, request: Request, *, several: bool
) -> list[tuple[Path, Path]]:
    """Pair each recording with its output; invalid outputs are refused before any estimate.

    Raises
    ------
    UsageError
        If two recordings have the same output, or several have no folder.
    StorageError
        If the folder of the outputs cannot be made.
    """
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


def count_pixels(pairs: Sequence[tuple[Path, Path]], request: Request) -> int:
    """Pixels of all recordings and windows; a file that cannot be opened is reported at its turn."""
    from tofmix.io.recording.recording_file import open_recording

    total = 0
    for recording, _ in pairs:
        try:
            with open_recording(recording, check_units=False) as source:
                _, rows, cols = source.shape
                total += windows_of(source, request).count * rows * cols // (request.shard or (1, 1))[1]
        except TofmixError:
            continue
    return total


def windows_of(source: "RecordingFile", request: Request) -> "Windows":
    """Plan the windows of a recording.

    Raises
    ------
    UsageError
        If no whole window fits into its frames.
    """
    from tofmix.windows import plan_windows

    try:
        return plan_windows(source.frames, window=request.window, stride=request.stride)
    except ValueError as error:
        raise UsageError(f"{source.path}: {error}") from error
