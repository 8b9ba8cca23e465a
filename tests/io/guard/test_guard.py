"""Files are looked at before they are read, by a process that may hang or crash; each rule refuses by name."""

import ast
import ctypes
import io
import subprocess
import sys
import zlib
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.files import boards, write_recording
from support.measured import coverage_environment
from support.modules import MODULES, PACKAGE, nodes

from tofmix.errors import BadInputError, ExitCode, StorageError
from tofmix.io.guard import guard, structure_rules
from tofmix.io.guard.guard import StructureChecker
from tofmix.io.guard.hdf5_memory import reserve_memory
from tofmix.io.guard.structure_rules import LIMITS, RefusedError, check_structure
from tofmix.io.guard.watchdog import limit_s
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


EATS_ALL = """
import resource, sys
from pathlib import Path
from tofmix.io.guard import guard
from tofmix.io.hdf5 import image_of
path = Path("a.h5")
if {before}:
    image_of(lambda root: None)
pages = int(Path("/proc/self/statm").read_text().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (48 << 20),) * 2)
eaten = []
try:
    while True:
        eaten.append(bytearray({piece}))
except MemoryError:
    del eaten[:{freed}]
try:
    if {image}:
        image_of(lambda root: None)
    else:
        guard._open(path).close()
except MemoryError:
    sys.exit(10)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's here")
@pytest.mark.parametrize("image", [False, True])
@pytest.mark.parametrize(
    ("before", "piece", "freed", "code"),
    [(False, 4096, 0, 10), (True, 65_536, 0, 10), (True, 300_000, 1, 10), (False, 1_000_000, 16, 0)],
)
def test_no_memory_is_an_exception_and_no_signal(
    tmp_path: Path, *, image: bool, before: bool, piece: int, freed: int, code: int
) -> None:
    write_recording(tmp_path / "a.h5", boards(5, 3, 4))
    program = EATS_ALL.format(before=before, piece=piece, freed=freed, image=image)
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr


def test_caches_of_closed_files_are_kept_for_the_next() -> None:
    """What an opening takes, half a MB, is there beforehand, of three files at once."""
    sizes = ctypes.PyDLL(h5py.h5.__file__).H5get_free_list_sizes

    def structures() -> int:
        found = [ctypes.c_size_t() for _ in range(4)]
        assert sizes(*map(ctypes.byref, found)) >= 0
        return found[0].value

    with ExitStack() as stack:
        for _ in range(6):
            reserve_memory()
            before = structures()
            stack.enter_context(h5py.File(io.BytesIO(), "w"))
            assert structures() - before < 100_000
        after = structures()
    assert structures() > after - 100_000
    reserve_memory()
    assert structures() < after + 100_000


Change = Callable[[h5py.File], object]


def _dataset(shape: tuple[int, ...], **settings: object) -> Change:
    return lambda root: root.create_dataset("x", shape, **({"dtype": "u2"} | settings))


def _external(root: h5py.File) -> None:
    root["sensor/x"] = h5py.ExternalLink("other.h5", "/x")


def _numbers(root: h5py.File) -> None:
    root.attrs["x"] = np.zeros(50)


def _virtual(root: h5py.File) -> None:
    layout = h5py.VirtualLayout((4,), "u2")
    layout[:] = h5py.VirtualSource("other.h5", "range", (4,))
    root.create_virtual_dataset("group/x", layout)


def _texts(root: h5py.File) -> None:
    root["sensor"].attrs.create("x", "a" * 5000)


def _many(root: h5py.File) -> None:
    for number in range(30):
        root[f"link{number}"] = h5py.SoftLink("/range")


def _attributes(root: h5py.File) -> None:
    for number in range(30):
        root["range"].attrs[f"a{number}"] = number


def _unknown_filter(root: h5py.File) -> None:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((4,))
    plist.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, (1,))
    h5py.h5d.create(root.id, b"x", h5py.h5t.NATIVE_UINT16, h5py.h5s.create_simple((4,)), plist)


def _filtered(*filters: tuple[int, tuple[int, ...]]) -> Change:
    def change(root: h5py.File) -> None:
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((4,))
        for code, values in filters:
            plist.set_filter(code, h5py.h5z.FLAG_OPTIONAL, values)
        h5py.h5d.create(root.id, b"x", h5py.h5t.NATIVE_UINT16, h5py.h5s.create_simple((4,)), plist)

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_filtered((1, (1,)), (1, (1,))), "x: compressed by gzip and then by another filter"),
        (_filtered((1, (1,)), (32000, ())), "x: compressed by gzip and then by another filter"),
        (_dataset((9_000_000,), chunks=(9_000_000,), compression="lzf"), "x: one lzf chunk is over 16.78"),
        (_external, "sensor/x: a link to another file"),
        (_virtual, "group/x: its data lie in another file"),
        (_dataset((4,), external=[("/etc/passwd", 0, 8)]), "x: its data lie in another file"),
        (_unknown_filter, "x: filter 32001 is not one of gzip"),
        (_dataset((1,) * 9), "x: 9 dimensions; at most 8"),
        (_dataset((1 << 30, 1 << 30), chunks=(1, 4)), r"x: shape .* takes 2.306e\+06 TB; at most 17.59 TB"),
        (_dataset((10_000_000, 4, 4), chunks=(1000, 4, 4)), r"declares 320 MB, the file holds .* bytes; refused"),
        (
            _dataset((10, 144, 176), chunks=(30_000, 144, 176), maxshape=(None, 144, 176)),
            "x: one chunk .* takes 1.521 GB; at most 268.4 MB",
        ),
        (_dataset((1 << 25,), chunks=(1,), dtype="u1"), "x: 33554432 chunks of 1 bytes"),
        (_dataset((1,), dtype="S2000000"), "x: one value takes 2 MB"),
    ],
)
def test_excessive_header_values_are_refused_at_any_depth(tmp_path: Path, change: Change, reason: str) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with open_recording(path):
        pass
    with h5py.File(path, "r+") as root:
        change(root)
    with pytest.raises(BadInputError, match=reason) as caught, open_recording(path):
        pass
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("change", "bound", "reason"),
    [
        (_many, "objects", "more than 20 objects"),
        (_attributes, "attributes", "range: 30 attributes; at most 20"),
        (_texts, "attribute_bytes", "sensor: attribute x takes 5000 bytes"),
        (_numbers, "attribute_bytes", "the file: attribute x takes 400 bytes"),
        (lambda root: root.attrs.create("x", ["a" * 30] * 5), "attribute_bytes", "attribute x takes 150 bytes"),
    ],
)
def test_counts_and_attributes_are_bounded(tmp_path: Path, change: Change, bound: str, reason: str) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with h5py.File(path, "r+") as root:
        change(root)
    with h5py.File(path) as root:
        check_structure(root, path.stat().st_size)
        limits = replace(LIMITS, **{bound: 130 if "bytes" in bound else 20})
        with pytest.raises(RefusedError, match=reason):
            check_structure(root, path.stat().st_size, limits)


def test_chunks_outside_of_the_file_are_refused(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "r.h5", boards(200, 16, 20), chunks=(7, 3, 4), compression="gzip")
    with h5py.File(path) as root, pytest.raises(RefusedError, match="range: its index of chunks is damaged"):
        check_structure(root, 5000)


def test_extra_objects_of_foreign_files_are_accepted(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "r.h5", boards())
    with h5py.File(path, "r+") as root:
        root["texts"] = ["a", "b"]
        root["empty"] = h5py.Empty("f4")
        root["type"] = np.dtype("f4")
        root["loop"] = h5py.SoftLink("/loop")
        root["nowhere"] = h5py.SoftLink("/none")
        root["again"] = root["sensor"]
        root["sensor/up"] = root
        root.attrs["empty"] = h5py.Empty("f4")
        root.create_dataset("growing", (0, 3), maxshape=(None, 3), dtype="f4")
        root.create_dataset("record", (2,), dtype=[("a", "f4"), ("b", h5py.ref_dtype)])
    with open_recording(path) as recording:
        assert recording.shape == (30, 4, 6)


def bomb(path: Path, unpacked: int, *, fletcher32: bool = False) -> Path:
    """A recording with a chunk that declares 1.2 kB and unpacks to more."""
    write_recording(path, boards(50), chunks=(25, 4, 6), compression="gzip", fletcher32=fletcher32)
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(bytes(1 << 20)) for _ in range(unpacked >> 20)) + packer.flush()
    with h5py.File(path, "r+") as root:
        root["range"].id.write_direct_chunk((25, 0, 0), data)
    return path


@pytest.fixture
def _every_chunk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structure_rules, "UNCHECKED_BYTES", 0)


@pytest.mark.usefixtures("_every_chunk")
def test_chunk_over_its_declared_size_is_refused_and_its_neighbours_are_read(tmp_path: Path) -> None:
    with open_recording(bomb(tmp_path / "a.h5", 3 << 20)) as recording:
        np.testing.assert_array_equal(recording.read_range(slice(0, 25), slice(None)), boards(50)[:25])
        with pytest.raises(BadInputError, match=r"range: .*chunk at \(25, 0, 0\) unpacks to more than the 1200 bytes"):
            recording.read_range(*EVERYTHING)


@pytest.mark.slow
def test_memory_of_unpacking_stays_small(tmp_path: Path) -> None:
    # 600 MB from a chunk that declares 0.9 MB.
    path = tmp_path / "a.h5"
    samples = np.zeros((300, 24, 60), "u2")
    write_recording(path, samples, chunks=samples.shape, compression="gzip")
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(bytes(1 << 20)) for _ in range(600)) + packer.flush()
    with h5py.File(path, "r+") as root:
        root["range"].id.write_direct_chunk((0, 0, 0), data)
    program = (
        "import sys\nfrom pathlib import Path\nfrom tofmix.errors import BadInputError\n"
        "from tofmix.io.recording.recording_file import open_recording\n"
        "try:\n    with open_recording(Path(sys.argv[1])) as r:\n        r.read_range(slice(None), slice(None))\n"
        "except BadInputError as error:\n    print(error)\n"
        "status = Path('/proc/self/status').read_text()\nprint(status.split('VmHWM:')[1].split()[0])\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True)
    said, peak_kb = done.stdout.splitlines()
    assert "unpacks to more than the 864000 bytes that it declares" in said
    assert int(peak_kb) < 250_000


@pytest.mark.usefixtures("_every_chunk")
@pytest.mark.parametrize("settings", [{}, {"fletcher32": True}, {"shuffle": True, "fletcher32": True}])
def test_valid_chunks_are_read_in_every_way(tmp_path: Path, settings: dict[str, Any]) -> None:
    samples = boards(40, 10)
    path = write_recording(tmp_path / "a.h5", samples, chunks=(7, 3, 4), compression="gzip", **settings)
    with h5py.File(path) as root:
        dataset = structure_rules.BoundedDataset(root["range"].id)
        parts = (
            (),
            ...,
            3,
            -1,
            slice(5, 30),
            (slice(None), 2),
            (..., 5),
            (slice(0, 40, 7), slice(3, 9)),
            (slice(9, 9),),
            ([1, 5],),
            (0, ..., slice(2, 3)),
            (np.int64(4), -2),
        )
        for part in parts:
            np.testing.assert_array_equal(dataset[part], samples[part])


PROGRAM = """
import sys, time
from pathlib import Path
from tofmix.io.storage import AtomicFile
from tofmix.io.guard.watchdog import arm, watched
arm()
arm()
with AtomicFile(Path(sys.argv[1]) / "out", overwrite=False), watched("a.h5: range"):
    time.sleep(100)
"""


def test_a_read_that_hangs_ends_the_program(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={"TOFMIX_READ_TIMEOUT": "0.3", "PYTHONPATH": ":".join(sys.path)} | coverage_environment(),
    )
    assert done.returncode == ExitCode.STORAGE
    assert done.stderr == "tofmix: a.h5: range: reading returned no data for 0.3 s; given up\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("text", "expected"), [("3.5", 3.5), ("", 7.0), ("-1", 7.0), ("inf", 7.0), ("soon", 7.0)])
def test_the_limit_is_a_number_above_0(monkeypatch: pytest.MonkeyPatch, text: str, expected: float) -> None:
    monkeypatch.setenv("TOFMIX_READ_TIMEOUT", text)
    assert limit_s(7.0) == expected


def test_no_data_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_recording(tmp_path / "r.h5", boards(), chunks=(7, 3, 4), compression="gzip")

    def fail(*_: object) -> None:
        pytest.fail("data were read")

    monkeypatch.setattr(h5py.Dataset, "__getitem__", fail)
    with h5py.File(path) as root:
        check_structure(root, path.stat().st_size)


def test_file_replaced_after_the_check_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_recording(tmp_path / "a.h5", boards())
    monkeypatch.setattr(StructureChecker, "check", lambda *_: [0, 0, 0, 0])
    with pytest.raises(BadInputError, match="the file was replaced between check and opening"), open_recording(path):
        pass
