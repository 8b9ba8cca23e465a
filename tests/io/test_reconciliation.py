"""A reconciliation's folder is whole, or nothing new of it is there."""

import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tofmix.errors import StorageError, UsageError
from tofmix.io.reconciliation import locked_folder, write_folder

MAPS = {"maps/pattern.npy": np.ones((2, 3))}


def write(folder: Path, **settings: Any) -> None:  # noqa: ANN401  the writer's own
    write_folder(folder, model_texts=["model"], gap={"verdict": "agree"}, page="page", **({"maps": MAPS} | settings))


def test_reconciliation_folder_is_written_and_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "gap"
    for overwrite in (False, True):
        write(folder, overwrite=overwrite)
        names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))
        assert names == ["gap.json", "maps", "maps/pattern.npy", "model.toml", "report.html"]
    with pytest.raises(UsageError, match="exists; pass --overwrite"):
        write(folder, overwrite=False)
    np.testing.assert_array_equal(np.load(folder / "maps/pattern.npy"), MAPS["maps/pattern.npy"])


@pytest.mark.parametrize("call", ["os.pwrite", "os.fsync", "pathlib.Path.replace"])
def test_full_disk_leaves_no_new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(call, fail)
        with pytest.raises(StorageError, match="No space left"):
            write(tmp_path / "gap", overwrite=False)
    assert list(tmp_path.iterdir()) == []
    write(tmp_path / "gap", overwrite=False)
    with monkeypatch.context() as patch:
        patch.setattr(call, fail)
        with pytest.raises(StorageError, match="No space left"):
            write(tmp_path / "gap", overwrite=True)
    assert len(list((tmp_path / "gap").iterdir())) == 4


def test_a_second_run_is_refused_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "gap"
    with locked_folder(folder, overwrite=False):
        with pytest.raises(UsageError, match="another run is writing it"):
            # As another process would: what this one holds already passes to its own writers.
            _lock_anew(folder)
        write(folder, overwrite=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gap"]


def _lock_anew(folder: Path) -> None:
    from tofmix.io import locks

    held = locks._held.pop(Path(os.path.realpath(folder)))
    try:
        locks.lock_output(Path(os.path.realpath(folder)))
    finally:
        locks._held[Path(os.path.realpath(folder))] = held


def test_suggested_model_is_written_and_goes_when_a_later_run_suggests_none(tmp_path: Path) -> None:
    folder = tmp_path / "gap"
    write(folder, overwrite=False, suggested_texts=["moved"])
    assert (folder / "suggested_model.toml").read_text() == "moved"
    write(folder, overwrite=True)
    assert not (folder / "suggested_model.toml").exists()
    assert (folder / "model.toml").read_text() == "model"
