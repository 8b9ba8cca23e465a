"""A reconciliation's folder: `model.toml` with its maps, `gap.json`, `report.html`.

Where there are several recordings, the refined model of the second is `model_2.toml`, and so on.

The files appear one by one, each whole or not at all, and `gap.json` last: a folder that has it is complete.
"""

import io
import json
import os
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import StorageError, UsageError, os_error_text
from tofmix.io.storage import AtomicFile, write_text

_FILES = ("report.html", "gap.json")


def model_names(models: int) -> list[str]:
    """File names of the refined models."""
    return ["model.toml", *(f"model_{number}.toml" for number in range(2, models + 1))]


def check_folder(folder: Path, *, overwrite: bool, models: int = 1) -> None:
    """Refuse a folder that cannot or must not be written, before any work is done.

    Raises
    ------
    UsageError
        If it holds a reconciliation already and may not be overwritten.
    StorageError
        If it is a file or may not be written, or if the folder that it is to stand in does not exist.
    """
    if folder.exists() and not folder.is_dir():
        raise StorageError(f"{folder} exists and is not a folder")
    if not folder.exists() and not folder.parent.is_dir():
        raise StorageError(f"{folder}: no such folder {folder.parent}")
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK | os.X_OK):
        raise StorageError(f"{folder}: no permission to write there")
    there = [name for name in (*model_names(models), *_FILES) if (folder / name).exists()]
    if there and not overwrite:
        raise UsageError(f"{folder / there[0]} exists; pass --overwrite to replace it")


def write_folder(
    folder: Path,
    *,
    model_texts: Sequence[str],
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
    model_texts : sequence of str
        The refined models, one for each recording.
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
    check_folder(folder, overwrite=overwrite, models=len(model_texts))
    try:
        folder.mkdir(exist_ok=True)
        for name in maps:
            (folder / PurePath(name)).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(os_error_text(error, folder)) from error
    for name, values in maps.items():
        buffer = io.BytesIO()
        np.save(buffer, values.astype(np.float32))
        with AtomicFile(folder / name, overwrite=overwrite, inputs=inputs) as file:
            file.sink.write(buffer.getvalue())
            file.commit()
    for name, text in zip(model_names(len(model_texts)), model_texts, strict=True):
        write_text(folder / name, text, overwrite=overwrite, inputs=inputs)
    for stale in folder.glob("model_[0-9]*.toml"):  # of more recordings, by an earlier run
        if stale.name not in model_names(len(model_texts)):
            stale.unlink()
    write_text(folder / "report.html", page, overwrite=overwrite, inputs=inputs)
    said = json.dumps(gap, indent=2, allow_nan=False) + "\n"
    write_text(folder / "gap.json", said, overwrite=overwrite, inputs=inputs)
