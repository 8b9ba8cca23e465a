"""Folders of dead runs go; those of live runs, young ones and what is not ours stay."""

import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tofmix.errors import StorageError
from tofmix.io import locks as module
from tofmix.io.locks import discard_partial_outputs, scratch_folder

HOLDER = """
import sys, tempfile
tempfile.tempdir = sys.argv[1]
from tofmix.io.locks import scratch_folder
with scratch_folder() as folder:
    (folder / "big").write_text("data")
    print(folder, flush=True)
    sys.stdin.readline()
"""


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(module, "YOUNG_S", 0.0)


def test_scratch_folder_is_removed_at_exit(tmp_path: Path) -> None:
    with scratch_folder() as folder:
        (folder / "a").write_text("x")
        assert folder.parent == tmp_path
    assert list(tmp_path.iterdir()) == []


def test_scratch_folder_is_removed_after_sigterm(tmp_path: Path) -> None:
    with scratch_folder() as folder:
        (folder / "a").write_text("x")
        discard_partial_outputs()
        assert list(tmp_path.iterdir()) == []


def test_folder_of_a_killed_run_is_removed_and_of_a_live_run_kept(tmp_path: Path) -> None:
    program = [sys.executable, "-c", HOLDER, str(tmp_path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(program, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        theirs = Path(process.stdout.readline().strip())
        with scratch_folder():
            assert (theirs / "big").exists()
        process.send_signal(signal.SIGKILL)
    assert theirs.exists()
    (tmp_path / "tofmix-scratch-file").write_text("a user's")
    (tmp_path / "tofmix-scratch-link").symlink_to(tmp_path)
    with scratch_folder():
        assert not theirs.exists()
    assert len(list(tmp_path.iterdir())) == 2


def test_young_folder_without_a_lock_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "YOUNG_S", 60.0)
    (tmp_path / "tofmix-scratch-new").mkdir()
    with scratch_folder():
        assert (tmp_path / "tofmix-scratch-new").exists()


def test_full_disk_is_a_storage_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/none")
    with pytest.raises(StorageError, match="/none: No such file"), scratch_folder():
        pass
