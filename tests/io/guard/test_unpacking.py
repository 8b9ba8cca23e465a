"""A chunk that unpacks to more than it declares is refused before it takes the memory."""

import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.files import boards, write_recording

from tofmix.errors import BadInputError
from tofmix.io.guard import structure_rules
from tofmix.io.recording.recording_file import open_recording

EVERYTHING = (slice(None), slice(None))


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


@pytest.mark.usefixtures("_every_chunk")
def test_chunks_stored_without_compression_are_read(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(50), chunks=(25, 4, 6), compression="gzip")
    with h5py.File(path, "r+") as root:
        root["range"].id.write_direct_chunk((25, 0, 0), boards(50)[25:].tobytes(), 1)
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording.read_range(*EVERYTHING), boards(50))
