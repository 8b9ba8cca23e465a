"""Layers files, their chunks and journals: round trip, the contract, other readers, refusals, and sudden ends."""

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from hypothesis import given
from hypothesis import strategies as st

from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.flags import Status
from tofmix.grid import plan_windows
from tofmix.io import hdf5
from tofmix.io.layers.chunks import EncodedCell, encode_cell, fill_of, fletcher32
from tofmix.io.layers.journal import Shard, files_of, journal_path, open_journal, open_part, remove_journal
from tofmix.io.layers.layers_file import LayersWriter, open_layers
from tofmix.io.schema import field_of
from tofmix.io.storage import AtomicFile
from tofmix.layers import LAYER_DIMS, LAYER_FIELDS, Layers, Provenance
from tofmix.sensor import NoiseCurve, Sensor

CONTRACT = Path(__file__).parents[4] / "shared" / "check_contract.py"
SHAPE, MAX_LAYERS = (3, 5, 4), 3


def made_up_layers() -> Layers:
    """Consistent layers without a meaning."""
    rng = np.random.default_rng(3)
    layers = Layers.empty(SHAPE, MAX_LAYERS)
    layers.n_modes[...] = rng.integers(0, MAX_LAYERS + 1, SHAPE)
    layers.n_peaks[...] = layers.n_modes
    present = np.arange(MAX_LAYERS) < layers.n_modes[..., None]
    for name in ("range", "sigma", "range_stderr"):
        values = np.sort(rng.uniform(1, 1000, present.shape), axis=-1)
        getattr(layers, name)[present] = values[present]
    layers.weight[present] = (0.9 / np.maximum(layers.n_modes, 1))[..., None].repeat(MAX_LAYERS, -1)[present]
    layers.weight_outlier[...] = 1e-4
    layers.weight_no_return[...] = 1 - 1e-4 - np.nansum(layers.weight, -1)
    layers.log_likelihood[...] = -7.5
    layers.n_samples[...] = 20
    layers.status[layers.n_modes == 0] = Status.NO_SURFACE
    return layers


def provenance() -> Provenance:
    sensor = Sensor(name="camera", range_max_mm=7500.0, noise=NoiseCurve(np.array([1.0, 2.0]), np.array([3.0, 4.0])))
    return Provenance(
        source="a.h5",
        source_sha256="ab" * 32,
        version="9.9",
        sensor=sensor,
        options={"gamma": 0.02, "sigma": "tied"},
        frames_left_out=2,
    )


def write(path: Path, layers: Layers, **settings: Any) -> None:  # noqa: ANN401  the writer's own
    writer = LayersWriter(
        path,
        windows=plan_windows(62, window=20),
        image=SHAPE[1:],
        max_layers=MAX_LAYERS,
        tile=(1, 2),
        provenance=provenance(),
        **settings,
    )
    with writer:
        for k in range(SHAPE[0]):
            part = Layers(**{spec.name: getattr(layers, spec.name)[k : k + 1] for spec in LAYER_FIELDS})
            writer.write(slice(k, k + 1), slice(0, SHAPE[1]), part)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write(tmp_path / "a.layers.h5", made_up_layers())
    return tmp_path / "a.layers.h5"


def test_layers_and_provenance_read_back_and_the_file_passes_the_format_checker(path: Path) -> None:
    layers = made_up_layers()
    with open_layers(path) as file:
        assert file.shape == SHAPE
        assert file.max_layers == MAX_LAYERS
        assert file.window_start.tolist() == [0, 20, 40]
        assert file.window_stop.tolist() == [20, 40, 60]
        for k in range(SHAPE[0]):
            window = file.read_window(k)
            for spec in LAYER_FIELDS:
                np.testing.assert_array_equal(getattr(window, spec.name), getattr(layers, spec.name)[k])
    with open_layers(path) as file:
        read, written = file.provenance, provenance()
    assert (read.source, read.source_sha256, read.version) == (written.source, written.source_sha256, written.version)
    assert (read.options, read.frames_left_out) == (written.options, written.frames_left_out)
    assert read.sensor.noise is not None
    np.testing.assert_array_equal(read.sensor.noise.sigma_mm, [3.0, 4.0])
    if not CONTRACT.exists():
        pytest.skip("the contract's checker is not beside this checkout")
    subprocess.run([sys.executable, CONTRACT, path], check=True)


def test_layers_file_is_read_by_xarray_nexus_and_its_flags(path: Path) -> None:
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        assert data["range"].dims == ("window", "row", "col", "layer")
        assert data["n_modes"].dims == ("window", "row", "col")
        assert data["window_start"].dims == ("window",)
        np.testing.assert_array_equal(data["weight"].values, made_up_layers().weight)
    with h5py.File(path) as root:
        entry = root[root.attrs["default"]]
        view = entry[entry.attrs["default"]]
        assert [x.attrs["NX_class"] for x in (root, entry, view)] == ["NXroot", "NXentry", "NXdata"]
        assert view[view.attrs["signal"]].shape == (*SHAPE, MAX_LAYERS)
        assert [len(view[axis]) for axis in view.attrs["axes"]] == [*SHAPE, MAX_LAYERS]
    with h5py.File(path) as root:
        attributes = root["status"].attrs
        names = dict(zip(attributes["flag_values"].tolist(), attributes["flag_meanings"].split(), strict=True))
    assert names == {0: "ok", 1: "too_few_samples", 2: "not_converged", 3: "no_surface", 4: "degenerate"}


def test_the_same_layers_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / name, made_up_layers())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("sigma", None, "no dataset sigma"),
        ("sigma", np.zeros(SHAPE, "f4"), "sigma: expected f4"),
        ("sigma", np.zeros((*SHAPE, MAX_LAYERS)), "sigma: expected f4"),
        ("sigma", np.zeros((*SHAPE, 9), "f4"), "sigma: shape"),
        ("window_stop", np.zeros(7, "u8"), "window_stop: shape"),
        ("range", np.zeros((0, 5, 4, 3), "f4"), "holds no layer"),
    ],
)
def test_dataset_of_wrong_shape_or_type_is_refused_with_its_name(
    path: Path, name: str, value: object, reason: str
) -> None:
    with h5py.File(path, "r+") as root:
        del root[name]
        if value is not None:
            root[name] = value
    with pytest.raises(BadInputError, match=reason), open_layers(path):
        pass


@pytest.mark.parametrize("text", ["{", "[1]"])
def test_broken_options_are_refused(path: Path, text: str) -> None:
    with h5py.File(path, "r+") as root:
        root.attrs["options"] = text
        del root.attrs["provenance_crc32"]
    with pytest.raises(BadInputError, match="options"), open_layers(path):
        pass


def test_a_changed_byte_in_the_options_is_noticed(path: Path) -> None:
    data = path.read_bytes()
    with h5py.File(path) as root:
        texts = [str(root.attrs[key]).encode() for key in ("options", "source_sha256")]
    for text in texts:
        place = data.index(text) + len(text) // 2
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with pytest.raises(BadInputError, match="is damaged: their checksum differs"), open_layers(path):
            pass


def made_up(shape: tuple[int, int, int], layers: int = 3) -> Layers:
    rng = np.random.default_rng(2)
    out = Layers.empty(shape, layers)
    for spec in LAYER_FIELDS:
        values = getattr(out, spec.name)
        values[...] = (
            rng.integers(0, layers + 1, values.shape) if spec.dtype == "u1" else rng.normal(50, 9, values.shape)
        )
    return out


@pytest.mark.parametrize("cell", [(2, 3, 5), (1, 3, 5), (2, 1, 5)])
def test_hdf5_reads_what_was_encoded(tmp_path: Path, cell: tuple[int, int, int]) -> None:
    layers, whole = made_up(cell), (2, 3, 5)
    encoded = encode_cell(layers, shape=whole)
    with (
        AtomicFile(tmp_path / "a.h5", overwrite=False) as file,
        hdf5.create(file, kind="x", title="", history="") as root,
    ):
        for name, length in zip(LAYER_DIMS, (*whole, 3), strict=True):
            hdf5.add_scale(root, name, length)
        for spec, chunk in zip(LAYER_FIELDS, encoded.chunks, strict=True):
            hdf5.add_field(root, field_of(spec), dict(zip(LAYER_DIMS, (*whole, 3), strict=True)))
            root[spec.name].id.write_direct_chunk((0,) * len(spec.dims), chunk)
    windows, rows, cols = cell
    with h5py.File(tmp_path / "a.h5") as root:  # reading checks Fletcher's sum
        for spec in LAYER_FIELDS:
            read = root[spec.name][...]
            np.testing.assert_array_equal(read[:windows, :rows, :cols], getattr(layers, spec.name))
            rest = np.ones(read.shape[:3], dtype=bool)
            rest[:windows, :rows, :cols] = False
            np.testing.assert_array_equal(read[rest], np.full_like(read[rest], fill_of(spec)))
    assert encoded.tally == tuple(int((layers.n_modes == n).sum()) for n in range(4))


@pytest.mark.slow
@given(data=st.binary(max_size=4000) | st.sampled_from([b"\xff" * 800, b"\0" * 9, b"\xff\xff\0\0", b""]))
def test_fletcher32_is_that_of_the_library(data: bytes) -> None:
    # The library's loop: 16-bit big-endian words, carries folded in every 360 words.
    low = high = 0
    words = [int.from_bytes(data[k : k + 2].ljust(2, b"\0"), "big") for k in range(0, len(data), 2)]
    for start in range(0, len(words), 360):
        for word in words[start : start + 360]:
            low += word
            high += low
        low, high = (low & 0xFFFF) + (low >> 16), (high & 0xFFFF) + (high >> 16)
    low, high = (low & 0xFFFF) + (low >> 16), (high & 0xFFFF) + (high >> 16)
    assert fletcher32(data) == (high << 16 | low)


def encoded(seed: int) -> EncodedCell:
    return EncodedCell((seed, 2, 3), tuple(bytes([seed, k]) * (100 * k) for k in range(len(LAYER_FIELDS))))


@pytest.fixture
def path_journal(tmp_path: Path) -> Path:
    return journal_path(tmp_path / "a.layers.h5")


def test_reopened_journal_has_its_cells(path_journal: Path) -> None:
    with open_journal(path_journal, b"header") as journal:
        for k in (5, 2):
            journal.add(k, encoded(k))
    with open_journal(path_journal, b"another") as journal:
        assert journal.header == b"header"
        assert journal.done() == {2: (2, 2, 3), 5: (5, 2, 3)}
        assert journal.cell(5) == encoded(5)
        with pytest.raises(KeyError):
            journal.cell(3)
        journal.remove()
    assert list(path_journal.parent.iterdir()) == []


def test_a_killed_process_loses_nothing_that_was_added(path_journal: Path) -> None:
    program = (
        "import os, signal, sys\nfrom pathlib import Path\n"
        "from tofmix.io.layers.chunks import EncodedCell\nfrom tofmix.io.layers.journal import open_journal\n"
        "journal = open_journal(Path(sys.argv[1]), b'header')\n"
        "for k in range(40):\n    journal.add(k, EncodedCell((k,), (bytes(50000),) * 14))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, path_journal], check=False)
    assert done.returncode == -signal.SIGKILL
    with open_journal(path_journal, b"header") as journal:
        assert sorted(journal.done()) == list(range(40))


def test_journal_is_open_in_one_process_at_a_time(path_journal: Path) -> None:
    with open_journal(path_journal, b"header"), pytest.raises(UsageError, match="another run is using it"):
        open_journal(path_journal, b"header")
    open_journal(path_journal, b"header").close()


def test_published_part_is_one_file(path_journal: Path, tmp_path: Path) -> None:
    with open_journal(path_journal, b"header", Shard(number=2, count=3)) as journal:
        journal.add(1, encoded(1))
        journal.publish(tmp_path / "a.part")
    assert [p.name for p in tmp_path.iterdir()] == ["a.part"]
    with open_part(tmp_path / "a.part") as part:
        assert (part.header, part.shard, part.cell(1)) == (b"header", Shard(number=2, count=3), encoded(1))
    with open_journal(path_journal, b"header") as journal:
        journal.add(1, encoded(1))
        path_journal.with_name(path_journal.name + "-journal").write_bytes(b"")  # what it could not remove
        journal.publish(tmp_path / "a.part")
    assert [p.name for p in tmp_path.iterdir()] == ["a.part"]


def test_a_part_that_cannot_be_published_keeps_its_cells(path_journal: Path, tmp_path: Path) -> None:
    with open_journal(path_journal, b"header") as journal:
        journal.add(1, encoded(1))
        with pytest.raises(StorageError, match="No such file"):
            journal.publish(tmp_path / "none" / "a.part")
        assert journal.has_cells
    with open_journal(path_journal, b"header") as journal:
        assert journal.has_cells
        assert journal.cell(1) == encoded(1)


def test_shards_divide_the_cells() -> None:
    for total in (0, 1, 7, 100):
        for count in (1, 2, 3, 8):
            cells = [k for n in range(count) for k in Shard(number=n + 1, count=count).cells(total)]
            assert cells == list(range(total))


def test_damaged_journals_and_other_files_are_noticed(path_journal: Path) -> None:
    with open_journal(path_journal, b"header") as journal:
        journal.add(1, EncodedCell((1,), (b"needle in the hay" * 999,) * 14))
    data = path_journal.read_bytes()
    path_journal.write_bytes(data.replace(b"needle", b"noodle", 1))
    with open_journal(path_journal, b"header") as journal, pytest.raises(BadInputError, match="cell 1 is damaged"):
        journal.cell(1)
    path_journal.write_bytes(b"not a database, and long enough to be taken for one" * 99)
    with pytest.raises(BadInputError, match="not a journal"):
        open_journal(path_journal, b"header")
    with pytest.raises(BadInputError, match="not a journal"), open_part(path_journal):
        pass
    remove_journal(path_journal)
    open_journal(path_journal, b"header").close()


def test_a_missing_part_and_a_closed_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="No such file"), open_part(tmp_path / "none.part"):
        pass
    with pytest.raises(StorageError, match="unable to open"):
        open_journal(tmp_path / "none" / "journal", b"header")


def test_leftovers_of_a_lost_journal_are_not_read_by_a_new_one(path_journal: Path) -> None:
    for other in files_of(path_journal)[:-1]:
        other.write_bytes(b"stale")
    with open_journal(path_journal, b"header") as journal:
        assert journal.done() == {}
        journal.remove()
    assert list(path_journal.parent.iterdir()) == []
