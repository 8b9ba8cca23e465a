"""Outputs that appear whole or not at all.

A new file is written under a temporary name in the same folder, synced, and renamed; `tofmix.io.locks` keeps
other runs from it meanwhile. HDF5 cannot bear a failing write (the library dies at exit once a write has failed), so it
writes through `Sink`, which remembers the first failure and swallows all that follows; `AtomicFile.commit` then raises
it in good order.

Several outputs that belong together: all whole, or none that is new.

Use it for files of moderate size that are made in memory, such as a map's image and the text that names it.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from tofmix.errors import BadInputError, StorageError, TofmixError, UsageError, os_error_text
from tofmix.io.locks import OutputLock, forget_partial_output, hold_lock, lock_output, note_partial_output, release_lock
from tofmix.wording import readable


class Sink:
    """File object over a descriptor, for h5py's "fileobj" driver; its writes never fail.

    After the first failed write, `error` holds it and nothing more reaches the disk.
    """

    def __init__(self, descriptor: int) -> None:
        self.error: OSError | None = None
        self._descriptor = descriptor
        self._position = 0
        self._end = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move as `io.IOBase.seek` does."""
        origin = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._end}[whence]
        self._position = origin + offset
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def write(self, data: bytes | memoryview) -> int:
        """Write all of `data` at the position, or store the first failure."""
        view = memoryview(data).cast("B")
        done = 0
        while self.error is None and done < len(view):
            try:
                done += os.pwrite(self._descriptor, view[done:], self._position + done)
            except OSError as error:
                self.error = error
        self._position += len(view)
        self._end = max(self._end, self._position)
        return len(view)

    def read(self, size: int = -1) -> bytes:
        """Return `size` bytes from the position, zeros past the end."""
        data = bytearray(self._end - self._position if size < 0 else size)
        self.readinto(data)
        return bytes(data)

    def readinto(self, buffer: bytearray | memoryview) -> int:
        """Fill `buffer` from the position, with zeros past the end."""
        view = memoryview(buffer).cast("B")
        data = os.pread(self._descriptor, len(view), self._position)
        view[: len(data)] = data
        view[len(data) :] = bytes(len(view) - len(data))
        self._position += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file, or store the first failure."""
        self._end = self._position if size is None else size
        if self.error is None:
            try:
                os.ftruncate(self._descriptor, self._end)
            except OSError as error:
                self.error = error
        return self._end

    def flush(self) -> None:
        """Do nothing: nothing is buffered here, and `AtomicFile.commit` syncs."""


class AtomicFile:
    """A new file that gets its name in one step when it is whole.

    Use it as a context manager: leaving the block without `commit` removes the
    temporary file and leaves an older file of that name as it was.

    Parameters
    ----------
    path : Path
        The final place.
    overwrite : bool
        Whether a file that is already there may be replaced.
    inputs : tuple of Path
        Files that must never be replaced, even with `overwrite`.
    temporary : Path, optional
        The temporary name, in the same folder, where only one process can use it; a file that a killed one left there
        is replaced. A name of its own without it.

    Raises
    ------
    UsageError
        If `path` exists and `overwrite` is false, `path` is one of `inputs`, or, when the block is entered, another
        run is writing it.
    StorageError
        If nothing can be created there; a folder without permission shows when the block is entered.
    """

    def __init__(
        self, path: Path, *, overwrite: bool, inputs: tuple[Path, ...] = (), temporary: Path | None = None
    ) -> None:
        self.path = path
        self._overwrite = overwrite
        check_output(path, overwrite=overwrite, inputs=inputs)
        # A link stays a link: its target is replaced.
        self._target = Path(os.path.realpath(path))
        self._temporary = temporary
        self._lock: OutputLock | None = None

    def __enter__(self) -> Self:
        if self._temporary is None:
            self._lock = lock_output(self._target)
        else:
            self._lock = self._anew(self._temporary)
        self.sink = Sink(self._lock.descriptor)
        return self

    def _anew(self, path: Path) -> OutputLock:
        note_partial_output(path, resumable=False)
        try:
            path.unlink(missing_ok=True)
            return OutputLock(path, os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666))
        except OSError as error:
            forget_partial_output(path)
            raise StorageError(os_error_text(error, self.path)) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.release()

    def check(self) -> None:
        """Raise the first failed write, so that a long job stops at once.

        Raises
        ------
        StorageError
            If a write has failed.
        """
        if self.sink.error is not None:
            raise StorageError(os_error_text(self.sink.error, self.path)) from self.sink.error

    def commit(self) -> None:
        """Sync the file, give it its name, and sync the folder.

        Raises
        ------
        StorageError
            If a write, the sync or the renaming failed; the old file then remains.
        UsageError
            If another program has made a file of that name meanwhile.
        """
        self.check()
        lock = self._lock
        if lock is None:
            raise RuntimeError("a file is committed once, inside its block")
        try:
            os.fsync(lock.descriptor)
            check_output(self.path, overwrite=self._overwrite)
            if not lock.is_there():
                raise StorageError(f"{self.path}: its temporary file {lock.path.name} is missing; nothing was written")
            lock.path.replace(self._target)
            sync_folder(self._target.parent)
        except OSError as error:
            raise StorageError(os_error_text(error, self.path)) from error


@contextmanager
def locked(*paths: Path, overwrite: bool, inputs: tuple[Path, ...] = ()) -> Iterator[None]:
    """Lock outputs before the work starts, so no other run can write them and a refusal comes at once.

    Those that the block writes, through `AtomicFile`, pass to the writer; the options are those of `AtomicFile`.
    """
    for path in paths:
        check_output(path, overwrite=overwrite, inputs=inputs)
    with ExitStack() as stack:
        for target in dict.fromkeys(Path(os.path.realpath(path)) for path in paths):
            hold_lock(target)
            stack.callback(release_lock, target)
        yield


def check_output(path: Path, *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Refuse an output that cannot or must not be written, before any work is done."""
    try:
        if any(path.exists() and other.exists() and path.samefile(other) for other in inputs):
            raise UsageError(f"{path} is the input; choose another output")
        if path.exists() and not path.is_file():
            raise StorageError(f"{path} exists and is not a regular file")
        if path.exists() and not overwrite:
            raise UsageError(f"{path} exists; pass --overwrite to replace it")
        if not path.parent.is_dir():
            raise StorageError(f"{path}: no such folder {path.parent}")
    except OSError as error:
        raise StorageError(os_error_text(error, path)) from error


def write_text(path: Path, text: str, *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Write a text file whole or not at all, in UTF-8; refusals as for `AtomicFile`.

    Bytes of a file's name that are no UTF-8 become the replacement character.
    """
    with AtomicFile(path, overwrite=overwrite, inputs=inputs) as file:
        file.sink.write(readable(text).encode())
        file.commit()


def check_input(path: Path) -> None:
    """Refuse an input that is no regular file: a pipe would be waited for without end."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise BadInputError(os_error_text(error, path)) from error
    if not stat.S_ISREG(mode):
        raise BadInputError(f"{path}: not a regular file")


def read_text(path: Path) -> str:
    """Read a UTF-8 text file."""
    check_input(path)
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInputError(os_error_text(error, path)) from error
    except UnicodeDecodeError as error:
        raise BadInputError(f"{path}: not a UTF-8 text file (byte {error.start})") from error


def sync_folder(folder: Path) -> None:
    """Make a renaming last through a power failure."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_atomic_group(contents: dict[Path, bytes], *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Write several files; each gets its name only when all are completely on disk.

    The files get their names in the order of `contents`: put one that names another after it. Should a renaming
    fail, files that did not exist before are removed again; one that was replaced by then stays replaced. The options
    are those of `tofmix.io.storage.AtomicFile`.
    """
    with ExitStack() as stack:
        files = [AtomicFile(path, overwrite=overwrite, inputs=inputs) for path in contents]
        for file, content in zip(files, contents.values(), strict=True):
            stack.enter_context(file)
            file.sink.write(content)
        for file in files:
            file.check()
        made: list[Path] = []
        for file in files:
            is_new = not file.path.exists()
            try:
                file.commit()
            except TofmixError:
                for path in made:
                    path.unlink(missing_ok=True)
                raise
            if is_new:
                made.append(file.path)
