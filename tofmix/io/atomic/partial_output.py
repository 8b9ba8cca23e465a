"""The partial files and folders of this process: which are removed when it dies, and which a later run continues."""

import shutil
from collections.abc import Callable
from pathlib import Path

_partial: set[Path] = set()
_resumable: set[Path] = set()


_helpers: list[Callable[[], None]] = []


def on_discard(helper: Callable[[], None]) -> None:
    """Have `discard_partial_outputs` call a function, too."""
    _helpers.append(helper)


def discard_partial_outputs() -> None:
    """Remove the temporary files of all outputs that are being written: for a process that is about to die."""
    for helper in _helpers:
        helper()
    for temporary in list(_partial):
        if temporary.is_dir() and not temporary.is_symlink():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)


def note_partial_output(*paths: Path, resumable: bool) -> None:
    """Mark files next to an output: `discard_partial_outputs` removes them, or leaves them to a later run."""
    (_resumable if resumable else _partial).update(paths)
    (_partial if resumable else _resumable).difference_update(paths)


def forget_partial_output(*paths: Path) -> None:
    """Mark files as removed or finished."""
    _partial.difference_update(paths)
    _resumable.difference_update(paths)


def is_resumable() -> bool:
    """Whether work is left to a later run."""
    return bool(_resumable)
