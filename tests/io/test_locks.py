"""One run an output; what dead runs left is removed, and nothing else."""

import errno
import fcntl
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tofmix.errors import StorageError, UsageError
from tofmix.io import locks
from tofmix.io.locks import discard_partial_outputs
from tofmix.io.storage import AtomicFile, locked, write_text

WRITER = """
import sys, time
from pathlib import Path
from tofmix.io.storage import AtomicFile
with AtomicFile(Path(sys.argv[1]), overwrite=True) as file:
    file.sink.write(b"half")
    print("writing", flush=True)
    sys.stdin.readline()
    file.commit()
"""


@contextmanager
def another_run(path: Path) -> Iterator["subprocess.Popen[str]"]:
    """A process that is writing `path`."""
    program = [sys.executable, "-c", WRITER, str(path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(program, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        yield process
        process.kill()


@pytest.fixture(autouse=True)
def _few_attempts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "ATTEMPTS", 2)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_second_run_is_refused_at_once_and_the_first_continues(tmp_path: Path) -> None:
    path = tmp_path / "out.h5"
    with another_run(path) as first:
        for overwrite in (False, True):
            with pytest.raises(UsageError, match=r"out\.h5: another run is writing it; wait for its end"):
                write_text(path, "second", overwrite=overwrite)
            with pytest.raises(UsageError, match="another run"), locked(path, overwrite=overwrite):
                pass
        write_text(tmp_path / "other.h5", "other", overwrite=False)
        first.communicate("go on\n")
        assert first.returncode == 0
    assert path.read_text() == "half"
    assert names(tmp_path) == ["other.h5", "out.h5"]


def test_temporary_file_of_killed_run_does_not_block_the_output(tmp_path: Path) -> None:
    path = tmp_path / "out.h5"
    locks.clear_folder(tmp_path)  # once a process: what dies there later stays
    with another_run(path) as first:
        first.send_signal(signal.SIGKILL)
        first.wait()
    (stray,) = tmp_path.iterdir()
    os.link(stray, tmp_path / "linked")  # what has another name keeps its content
    write_text(path, "whole", overwrite=False)
    assert names(tmp_path) == ["linked", "out.h5"]
    assert path.read_text() == "whole"
    assert (tmp_path / "linked").read_text() == "half"


def test_files_of_users_and_of_other_machines_stay(tmp_path: Path) -> None:
    machine = locks._machine()
    kept = ["a.h5", ".a.h5.partial", ".a.h5.00000000.tofmix-partial", f"a.{machine}.tofmix-partial", ".a.h5.journal"]
    for name in kept:
        (tmp_path / name).write_text("mine")
    (tmp_path / f".folder.{machine}.tofmix-partial").mkdir()
    (tmp_path / f".link.{machine}.tofmix-partial").symlink_to(tmp_path / "a.h5")
    before = names(tmp_path)
    locks.clear_folder(tmp_path)
    assert names(tmp_path) == before
    with pytest.raises(StorageError):  # a link in the temporary file's place leads nowhere
        write_text(tmp_path / "link", "x", overwrite=True)
    assert (tmp_path / "a.h5").read_text() == "mine"


def test_files_of_another_user_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stray = tmp_path / f".a.{locks._machine()}.tofmix-partial"
    stray.write_text("theirs")
    monkeypatch.setattr(os, "geteuid", lambda: stray.stat().st_uid + 1)
    locks.clear_folder(tmp_path)
    assert stray.exists()


def test_disk_without_locks_refuses_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    path = tmp_path / "a"
    with AtomicFile(path, overwrite=True) as first, AtomicFile(path, overwrite=True) as second:
        first.sink.write(b"first")
        second.sink.write(b"second")
        first.commit()
        second.commit()
    assert path.read_text() == "second"
    assert names(tmp_path) == ["a"]


def test_a_lock_passes_to_the_writer(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with locked(path, tmp_path / "b", path, overwrite=False):
        assert len(names(tmp_path)) == 2
        write_text(path, "text", overwrite=False)
    assert names(tmp_path) == ["a"]
    with pytest.raises(KeyError), locked(tmp_path / "c", overwrite=False):
        raise KeyError
    assert names(tmp_path) == ["a"]


def test_signal_after_the_creation_of_a_file_removes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.open

    def stopped(*arguments: Any) -> int:  # noqa: ANN401  what os.open takes
        descriptor = real(*arguments)
        discard_partial_outputs()  # as the handler does, before anybody has noted the descriptor
        return descriptor

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", stopped)
        patch.setattr(locks, "_lock", lambda path: os.open(path, os.O_RDWR | os.O_CREAT) and pytest.fail("gone on"))
        with pytest.raises(pytest.fail.Exception, match="gone on"):
            locks.lock_output(tmp_path / "a")
    assert names(tmp_path) == []


def test_a_signal_while_another_run_is_met_leaves_that_run_alone(tmp_path: Path) -> None:
    path = tmp_path / "out.h5"
    with another_run(path) as first:
        before = names(tmp_path)
        locks._begun.add(tmp_path / before[0])
        descriptor = os.open(tmp_path / before[0], os.O_RDWR)
        discard_partial_outputs()
        os.close(descriptor)
        locks._begun.clear()
        assert names(tmp_path) == before
        first.communicate("go on\n")
    assert path.read_text() == "half"


def test_output_with_a_missing_temporary_file_gets_no_name(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with AtomicFile(path, overwrite=False) as file:
        (temporary,) = tmp_path.iterdir()
        temporary.unlink()
        temporary.write_text("another's")
        with pytest.raises(StorageError, match=r"its temporary file .* is missing"):
            file.commit()
    assert names(tmp_path) == [temporary.name]
    assert temporary.read_text() == "another's"


def test_temporary_file_of_killed_run_is_removed(tmp_path: Path) -> None:
    with another_run(tmp_path / "out.h5") as first:
        first.send_signal(signal.SIGKILL)
        first.wait()
    (stray,) = tmp_path.iterdir()
    assert stray.read_text() == "half"
    write_text(tmp_path / "other.h5", "other", overwrite=False)
    assert names(tmp_path) == ["other.h5"]
