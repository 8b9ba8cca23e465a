"""Where the memory ends, HDF5 files are opened or refused in good order: the library itself would end the process."""

import ctypes
import io
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import h5py
import pytest
from support.files import boards, write_recording

from tofmix.io.guard.hdf5_memory import reserve_memory

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
