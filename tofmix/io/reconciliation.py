"""A reconciliation's folder: `model.toml` with its maps, `gap.json`, `report.html`.

The files appear one by one, each whole or not at all, and `gap.json` last: a folder that has it is complete.
"""

import io
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import StorageError, UsageError, os_error_text
from tofmix.io.claims import hold, let_go
from tofmix.io.storage import AtomicFile, sync_folder, write_text

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
    try:
        folder.mkdir(exist_ok=True)
        for name in maps:
            (folder / PurePath(name)).parent.mkdir(parents=True, exist_ok=True)
        sync_folder(folder)
        sync_folder(folder.absolute().parent)
    except OSError as error:
        raise StorageError(os_error_text(error, folder)) from error
    for name, values in maps.items():
        buffer = io.BytesIO()
        np.save(buffer, values.astype(np.float32))
        with AtomicFile(folder / name, overwrite=overwrite, inputs=inputs) as file:
            file.sink.write(buffer.getvalue())
            file.commit()
    write_text(folder / "model.toml", model_text, overwrite=overwrite, inputs=inputs)
    write_text(folder / "report.html", page, overwrite=overwrite, inputs=inputs)
    text = json.dumps(gap, indent=2, allow_nan=False) + "\n"
    write_text(folder / "gap.json", text, overwrite=overwrite, inputs=inputs)
