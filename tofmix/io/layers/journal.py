"""Journals: the cells that an estimate has finished, kept until the layers file is whole.

An interrupted run is continued from its journal; a shard's part is a journal that holds all its cells. Each is one
SQLite database next to the output. A cell is in it completely or not at all, even if the process is killed. One process
has it at a time.
"""

import json
import os
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from tofmix.errors import BadInputError, StorageError, UsageError, os_error_text
from tofmix.io.layers.chunks import EncodedCell
from tofmix.io.locks import forget_partial_output, note_partial_output
from tofmix.io.storage import check_input, sync_folder

FORMAT = "tofmix-journal 2"

_SCHEMA = """
CREATE TABLE about (key TEXT PRIMARY KEY, value BLOB) WITHOUT ROWID;
CREATE TABLE cells (cell INTEGER PRIMARY KEY, tally TEXT, sizes TEXT, checksum INTEGER, chunks BLOB);
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """Part `number` of `count`, from 1."""

    number: int
    count: int

    def cells(self, total: int) -> range:
        """Numbers of its cells, of `total`."""
        return range(total * (self.number - 1) // self.count, total * self.number // self.count)


WHOLE = Shard(number=1, count=1)


class Journal:
    """An open journal; made by `open_journal` or `open_part`.

    `has_cells` is known even if the database is lost.
    """

    def __init__(self, path: Path, database: sqlite3.Connection, header: bytes, shard: Shard) -> None:
        self.path = path
        self.header = header
        self.shard = shard
        self.has_cells = False
        self._database = database

    def done(self) -> dict[int, tuple[int, ...]]:
        """Cells that are in, and the pixels of each by their number of surfaces."""
        with _faults(self.path):
            rows = self._database.execute("SELECT cell, tally FROM cells").fetchall()
        return {cell: tuple(json.loads(tally)) for cell, tally in rows}

    def add(self, cell: int, encoded: EncodedCell) -> None:
        """Add a finished cell; when this returns, killing the process does not lose it."""
        chunks = b"".join(encoded.chunks)
        sizes = json.dumps([len(chunk) for chunk in encoded.chunks])
        row = (cell, json.dumps(encoded.tally), sizes, zlib.crc32(chunks), chunks)
        with _faults(self.path), self._database:
            self._database.execute("INSERT INTO cells VALUES (?, ?, ?, ?, ?)", row)
        self.has_cells = True
        note_partial_output(*files_of(self.path), resumable=True)

    def cell(self, cell: int) -> EncodedCell:
        """Return a finished cell.

        Raises
        ------
        BadInputError
            If it is damaged.
        KeyError
            If it is not in.
        """
        with _faults(self.path):
            row = self._database.execute(
                "SELECT tally, sizes, checksum, chunks FROM cells WHERE cell = ?", (cell,)
            ).fetchone()
        if row is None:
            raise KeyError(cell)
        tally, sizes, checksum, data = row
        if zlib.crc32(data) != checksum:
            raise BadInputError(f"{self.path}: cell {cell} is damaged")
        return EncodedCell(tuple(json.loads(tally)), tuple(_split(data, json.loads(sizes))))

    def close(self) -> None:
        """Close it; its cells stay."""
        self._database.close()
        forget_partial_output(*files_of(self.path))

    def remove(self) -> None:
        """Close and delete it."""
        self.close()
        remove_journal(self.path)

    def publish(self, target: Path) -> None:
        """Give it its final name, as a shard's part."""
        with _faults(self.path):
            # Fetched to its end, because SQLite commits then, and reports failures.
            modes = self._database.execute("PRAGMA journal_mode = DELETE").fetchall()
            self._database.close()
        if modes != [("delete",)]:
            raise StorageError(f"{self.path}: SQLite cannot merge the journal into one file; --resume tries again")
        try:
            for path in _sqlite_files(self.path):
                path.unlink(missing_ok=True)  # SQLite says nothing where it fails in that
            descriptor = os.open(self.path, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            self.path.replace(target)
            sync_folder(target.parent)
        except OSError as error:
            raise StorageError(os_error_text(error, target)) from error
        forget_partial_output(*files_of(self.path))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def journal_path(output: Path) -> Path:
    """The journal of an output."""
    return output.with_name(f".{output.name}.journal")


def files_of(journal: Path) -> tuple[Path, ...]:
    """All files that a journal may consist of, and the unfinished output of its run."""
    return partial_path(journal), *_sqlite_files(journal), journal


def _sqlite_files(journal: Path) -> tuple[Path, ...]:
    """Files that SQLite keeps next to an open database."""
    return tuple(journal.with_name(journal.name + end) for end in ("-wal", "-shm", "-journal"))


def partial_path(journal: Path) -> Path:
    """The temporary name of an output: the journal's lock keeps it for one run, and the next one finds it."""
    return journal.with_name(journal.name + ".partial")


def remove_journal(journal: Path) -> None:
    """Delete a journal that no process has open."""
    try:
        for path in files_of(journal):
            path.unlink(missing_ok=True)
    except OSError as error:
        raise StorageError(os_error_text(error, journal)) from error


def open_journal(path: Path, header: bytes, shard: Shard = WHOLE) -> Journal:
    """Open the journal of a run at a `journal_path`, or make it with the header of the run and the part that it makes.

    Its header and shard are those in the file, which may differ from the given ones.

    Raises
    ------
    UsageError
        If another process has it open, or the file is not a journal.
    StorageError
        If it cannot be made.
    """
    is_new = not path.exists()
    if is_new:
        remove_journal(path)  # files of SQLite without their journal
        note_partial_output(*files_of(path), resumable=False)
    with _faults(path):
        database = sqlite3.connect(path, timeout=0.0, check_same_thread=False)
        try:
            return _begin(path, database, header, shard)
        except BaseException as error:
            database.close()
            if is_new and _is_full(error):
                remove_journal(path)
            forget_partial_output(*files_of(path))
            raise


def _is_full(error: BaseException) -> bool:
    """Whether the disk is at fault, and not another run that has the journal."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)


def _begin(path: Path, database: sqlite3.Connection, header: bytes, shard: Shard) -> Journal:
    # One process at a time, and no shared memory file, which network file systems do not bear.
    database.execute("PRAGMA locking_mode = EXCLUSIVE")
    page_bytes = 16384  # of SQLite: cells of many kB lie in few pages
    database.execute(f"PRAGMA page_size = {page_bytes}")
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = NORMAL")
    database.execute("BEGIN EXCLUSIVE")
    if not database.execute("SELECT name FROM sqlite_master WHERE name = 'about'").fetchall():
        for statement in _SCHEMA.strip().split("\n"):
            database.execute(statement)
        about = {"format": FORMAT, "header": header, "shard": shard.number, "shards": shard.count}
        database.executemany("INSERT INTO about VALUES (?, ?)", about.items())
    database.execute("COMMIT")
    journal = _opened(path, database)
    journal.has_cells = bool(journal.done())
    if journal.has_cells:
        note_partial_output(*files_of(path), resumable=True)
    return journal


@contextmanager
def open_part(path: Path) -> Iterator[Journal]:
    """Open a shard's part for reading.

    Raises
    ------
    BadInputError
        If it is missing, or no part.
    """
    check_input(path)
    with _faults(path, error_type=BadInputError):
        database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            part = _opened(path, database)
        except BaseException:
            database.close()
            raise
    with part:
        yield part


def _opened(path: Path, database: sqlite3.Connection) -> Journal:
    about = dict(database.execute("SELECT key, value FROM about").fetchall())
    if about.get("format") != FORMAT:
        raise sqlite3.DatabaseError("of another version")
    return Journal(path, database, about["header"], Shard(number=about["shard"], count=about["shards"]))


def _split(data: bytes, sizes: list[int]) -> Iterator[bytes]:
    start = 0
    for size in sizes:
        yield data[start : start + size]
        start += size


@contextmanager
def _faults(path: Path, error_type: type[BadInputError] | type[StorageError] = StorageError) -> Iterator[None]:
    """Turn SQLite's faults into ours, of one line."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            raise UsageError(f"{path}: another run is using it; wait for its end, or choose another output") from error
        if "no such table" in str(error):
            raise BadInputError(f"{path}: not a journal of tofmix") from error
        raise error_type(f"{path}: {error}") from error
    except sqlite3.DatabaseError as error:
        raise BadInputError(f"{path}: not a journal of this version of tofmix, or damaged ({error})") from error
