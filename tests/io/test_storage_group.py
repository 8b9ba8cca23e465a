from pathlib import Path

import pytest

from tofmix.errors import StorageError, UsageError
from tofmix.io.storage import AtomicFile, write_atomic_group


def test_atomic_group_writes_all_files(tmp_path: Path) -> None:
    write_atomic_group({tmp_path / "a": b"1", tmp_path / "b": b"2"}, overwrite=False)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"1", "b": b"2"}


def test_existing_file_keeps_all_files_back(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"old")
    with pytest.raises(UsageError, match="--overwrite"):
        write_atomic_group({tmp_path / "a": b"1", tmp_path / "b": b"2"}, overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["b"]
    write_atomic_group({tmp_path / "a": b"1", tmp_path / "b": b"2"}, overwrite=True)
    assert (tmp_path / "b").read_bytes() == b"2"


@pytest.mark.parametrize("fails_at", [1, 2, 3])
def test_failed_renaming_leaves_no_new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails_at: int) -> None:
    commits = []
    commit = AtomicFile.commit

    def failing(self: AtomicFile) -> None:
        commits.append(self)
        if len(commits) == fails_at:
            raise StorageError("disk gone")
        commit(self)

    monkeypatch.setattr(AtomicFile, "commit", failing)
    with pytest.raises(StorageError, match="disk gone"):
        write_atomic_group({tmp_path / name: b"1" for name in "abc"}, overwrite=False)
    assert list(tmp_path.iterdir()) == []


def test_failed_write_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.pwrite", full)
    with pytest.raises(StorageError, match="No space left"):
        write_atomic_group({tmp_path / "a": b"1", tmp_path / "b": b"2"}, overwrite=False)
    assert list(tmp_path.iterdir()) == []
