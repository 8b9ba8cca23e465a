"""A reconciliation's folder: `model.toml` with its maps, `gap.json`, `report.html`.

All files are on disk whole before the first gets its name, and `gap.json` gets it last: a folder that has it is
complete.
"""

import io
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import StorageError, UsageError, os_error_text
from tofmix.io.claims import hold, let_go
from tofmix.io.storage import sync_folder
from tofmix.io.together import write_together

FILES = ("model.toml", "report.html", "gap.json")


def check_folder(folder: Path, *, overwrite: bool) -> None:
    """Refuse a folder that cannot or must not be written, before any work is done.

    Raises
    ------
    UsageError
        If it holds a reconciliation already and may not be overwritten.
    StorageError
        If it is a file, or the folder that it is to stand in does not exist.
    """
    if folder.exists() and not folder.is_dir():
        raise StorageError(f"{folder} exists and is not a folder")
    if not folder.exists() and not folder.parent.is_dir():
        raise StorageError(f"{folder}: no such folder {folder.parent}")
    there = [name for name in FILES if (folder / name).exists()]
    if there and not overwrite:
        raise UsageError(f"{folder / there[0]} exists; pass --overwrite to replace it")


@contextmanager
def claimed_folder(folder: Path, *, overwrite: bool) -> Iterator[None]:
    """Claim the folder before the work for it is done; a second run is refused at once.

    Raises
    ------
    UsageError
        As for `check_folder`, or if another run is writing it.
    StorageError
        As for `check_folder`.
    """
    check_folder(folder, overwrite=overwrite)
    target = Path(os.path.realpath(folder))
    hold(target)
    try:
        yield
    finally:
        let_go(target)


def write_folder(
    folder: Path,
    *,
    model_text: str,
    maps: dict[str, FloatArray],
    gap: dict[str, Any],
    page: str,
    overwrite: bool,
    inputs: tuple[Path, ...] = (),
) -> None:
    """Write a reconciliation.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    model_text : str
        The refined model.
    maps : dict
        Arrays (row, col) by their path relative to the folder.
    gap : dict
        What `gap.json` holds.
    page : str
        `report.html`.
    overwrite, inputs
        As for `AtomicFile`.

    Raises
    ------
    UsageError, StorageError
        As for `check_folder` and `AtomicFile`.
    """
    check_folder(folder, overwrite=overwrite)
    contents: dict[Path, bytes] = {}
    for name, values in maps.items():
        buffer = io.BytesIO()
        np.save(buffer, values.astype(np.float32), allow_pickle=False)
        contents[folder / name] = buffer.getvalue()
    text = json.dumps(gap, indent=2, allow_nan=False) + "\n"
    for name, content in zip(FILES, (model_text, page, text), strict=True):
        contents[folder / name] = content.encode()
    with _folders({folder, *(path.parent for path in contents)}):
        write_together(contents, overwrite=overwrite, inputs=inputs)


@contextmanager
def _folders(folders: set[Path]) -> Iterator[None]:
    """Make folders; those that are new go again should the block fail."""
    made: list[Path] = []
    try:
        for folder in sorted(folders):
            for one in (*reversed(folder.parents), folder):
                if not one.exists():
                    one.mkdir()
                    made.append(one)
                    sync_folder(one.absolute().parent)
        yield
    except BaseException as error:
        for one in reversed(made):
            with suppress(OSError):  # somebody else has put something there
                one.rmdir()
        if isinstance(error, OSError):
            raise StorageError(os_error_text(error, min(folders))) from error
        raise
