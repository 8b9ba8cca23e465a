"""Files are looked at before they are read, by a process that may hang or crash; nothing else opens them."""

import ast
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.files import boards, write_recording
from support.modules import MODULES, PACKAGE, nodes

from tofmix.errors import BadInputError, StorageError
from tofmix.io.guard import guard
from tofmix.io.guard.guard import StructureChecker
from tofmix.io.recording.recording_file import open_recording

EVERYTHING = (slice(None), slice(None))


def _calls(module: Path) -> set[str]:
    """Dotted names of what a module calls."""
    calls = (node.func for node in nodes(module) if isinstance(node, ast.Call))
    return {ast.unparse(call) for call in calls}


def test_only_the_guard_opens_files_for_reading() -> None:
    openers = {"h5py.File", "h5py.h5f.open", "h5py.is_hdf5", "h5py.h5f.is_hdf5"}
    found = {str(path.relative_to(PACKAGE)): _calls(path) & openers for path in MODULES}
    # hdf5.py wraps a new file that it has created, hdf5_memory.py makes empty ones; the child is the one that looks.
    assert {name for name, calls in found.items() if calls} == {
        "io/guard/guard.py",
        "io/guard/structure_process.py",
        "io/hdf5.py",
        "io/guard/hdf5_memory.py",
    }
    source = (PACKAGE / "io/guard/hdf5_memory.py").read_text()
    assert source.count("h5py.File(") == source.count('h5py.File(io.BytesIO(), "w")') == 1
    source = (PACKAGE / "io/hdf5.py").read_text()
    assert source.count("h5py.File(") == source.count("h5py.File(h5py.h5f.create(") == 1


def _checker(program: str) -> StructureChecker:
    return StructureChecker((sys.executable, "-c", program))


def test_hanging_structure_check_ends_in_time_and_refuses_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOFMIX_READ_TIMEOUT", "0.2")
    monkeypatch.setattr("tofmix.io.guard.guard.GRACE_S", 0.1)
    checker = _checker("import sys, time; sys.stdin.readline(); time.sleep(100)")
    with pytest.raises(BadInputError, match=r"a\.h5: its structure could not be read within 0\.2 s; given up"):
        checker.check({}, tmp_path / "a.h5")


def test_checker_ends_itself_when_the_library_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The true program, with a library that never comes back: only the kernel can end it.
    monkeypatch.setenv("TOFMIX_READ_TIMEOUT", "0.3")
    program = (
        f"import sys; sys.path.append({str(PACKAGE.parent)!r})\n"
        "from tofmix.io.guard import structure_process\n"
        "def hang(*_):\n    while True:\n        pass\n"
        "structure_process.check_structure = hang\nstructure_process.main()\n"
    )
    checker, path = _checker(program), write_recording(tmp_path / "a.h5", boards())
    with pytest.raises(BadInputError, match=r"could not be read within 0\.3 s"):
        checker.check({"path": str(path)}, path)
    with pytest.raises(BadInputError, match=r"could not be read within"):  # and another one is started
        checker.check({"path": str(path)}, path)


def test_crashing_structure_check_refuses_the_file(tmp_path: Path) -> None:
    checker = _checker("import os, sys; sys.stdin.readline(); os.kill(os.getpid(), 11)")
    with pytest.raises(BadInputError, match="the HDF5 library crashed on it"):
        checker.check({}, tmp_path / "a.h5")
    with pytest.raises(StorageError, match="was killed"):
        _checker("import os, sys; sys.stdin.readline(); os.kill(os.getpid(), 9)").check({}, tmp_path / "a.h5")
    with pytest.raises(StorageError, match="ended with 3"):
        _checker("raise SystemExit(3)").check({}, tmp_path / "a.h5")
    with pytest.raises(StorageError, match="No such file"):
        StructureChecker(("/none/python",)).check({}, tmp_path / "a.h5")


def test_one_process_serves_many_files(tmp_path: Path) -> None:
    checker, path = StructureChecker(), write_recording(tmp_path / "a.h5", boards())
    identity = checker.check({"path": str(path)}, path)
    assert identity[2] == path.stat().st_size
    process = checker._process
    (tmp_path / "b.h5").write_text("no")
    with pytest.raises(BadInputError, match=r"b\.h5: not an HDF5 file"):
        checker.check({"path": str(tmp_path / "b.h5")}, tmp_path / "b.h5")
    assert checker.check({"path": str(path)}, path) == identity
    assert checker._process is process
    checker.close()
    checker.close()


def test_memory_of_the_structure_check_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    program = (
        f"import sys; sys.path.append({str(PACKAGE.parent)!r})\n"
        "from tofmix.io.guard import structure_process\n"
        "structure_process.check_structure = lambda *_: bytearray(3 << 30)\nstructure_process.main()\n"
    )
    write_recording(path, boards())
    checker = _checker(program)
    with pytest.raises(BadInputError, match="takes more memory"):
        checker.check({"path": str(path)}, path)
    checker.close()


def test_lack_of_memory_for_the_check_is_a_memory_error(tmp_path: Path) -> None:
    program = (
        f"import sys; sys.path.append({str(PACKAGE.parent)!r})\n"
        "from tofmix.io.guard import structure_process\n"
        "def none():\n    raise MemoryError\n"
        "structure_process.reserve_memory = none\nstructure_process.main()\n"
    )
    checker = _checker(program)
    with pytest.raises(MemoryError):
        checker.check({"path": str(write_recording(tmp_path / "a.h5", boards()))}, tmp_path / "a.h5")
    checker.close()


def test_a_file_that_changes_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards())

    def read() -> None:
        with open_recording(path) as source:
            source.read_range(*EVERYTHING)
            with path.open("ab") as file:
                file.write(b"more")

    with pytest.raises(BadInputError, match=r"a\.h5: the file changed during reading"):
        read()


def test_change_after_the_last_read_is_accepted(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards())
    with open_recording(path) as source:
        source.read_range(*EVERYTHING)
        source.verify_unchanged()
        path.write_bytes(b"")
    write_recording(path, boards())
    with open_recording(path) as source:
        path.write_bytes(b"")
        with pytest.raises(BadInputError, match="the file changed during reading"):
            source.verify_unchanged()
        source.verified = True  # or the end would say it once more


def test_a_file_that_is_replaced_is_read_as_it_was(tmp_path: Path) -> None:
    path, samples = tmp_path / "a.h5", boards()
    write_recording(path, samples)
    with open_recording(path) as source:
        before = source.sha256()
        write_recording(tmp_path / "b.h5", samples + 1).replace(path)
        np.testing.assert_array_equal(source.read_range(*EVERYTHING), samples)
        assert source.sha256() == before


def test_file_replaced_after_the_check_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_recording(tmp_path / "a.h5", boards())
    monkeypatch.setattr(StructureChecker, "check", lambda *_: [0, 0, 0, 0])
    with pytest.raises(BadInputError, match="the file was replaced between check and opening"), open_recording(path):
        pass


def test_file_image_in_memory_is_checked(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root["elsewhere"] = h5py.ExternalLink("/etc/passwd", "/x")
        root.attrs["x"] = 3
    with (
        pytest.raises(BadInputError, match=r"part: elsewhere: a link to another file; refused"),
        guard.open_image((tmp_path / "a.h5").read_bytes(), tmp_path / "part"),
    ):
        pass
    with pytest.raises(BadInputError, match="part"), guard.open_image(b"no", tmp_path / "part"):
        pass
