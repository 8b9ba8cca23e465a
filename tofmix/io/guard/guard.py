"""The one place where HDF5 files are opened for reading; each file is checked first.

`open_for_reading` first checks a file's structure in a separate process (`structure_process`, by the rules of
`structure_rules`); the library may hang or crash there without harm. Only then the file is opened here. The process
starts with the first file and serves all others.
"""

import atexit
import base64
import io
import json
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py

from tofmix.errors import BadInputError, StorageError, os_error_text
from tofmix.io.guard.hdf5_memory import reserve_memory
from tofmix.io.guard.structure_rules import BoundedDataset, library_reason
from tofmix.io.guard.watchdog import STRUCTURE_LIMIT_S, limit_s, watched
from tofmix.io.next_command import folder_fault, foreign_fault
from tofmix.io.storage import check_input

GRACE_S = 2.0  # s beyond the limit until the process is killed
_PROGRAM = (sys.executable, "-P", str(Path(__file__).with_name("structure_process.py")))

LIBRARY_FAULTS = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError)
"""Exceptions of h5py on damaged files; a name that is no UTF-8 is a ValueError."""


class StructureChecker:
    """The process that checks the structure of files first; `program` starts it."""

    def __init__(self, program: Sequence[str] = _PROGRAM) -> None:
        self._program = program
        self._process: subprocess.Popen[str] | None = None
        self._owner = 0
        self._lock = threading.Lock()

    def check(self, request: dict[str, Any], what: Path) -> list[int]:
        """Request one check; return the identity of the file: device, inode, size, time of the last change.

        Raises
        ------
        BadInputError
            If the file breaks a rule, or the library hangs or crashes on it.
        StorageError
            If the process cannot be started, or is killed.
        MemoryError
            If there is no memory to open any file in.
        """
        limit = limit_s(STRUCTURE_LIMIT_S)
        with self._lock:
            process = self._started(what)
            answer = _exchange(process, json.dumps(request | {"limit_s": limit}), limit + GRACE_S)
            if not answer:
                self._process = None
                raise _failure(_finish(process), what, limit)
        found = json.loads(answer)
        if "no_memory" in found:
            raise MemoryError
        if "refused" in found:
            raise BadInputError(f"{what}: {found['refused']}")
        return list(found["identity"])

    def _started(self, what: Path) -> "subprocess.Popen[str]":
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            pipe = subprocess.PIPE
            try:
                # In a separate session, so that Ctrl-C reaches only this process; the checker ends with its pipe.
                self._process = subprocess.Popen(  # noqa: S603  our own program
                    self._program,
                    stdin=pipe,
                    stdout=pipe,
                    stderr=subprocess.DEVNULL,
                    text=True,
                    start_new_session=True,
                    env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
                )
            except OSError as error:
                raise StorageError(f"{what}: {os_error_text(error, 'the structure checker')}") from error
            self._owner = os.getpid()
        return self._process

    def close(self) -> None:
        """End the process, if this one has started it."""
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            _finish(process)


def _failure(code: int | None, what: Path, limit: float) -> BadInputError | StorageError:
    """Error of a checker that ended by itself with a code, or had to be killed (None)."""
    if code is None or code == -signal.SIGALRM:
        text = f"its structure could not be read within {limit:g} s; given up, the file is damaged"
        return BadInputError(f"{what}: {text}")
    if code == -signal.SIGKILL:
        text = "the structure checker was killed, perhaps because memory ran out; close other programs"
        return StorageError(f"{what}: {text}")
    if code < 0:
        return BadInputError(f"{what}: cannot be read: the HDF5 library crashed on it; the file is damaged")
    return StorageError(f"{what}: the structure checker ended with {code}; please report it")


def _finish(process: "subprocess.Popen[str]") -> int | None:
    """Close the pipes, which ends the process; return its exit code, None if it had to be killed."""
    for pipe in (process.stdin, process.stdout):
        with suppress(OSError):  # data for a process that has ended
            if pipe is not None:
                pipe.close()
    try:
        return process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
    with suppress(subprocess.TimeoutExpired):  # one that waits for a dead disk cannot even be killed
        process.wait(GRACE_S)
    return None


def _exchange(process: "subprocess.Popen[str]", line: str, seconds: float) -> str:
    """Send a line and return the answer; an empty text if none comes in time."""
    assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018  for the type checker: pipes
    with suppress(OSError):
        process.stdin.write(line + "\n")
        process.stdin.flush()
        if select.select([process.stdout], [], [], seconds)[0]:
            return process.stdout.readline()
    return ""


_checker = StructureChecker()
atexit.register(_checker.close)


@contextmanager
def open_for_reading(path: Path, *, verified: Callable[[], bool] = lambda: False) -> Iterator[h5py.File]:
    """Open an HDF5 file, with one clear error for each way in which it can be unfit.

    At the end it must be unchanged, unless `verified` marks the data as valid and in use.
    """
    with watched(str(path)):
        if path.is_dir():
            raise BadInputError(folder_fault(path))
        check_input(path)
        fault = foreign_fault(path)
        if fault is not None and not h5py.is_hdf5(path):  # a MATLAB file may be HDF5
            raise BadInputError(fault)
        # Resolved here, for /dev/stdin and its like are other files in another process.
        seen = _checker.check({"path": os.path.realpath(path)}, path)
        file = _open(path)
    with file:
        if identity(file) != seen:
            raise BadInputError(f"{path}: the file was replaced between check and opening; try again")
        yield file
        if not verified():
            check_unchanged(file, seen, path)


def _open(path: Path) -> h5py.File:
    reserve_memory()
    try:
        return h5py.File(path, "r")
    except LIBRARY_FAULTS as error:
        if isinstance(error, OSError) and error.errno:
            raise BadInputError(os_error_text(error, path)) from error
        raise BadInputError(f"{path}: {library_reason(error)}") from error


@contextmanager
def open_image(image: bytes, path: Path) -> Iterator[h5py.File]:
    """Open a small HDF5 file in memory, which the file `path` holds; refused as by `open_for_reading`."""
    _checker.check({"image": base64.b64encode(image).decode()}, path)
    reserve_memory()
    with reading(path, "header"), h5py.File(io.BytesIO(image), "r") as root:
        yield root


def is_hdf5(path: Path) -> bool:
    """Whether a file begins as HDF5 does; a hanging disk is waited for no longer than for a read."""
    with watched(str(path)):
        return bool(h5py.is_hdf5(path))


def identity(file: h5py.File) -> list[int]:
    """Identity of an open file: device, inode, size, time of the last change."""
    status = os.fstat(file.id.get_vfd_handle())
    return [status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns]


def check_unchanged(file: h5py.File, seen: list[int], path: Path) -> None:
    """Refuse the data if the file was written to during reading."""
    if identity(file) != seen:
        raise BadInputError(f"{path}: the file changed during reading; try again when nothing writes to it")


@contextmanager
def reading(path: Path, name: str) -> Iterator[None]:
    """Turn errors of h5py during reading into one `BadInputError` that names the dataset, with a time limit."""
    try:
        with watched(f"{path}: {name}"):
            yield
    except LIBRARY_FAULTS as error:
        raise BadInputError(f"{path}: {name}: cannot be read: {library_reason(error)}") from error


def checked_dataset(group: h5py.Group, name: str, path: Path) -> h5py.Dataset:
    """Return the dataset `name`."""
    with reading(path, name):
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise BadInputError(f"{path}: {name}: a link to another file; refused")
        item = group.get(name)
    if item is None:
        raise BadInputError(f"{path}: no dataset {name}")
    if not isinstance(item, h5py.Dataset):
        raise BadInputError(f"{path}: {name}: expected a dataset, got a group")
    with reading(path, name):
        return BoundedDataset(item.id)
