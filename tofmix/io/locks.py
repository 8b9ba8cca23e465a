"""Disk of a run: its partial outputs, the lock of an output, and folders for unpacked data.

The partial files and folders of this process: which are removed when it dies, and which a later run continues.

One run an output: the temporary file that becomes the output is locked by the run that writes it.

The kernel drops the lock when the run ends, however it ends. So a second run is refused at once. A temporary file
without a lock belongs to a dead run and is removed. The name of a temporary file contains the machine. On a shared disk
no machine touches another's files, because locks may not work between machines.

A folder for unpacked data in the temporary folder; it is removed with the run, even if the run is killed.

A killed run cannot remove its own. As it is locked while its run lives, the next one that needs a folder removes it.
"""

import errno
import fcntl
import hashlib
import os
import platform
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tofmix.errors import StorageError, UsageError, os_error_text

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


_ENDING = ".tofmix-partial"
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
ATTEMPTS = 10
"""Attempts at a lock before the error."""


_cleared: set[Path] = set()

_begun: set[Path] = set()
"""Files that are about to be created and locked: the lock decides whether they belong to this process."""


@dataclass(frozen=True, slots=True)
class OutputLock:
    """A temporary file, open and locked: its path, its descriptor."""

    path: Path
    descriptor: int

    def is_there(self) -> bool:
        """Whether the path still leads to this file."""
        return _leads_to(self.path, self.descriptor)

    def release(self) -> None:
        """Remove the file and release the lock."""
        if self.is_there():
            self.path.unlink(missing_ok=True)
        os.close(self.descriptor)
        forget_partial_output(self.path)


_held: dict[Path, OutputLock] = {}
"""Locks of this process that no writer has taken yet, by output."""


def hold_lock(target: Path) -> None:
    """Lock an output for a writer of this process that comes later; raises as `lock_output` does."""
    _held[target] = lock_output(target)


def release_lock(target: Path) -> None:
    """Release a held lock, unless a writer has taken it."""
    lock = _held.pop(target, None)
    if lock is not None:
        lock.release()


def lock_output(target: Path) -> OutputLock:
    """Lock an output: its temporary file, new and empty; one that is held is handed over.

    Parameters
    ----------
    target : Path
        The output; no symbolic link.

    Raises
    ------
    UsageError
        If another run is writing it.
    StorageError
        If nothing can be created there.
    """
    if target in _held:
        return _held.pop(target)
    own = target.with_name(f".{target.name}.{_machine()}{_ENDING}")
    _begun.add(own)
    try:
        clear_folder(target.parent)
        lock = _lock(own) or _without_locks(target)
        note_partial_output(lock.path, resumable=False)
    except BlockingIOError as error:
        raise UsageError(f"{target}: another run is writing it; wait for its end, or choose another output") from error
    except OSError as error:
        raise StorageError(os_error_text(error, target)) from error
    finally:
        _begun.discard(own)
    return lock


def _discard_begun() -> None:
    """Remove files that a signal finds created, but not yet noted as ours; never one that another run has locked."""
    most_descriptors = 4096  # file descriptors that a signal handler checks: more than a process has by default
    for path in _begun:
        for descriptor in range(3, most_descriptors):
            try:
                if _leads_to(path, descriptor):
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    path.unlink()
            except OSError:
                continue  # no descriptor of that number, or another run's lock


on_discard(_discard_begun)


def _machine() -> str:
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _lock(path: Path) -> OutputLock | None:
    """Create and lock a file; None if the disk does not support locks. A file of a dead run is replaced."""
    pause_s = 0.02  # seconds between attempts; a run that clears a folder holds a lock for less
    for attempt in range(ATTEMPTS):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            if error.errno in _NO_LOCKS:
                path.unlink(missing_ok=True)  # nobody writes it: every run takes another name
                return None
            if attempt == ATTEMPTS - 1 or not isinstance(error, BlockingIOError):
                raise
            time.sleep(pause_s)
            continue
        if _leads_to(path, descriptor):
            if os.fstat(descriptor).st_size == 0:
                return OutputLock(path, descriptor)
            path.unlink()  # and not truncated: its content may have another name, too
        os.close(descriptor)
    raise BlockingIOError(errno.EAGAIN, "other runs lock it again and again; try again later")


def _without_locks(target: Path) -> OutputLock:
    """Create a file with a name of no other run; no run is refused, and files of dead runs stay."""
    path = target.with_name(f".{target.name}.{secrets.token_hex(6)}{_ENDING}")
    return OutputLock(path, os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666))


def _leads_to(path: Path, descriptor: int) -> bool:
    try:
        there = os.lstat(path)
    except OSError:
        return False
    opened = os.fstat(descriptor)
    return (there.st_dev, there.st_ino) == (opened.st_dev, opened.st_ino)


def clear_folder(folder: Path) -> None:
    """Remove the temporary files of dead runs of this machine and user from a folder of outputs, once a process."""
    folder = folder.absolute()
    if folder in _cleared:
        return
    _cleared.add(folder)
    ending = f".{_machine()}{_ENDING}"
    with os.scandir(folder) as entries:
        found = [entry for entry in entries if entry.name.startswith(".") and entry.name.endswith(ending)]
    for entry in found:
        _remove_if_dead(Path(entry.path))


def try_lock(descriptor: int) -> bool:
    """Lock an open file or folder; False if another run has it, or the disk does not support locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _remove_if_dead(path: Path) -> None:
    remove_unlocked(path, stat.S_ISREG, os.O_RDWR | os.O_NONBLOCK, lambda path: path.unlink(missing_ok=True))


def remove_unlocked(
    path: Path, is_kind: Callable[[int], bool], flags: int, remove: Callable[[Path], object], *, age_s: float = 0.0
) -> None:
    """Remove a file or a folder of this user that no run has locked.

    `is_kind` tells by its mode whether it is of the kind to remove, `flags` open it for locking, and it must be `age_s`
    seconds old, because its run may not have locked it yet.
    """
    try:
        status = path.lstat()
        ours = is_kind(status.st_mode) and status.st_uid == os.geteuid()
        if not ours or time.time() - status.st_ctime < age_s:
            return
        descriptor = os.open(path, flags | os.O_NOFOLLOW)
    except OSError:
        return  # gone meanwhile, or not ours
    try:
        if try_lock(descriptor) and _leads_to(path, descriptor):
            remove(path)
    finally:
        os.close(descriptor)


_PREFIX = "tofmix-scratch-"
YOUNG_S = 60.0
"""A folder may be this old and not locked yet."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder that is removed when the block ends, or the process."""
    root = Path(tempfile.gettempdir())
    _clear(root)
    try:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=root))
        note_partial_output(folder, resumable=False)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise StorageError(os_error_text(error, root)) from error
    try:
        try_lock(descriptor)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(descriptor)
        forget_partial_output(folder)


def _clear(root: Path) -> None:
    """Remove folders of dead runs of this user."""
    for folder in root.glob(f"{_PREFIX}*"):
        remove_unlocked(folder, stat.S_ISDIR, os.O_RDONLY | os.O_DIRECTORY, _remove, age_s=YOUNG_S)


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
