"""A reconciliation's folder: `model.toml` with its maps, `gap.json`, `report.html`.

Where there are several recordings, the refined model of the second is `model_2.toml`, and so on.

All files are on disk whole before the first gets its name, and `gap.json` gets it last: a folder that has it is
complete.
"""

import errno
import io
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError, StorageError, UsageError, os_error_text
from tofmix.io.locks import hold_lock, release_lock
from tofmix.io.storage import read_text, sync_folder, write_atomic_group
from tofmix.wording import readable

GAP = "gap.json"

FILES = ("report.html", GAP)
"""In addition to the models and their maps."""

VERDICTS = ("agree", "explained", "partly_explained", "unexplained")
_LISTS, _SIZES = ("effects", "where", "candidates", "aliases", "panel"), ("before", "after", "floor")
"""Keys of `gap.json` that are lists, and those of its `gap` that are numbers of at least 0."""


def model_names(models: int) -> list[str]:
    """File names of the refined models."""
    return ["model.toml", *(f"model_{number}.toml" for number in range(2, models + 1))]


def suggested_names(models: int) -> list[str]:
    """File names of the models with what the next steps advise to add."""
    return [f"suggested_{name}" for name in model_names(models)]


def check_folder(folder: Path, *, overwrite: bool, models: int = 1) -> None:
    """Refuse a folder that cannot or must not be written, before any work is done."""
    if folder.exists() and not folder.is_dir():
        raise StorageError(f"{folder} exists and is not a folder")
    if not folder.exists() and not folder.parent.is_dir():
        raise StorageError(f"{folder}: no such folder {folder.parent}")
    place = folder if folder.exists() else folder.parent
    if not os.access(place, os.W_OK | os.X_OK):
        read_only = os.statvfs(place).f_flag & os.ST_RDONLY
        raise StorageError(f"{folder}: {os.strerror(errno.EROFS) if read_only else 'no permission to write there'}")
    there = [name for name in (*model_names(models), *FILES) if (folder / name).exists()]
    if there and not overwrite:
        raise UsageError(f"{folder / there[0]} exists; pass --overwrite to replace it")


def is_gap_folder(path: Path) -> bool:
    """Whether a folder is an output of `tofmix reconcile`."""
    try:
        return (path / GAP).is_file()
    except OSError:
        return False


def parse_gap(path: Path) -> dict[str, Any]:
    """Read the table of keys of a `gap.json`."""
    try:
        gap = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise BadInputError(f"{path}: not JSON: {' '.join(str(error).split())}") from error
    if not isinstance(gap, dict):
        raise BadInputError(f"{path}: expected an object")
    return gap


def gap_faults(gap: dict[str, Any]) -> Iterator[str]:
    """What keys of `gap.json` are not as they should be."""
    if gap.get("verdict") not in VERDICTS:
        yield f"verdict {gap.get('verdict')!r}, expected one of {', '.join(VERDICTS)}"
    for key in _LISTS:
        if not isinstance(gap.get(key), list):
            yield f"{key}: expected a list"
    if not isinstance(gap.get("considered", []), list):  # files of earlier versions have none
        yield "considered: expected a list"
    if not isinstance(gap.get("complete", True), bool):
        yield f"complete: expected true or false, got {gap['complete']!r}"
    sizes = gap.get("gap")
    for key in _SIZES:
        value = sizes.get(key) if isinstance(sizes, dict) else None
        if not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
            yield f"gap: {key}: expected a number of at least 0, got {value!r}"


def read_gap(folder: Path) -> dict[str, Any]:
    """Read `gap.json` of a folder; refuse one that lacks the verdict, the effects or the gap."""
    gap = parse_gap(folder / GAP)
    for key, kind in (("verdict", str), ("effects", list), ("gap", dict)):
        if not isinstance(gap.get(key), kind):
            raise BadInputError(f"{folder / GAP}: no {key}; expected a gap.json of tofmix reconcile")
    return gap


@contextmanager
def locked_folder(folder: Path, *, overwrite: bool, models: int = 1) -> Iterator[None]:
    """Lock the folder before the work for it is done; a second run is refused at once."""
    check_folder(folder, overwrite=overwrite, models=models)
    target = Path(os.path.realpath(folder))
    hold_lock(target)
    try:
        yield
    finally:
        release_lock(target)


def write_folder(
    folder: Path,
    *,
    model_texts: Sequence[str],
    maps: dict[str, FloatArray],
    gap: dict[str, Any],
    page: str,
    overwrite: bool,
    inputs: tuple[Path, ...] = (),
    suggested_texts: Sequence[str] = (),
    beside: Mapping[str, bytes] = MappingProxyType({}),
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
        Content of `gap.json`.
    page : str
        `report.html`.
    overwrite, inputs
        As for `AtomicFile`.
    suggested_texts : sequence of str
        The models with what the next steps advise, one for each recording; empty if they advise no effect.
    beside : mapping of str to bytes
        Further files that the models name, by their path relative to the folder.
    """
    check_folder(folder, overwrite=overwrite, models=len(model_texts))
    contents: dict[Path, bytes] = {folder / name: data for name, data in beside.items()}
    for name, values in maps.items():
        buffer = io.BytesIO()
        np.save(buffer, values.astype(np.float32), allow_pickle=False)
        contents[folder / name] = buffer.getvalue()
    names = model_names(len(model_texts))
    gap_text = json.dumps(gap, indent=2, allow_nan=False) + "\n"
    more = suggested_names(len(suggested_texts)) if suggested_texts else []
    texts = (*suggested_texts, *model_texts, page, gap_text)
    for name, text in zip((*more, *names, *FILES), texts, strict=True):
        contents[folder / name] = readable(text).encode()
    with _folders({folder, *(path.parent for path in contents)}):
        write_atomic_group(contents, overwrite=overwrite, inputs=inputs)
    for pattern in ("model_[0-9]*.toml", "suggested_model*.toml"):  # of more recordings or advice, by an earlier run
        for stale in folder.glob(pattern):
            if stale.name not in (*names, *more):
                stale.unlink()


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
            with suppress(OSError):  # another program has written a file there
                one.rmdir()
        if isinstance(error, OSError):
            raise StorageError(os_error_text(error, min(folders))) from error
        raise
