"""Journals hold what was added, whatever happens to the process, and belong to one run at a time."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.io.layers.chunks import EncodedCell
from tofmix.io.layers.journal import Shard, files_of, journal_path, open_journal, open_part, remove_journal
from tofmix.layers import LAYER_FIELDS


def encoded(seed: int) -> EncodedCell:
    return EncodedCell((seed, 2, 3), tuple(bytes([seed, k]) * (100 * k) for k in range(len(LAYER_FIELDS))))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return journal_path(tmp_path / "a.layers.h5")


def test_reopened_journal_has_its_cells(path: Path) -> None:
    with open_journal(path, b"header") as journal:
        for k in (5, 2):
            journal.add(k, encoded(k))
    with open_journal(path, b"another") as journal:
        assert journal.header == b"header"
        assert journal.done() == {2: (2, 2, 3), 5: (5, 2, 3)}
        assert journal.cell(5) == encoded(5)
        with pytest.raises(KeyError):
            journal.cell(3)
        journal.remove()
    assert list(path.parent.iterdir()) == []


def test_a_killed_process_loses_nothing_that_was_added(path: Path) -> None:
    program = (
        "import os, signal, sys\nfrom pathlib import Path\n"
        "from tofmix.io.layers.chunks import EncodedCell\nfrom tofmix.io.layers.journal import open_journal\n"
        "journal = open_journal(Path(sys.argv[1]), b'header')\n"
        "for k in range(40):\n    journal.add(k, EncodedCell((k,), (bytes(50000),) * 14))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, path], check=False)
    assert done.returncode == -signal.SIGKILL
    with open_journal(path, b"header") as journal:
        assert sorted(journal.done()) == list(range(40))


def test_journal_is_open_in_one_process_at_a_time(path: Path) -> None:
    with open_journal(path, b"header"), pytest.raises(UsageError, match="another run is using it"):
        open_journal(path, b"header")
    open_journal(path, b"header").close()


def test_a_published_part_is_one_file(path: Path, tmp_path: Path) -> None:
    with open_journal(path, b"header", Shard(number=2, count=3)) as journal:
        journal.add(1, encoded(1))
        journal.publish(tmp_path / "a.part")
    assert [p.name for p in tmp_path.iterdir()] == ["a.part"]
    with open_part(tmp_path / "a.part") as part:
        assert (part.header, part.shard, part.cell(1)) == (b"header", Shard(number=2, count=3), encoded(1))


def test_a_part_that_cannot_be_published_keeps_its_cells(path: Path, tmp_path: Path) -> None:
    with open_journal(path, b"header") as journal:
        journal.add(1, encoded(1))
        with pytest.raises(StorageError, match="No such file"):
            journal.publish(tmp_path / "none" / "a.part")
        assert journal.has_cells
    with open_journal(path, b"header") as journal:
        assert journal.has_cells
        assert journal.cell(1) == encoded(1)


def test_published_part_leaves_no_sqlite_files(path: Path, tmp_path: Path) -> None:
    with open_journal(path, b"header") as journal:
        journal.add(1, encoded(1))
        path.with_name(path.name + "-journal").write_bytes(b"")  # what it could not remove
        journal.publish(tmp_path / "a.part")
    assert [p.name for p in tmp_path.iterdir()] == ["a.part"]


def test_shards_divide_the_cells() -> None:
    for total in (0, 1, 7, 100):
        for count in (1, 2, 3, 8):
            cells = [k for n in range(count) for k in Shard(number=n + 1, count=count).cells(total)]
            assert cells == list(range(total))


def test_damaged_journal_is_noticed(path: Path) -> None:
    with open_journal(path, b"header") as journal:
        journal.add(1, EncodedCell((1,), (b"needle in the hay" * 999,) * 14))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"needle", b"noodle", 1))
    with open_journal(path, b"header") as journal, pytest.raises(BadInputError, match="cell 1 is damaged"):
        journal.cell(1)


def test_other_files_are_refused_as_journal(path: Path) -> None:
    path.write_bytes(b"not a database, and long enough to be taken for one" * 99)
    with pytest.raises(BadInputError, match="not a journal"):
        open_journal(path, b"header")
    with pytest.raises(BadInputError, match="not a journal"), open_part(path):
        pass
    remove_journal(path)
    open_journal(path, b"header").close()


def test_empty_file_becomes_a_journal(path: Path) -> None:
    # A process killed while it made the journal leaves this.
    path.touch()
    with open_journal(path, b"header") as journal:
        assert journal.done() == {}


def test_a_missing_part_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="No such file"), open_part(tmp_path / "none.part"):
        pass


def test_a_folder_that_cannot_be_written_is_a_storage_error(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="unable to open"):
        open_journal(tmp_path / "none" / "journal", b"header")


def test_leftovers_of_a_lost_journal_are_not_read_by_a_new_one(path: Path) -> None:
    for other in files_of(path)[:-1]:
        other.write_bytes(b"stale")
    with open_journal(path, b"header") as journal:
        assert journal.done() == {}
        journal.remove()
    assert list(path.parent.iterdir()) == []
