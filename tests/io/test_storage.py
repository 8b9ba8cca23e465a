"""Outputs, groups of them and folders appear whole or not at all, whatever fails."""

import errno
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.full_disk import FullDisk

from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.io import hdf5
from tofmix.io.guard import guard
from tofmix.io.reconciliation import locked_folder, write_folder
from tofmix.io.storage import AtomicFile, Sink, check_output, read_text, write_atomic_group, write_text


def test_text_is_written_and_read_back(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "sigma = 3 µm\n", overwrite=False)
    assert read_text(tmp_path / "a.txt") == "sigma = 3 µm\n"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with AtomicFile(path, overwrite=False) as file:
        path.write_text("another program's")
        with pytest.raises(UsageError, match="exists"):
            file.commit()
    assert [p.read_text() for p in tmp_path.iterdir()] == ["another program's"]


def test_an_input_is_never_the_output_and_a_link_stays_a_link(tmp_path: Path) -> None:
    path, link = tmp_path / "a.h5", tmp_path / "link.h5"
    path.write_text("data")
    link.symlink_to(path)
    with pytest.raises(UsageError, match="is the input"):
        check_output(link, overwrite=True, inputs=(path,))
    target, link = tmp_path / "real.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    write_text(link, "new", overwrite=True)
    assert link.is_symlink()
    assert target.read_text() == "new"


@pytest.mark.parametrize("name", ["folder", "none/a.txt", "/dev/null", "text/a.txt"])
def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "text").write_text("")
    with pytest.raises(StorageError):
        check_output(tmp_path / name, overwrite=True)


@pytest.mark.parametrize("call", ["os.pwrite", "os.fsync", "pathlib.Path.replace"])
def test_each_failing_call_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(call, fail)
    with pytest.raises(StorageError, match=r"a\.txt: No space left"):
        write_text(path, "new", overwrite=True)
    monkeypatch.undo()
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


def test_hdf5_survives_every_possible_failing_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Fail at the n-th write for n = 0, 1, ... until the run succeeds: HDF5 must never see it.
    disk = FullDisk(0)
    monkeypatch.setattr("os.pwrite", disk)
    for allowed in range(200):
        disk.left = allowed
        with AtomicFile(tmp_path / "a.h5", overwrite=True) as file:
            with h5py.File(file.sink, "w") as root:
                for k in range(5):
                    root.create_dataset(f"d{k}", data=np.arange(5000), chunks=(1000,), compression="gzip")
            if file.sink.error is None:
                file.commit()
                break
            with pytest.raises(StorageError, match="No space left"):
                file.check()
        assert list(tmp_path.iterdir()) == []
    else:
        pytest.fail("it never succeeded")
    assert allowed > 3
    with h5py.File(tmp_path / "a.h5") as root:
        np.testing.assert_array_equal(root["d4"][...], np.arange(5000))


def test_the_sink_behaves_as_a_file(tmp_path: Path) -> None:
    descriptor = os.open(tmp_path / "x", os.O_RDWR | os.O_CREAT)
    sink = Sink(descriptor)
    assert sink.write(b"hello world") == 11
    assert sink.seek(-5, os.SEEK_END) == 6
    assert sink.read(5) == b"world"
    assert sink.tell() == 11
    sink.seek(3)
    assert sink.truncate() == 3
    sink.seek(0)
    buffer = bytearray(b"xxxxx")
    assert sink.readinto(buffer) == 5
    assert buffer == b"hel\0\0"
    sink.seek(-3, os.SEEK_CUR)
    assert sink.read() == b"l"
    sink.flush()
    os.close(descriptor)
    assert sink.truncate(1) == 1
    assert isinstance(sink.error, OSError)


def test_texts_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b"name = \xe9")
    with pytest.raises(BadInputError, match="not a UTF-8 text file"):
        read_text(tmp_path / "latin.toml")
    with pytest.raises(BadInputError, match="No such file"):
        read_text(tmp_path / "none.toml")


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


def test_a_reason_is_one_short_line() -> None:
    with (
        pytest.raises(BadInputError, match=r"^a\.h5: range: cannot be read: wrong checksum$"),
        guard.reading(Path("a.h5"), "range"),
    ):
        raise OSError("Can't synchronously read data\n (wrong checksum)")


def test_text_attributes_of_either_kind_are_read(tmp_path: Path) -> None:
    import numpy as np

    with h5py.File(tmp_path / "a.h5", "w") as root:
        root.attrs["variable"] = "text"
        root.attrs["fixed"] = np.bytes_(b"text")
        root.attrs["list"] = ["text"]
        root.attrs["number"] = 3
        for key in ("variable", "fixed", "list"):
            assert hdf5.text_attribute(root, key) == "text"
        assert hdf5.text_attribute(root, "number") is None
        assert hdf5.text_attribute(root, "none") is None
