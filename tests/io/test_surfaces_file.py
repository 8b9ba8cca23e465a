"""Surfaces files: round trip, numbering over windows, the contract, other readers, and refusals."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from support.planes_found import COLS, FACTOR, LAYERS, ROWS, board_and_wall, nothing_found, provenance, write_surfaces

from tofmix.errors import BadInputError, StorageError, UsageError
from tofmix.io.layers.layers_file import open_layers
from tofmix.io.surfaces_file import SurfacesWriter, open_surfaces
from tofmix.io.verify import verify
from tofmix.surfaces.found import Edges, Planes

CONTRACT = Path(__file__).parents[3] / "shared" / "check_contract.py"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_surfaces(tmp_path / "a.surfaces.h5", board_and_wall())


@pytest.fixture
def three(tmp_path: Path) -> Path:
    """Three windows, nothing in the second."""
    return write_surfaces(tmp_path / "three.surfaces.h5", board_and_wall(), nothing_found(), board_and_wall())


def assert_same(read: object, written: object, kind: type[Edges] | type[Planes]) -> None:
    for field in fields(kind):
        np.testing.assert_array_equal(getattr(read, field.name), getattr(written, field.name), err_msg=field.name)
        assert getattr(read, field.name).dtype == getattr(written, field.name).dtype


def test_one_window_reads_back(path: Path) -> None:
    written = board_and_wall()
    with open_surfaces(path) as file:
        assert (file.shape, file.max_layers, file.factor) == ((1, ROWS, COLS), LAYERS, FACTOR)
        assert (file.surfaces, file.edge_points) == (2, 7)
        read = file.read_window(0)
        assert read.factor == FACTOR
        for name in ("surface", "range_fine", "surface_fine"):
            np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
        assert_same(read.planes, written.planes, Planes)
        assert_same(read.edges, written.edges, Edges)
        assert file.surface_window.tolist() == [0, 0]
        assert not {"edge_window", "surface_window"} & set(file.names)


def test_surfaces_and_lines_of_later_windows_follow_those_before(three: Path) -> None:
    written = board_and_wall()
    with open_surfaces(three) as file:
        assert file.surface_window.tolist() == [0, 0, 2, 2]
        empty, last = file.read_window(1), file.read_window(2)
        assert len(empty.edges) == 0
        assert (empty.surface == -1).all()
        assert len(last.planes) == 4
        for name in ("surface", "surface_fine"):
            before, after = getattr(written, name), getattr(last, name)
            np.testing.assert_array_equal(after, np.where(before >= 0, before + 2, -1))
        assert last.edges.near.tolist() == [2] * 5 + [3] * 2
        assert last.edges.far.tolist() == [3] * 5 + [-1] * 2
        assert last.edges.line.tolist() == [2] * 5 + [3] * 2
        np.testing.assert_array_equal(last.edges.row, written.edges.row)


def test_provenance_reads_back(path: Path) -> None:
    with open_surfaces(path) as file:
        read = file.provenance
    written = provenance()
    assert (read.source, read.source_sha256, read.version, read.options) == (
        written.source,
        written.source_sha256,
        written.version,
        written.options,
    )
    assert read.sensor.optics == written.sensor.optics


@pytest.mark.parametrize("windows", [1, 3])
def test_a_file_without_a_surface_can_be_written_read_and_verified(tmp_path: Path, windows: int) -> None:
    path = write_surfaces(tmp_path / "none.surfaces.h5", *[nothing_found()] * windows)
    with open_surfaces(path) as file:
        assert (file.surfaces, file.edge_points) == (0, 0)
        assert np.isnan(file.read_window(windows - 1).range_fine).all()
    assert verify(path).lines() == []
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        assert data.sizes["edge_point"] == data.sizes["surface_index"] == 0


@pytest.mark.parametrize("name", ["path", "three"])
def test_surfaces_file_passes_the_format_checker(name: str, request: pytest.FixtureRequest) -> None:
    if not CONTRACT.exists():
        pytest.skip("the contract's checker is not beside this checkout")
    subprocess.run([sys.executable, CONTRACT, request.getfixturevalue(name)], check=True)


def test_xarray_opens_it_with_named_dimensions(three: Path) -> None:
    with xarray.open_dataset(three, engine="h5netcdf") as data:
        assert data["surface"].dims == ("window", "row", "col", "layer")
        assert data["range_fine"].dims == data["surface_fine"].dims == ("window", "row_fine", "col_fine")
        assert data["edge_row"].dims == data["edge_window"].dims == ("edge_point",)
        assert data["plane_normal"].dims == ("surface_index", "axis")
        assert data["range_fine"].attrs["factor"] == FACTOR
        assert data["range_fine"].attrs["units"] == "mm"
        # The parts of pixel 0 lie about 0.
        np.testing.assert_allclose(data["row_fine"].values[:FACTOR], [-0.375, -0.125, 0.125, 0.375])
        board = data["range_fine"].isel(window=0).sel(row_fine=2.125, col_fine=3.125)
        assert 1000 <= float(board) < 1010


def test_nexus_finds_the_fine_range_image(path: Path) -> None:
    with h5py.File(path) as root:
        entry = root[root.attrs["default"]]
        view = entry[entry.attrs["default"]]
        assert [x.attrs["NX_class"] for x in (root, entry, view)] == ["NXroot", "NXentry", "NXdata"]
        assert view.attrs["signal"] == "range_fine"
        assert [len(view[axis]) for axis in view.attrs["axes"]] == [1, ROWS * FACTOR, COLS * FACTOR]


def test_the_same_surfaces_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_surfaces(tmp_path / name, board_and_wall(), nothing_found())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_file_is_replaced_only_with_overwrite_and_the_input_never(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(UsageError, match="--overwrite"):
        write_surfaces(path, nothing_found())
    with pytest.raises(UsageError, match="is the input"):
        write_surfaces(path, nothing_found(), overwrite=True, inputs=(path,))
    assert path.read_bytes() == before


def test_fault_between_windows_leaves_no_file(tmp_path: Path) -> None:
    def stop() -> None:
        with SurfacesWriter(
            tmp_path / "a.surfaces.h5", shape=(2, ROWS, COLS), max_layers=LAYERS, factor=FACTOR, provenance=provenance()
        ) as writer:
            writer.write(board_and_wall())
            raise ValueError("no more")

    with pytest.raises(ValueError, match="no more"):
        stop()
    assert list(tmp_path.iterdir()) == []


def test_missing_window_leaves_no_file(tmp_path: Path) -> None:
    with (
        pytest.raises(RuntimeError, match="0 windows written of 2"),
        SurfacesWriter(
            tmp_path / "a.surfaces.h5", shape=(2, ROWS, COLS), max_layers=LAYERS, factor=FACTOR, provenance=provenance()
        ),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_a_storage_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.pwrite", fail)
    with pytest.raises(StorageError, match="No space left"):
        write_surfaces(tmp_path / "a.surfaces.h5", board_and_wall())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("surface", None, "no dataset surface"),
        ("surface", np.zeros((1, ROWS, COLS, LAYERS), "u4"), "surface: expected i4"),
        ("surface", np.zeros((1, ROWS, COLS), "i4"), "surface: expected i4"),
        ("surface", np.zeros((0, ROWS, COLS, LAYERS), "i4"), "holds no layer"),
        ("surface", np.zeros((1, 1, COLS, LAYERS), "i4"), "range_fine: shape"),
        ("surface_fine", np.zeros((1, 3, 3), "i4"), "surface_fine: shape"),
        ("edge_stderr", np.zeros(6, "f4"), "edge_stderr: shape"),
        ("plane_normal", np.zeros((2, 2), "f4"), "plane_normal: shape"),
        ("n_pixels", np.zeros(2, "i4"), "n_pixels: expected u4"),
        ("edge_window", np.zeros(7, "f4"), "edge_window: expected u4"),
    ],
)
def test_dataset_of_wrong_shape_or_type_is_refused_with_its_name(
    path: Path, name: str, value: object, reason: str
) -> None:
    with h5py.File(path, "r+") as root:
        if name in root:
            del root[name]
        if value is not None:
            root[name] = value
    with pytest.raises(BadInputError, match=reason) as refused, open_surfaces(path):
        pass
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("factor", [0, 33, 2.5, "8", [4, 4]])
def test_impossible_factor_is_refused(path: Path, factor: object) -> None:
    with h5py.File(path, "r+") as root:
        root["range_fine"].attrs["factor"] = factor
    with pytest.raises(BadInputError, match="range_fine: attribute factor"), open_surfaces(path):
        pass


def test_another_factor_than_the_images_have_is_refused(path: Path) -> None:
    with h5py.File(path, "r+") as root:
        root["range_fine"].attrs["factor"] = 5
    with pytest.raises(BadInputError, match="range_fine: shape"), open_surfaces(path):
        pass


@pytest.mark.parametrize("name", ["surface", "surface_fine", "edge_near", "edge_far"])
def test_a_number_of_no_surface_is_refused_when_read(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as root:
        root[name][0] = 2
    with open_surfaces(path) as file, pytest.raises(BadInputError, match=f"{name}: surfaces .* has 2 surfaces"):
        file.read_window(0)


@pytest.mark.parametrize("name", ["edge_row", "edge_col"])
def test_a_point_of_an_edge_without_a_place_is_refused_when_read(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as root:
        root[name][3] = np.nan
    with open_surfaces(path) as file, pytest.raises(BadInputError, match=f"{name}: a point without a place"):
        file.read_window(0)


@pytest.mark.parametrize(("name", "value"), [("edge_window", 9), ("edge_window", 1), ("surface_window", 3)])
def test_impossible_windows_are_refused_when_read(three: Path, name: str, value: int) -> None:
    with h5py.File(three, "r+") as root:
        root[name][0] = value
    with open_surfaces(three) as file, pytest.raises(BadInputError, match=f"{name}: expected windows 0 to 2"):
        _ = file.surface_window if name == "surface_window" else file.read_edges(0)


def test_several_windows_need_the_window_of_each_edge(three: Path) -> None:
    with h5py.File(three, "r+") as root:
        del root["edge_window"]
    with open_surfaces(three) as file, pytest.raises(BadInputError, match="no dataset edge_window, but 3 windows"):
        file.read_window(0)


def test_a_changed_byte_in_the_options_is_noticed(path: Path) -> None:
    data = path.read_bytes()
    place = data.index(b'{"factor": 4}') + 11
    path.write_bytes(data[:place] + b"8" + data[place + 1 :])
    with pytest.raises(BadInputError, match="is damaged: their checksum differs"), open_surfaces(path):
        pass


def test_surfaces_file_is_refused_as_layers_file(path: Path) -> None:
    expected = f"is a surfaces file, not a layers file: tofmix export {path} -o {path.with_suffix('.ply')}"
    with pytest.raises(BadInputError, match=expected), open_layers(path):
        pass


def test_layers_file_is_refused_as_surfaces_file(path: Path) -> None:
    with h5py.File(path, "r+") as root:
        root.attrs["format"] = "tofmix-layers"
    with pytest.raises(BadInputError, match="is a layers file, not a surfaces file: tofmix surfaces"):  # noqa: SIM117
        with open_surfaces(path):
            pass


def test_verify_finds_no_fault_in_written_files(path: Path, three: Path) -> None:
    for file in (path, three):
        found = verify(file)
        assert found.lines() == []
        assert found.kind == "surfaces"
    assert found.checked == 15


def test_verify_names_each_fault(tmp_path: Path) -> None:
    faults: dict[str, tuple[object, object, str]] = {
        "surface": ((0, 0, 0, 2), 7, "surfaces -1 to 3"),
        "surface_fine": ((0, 1, 1), -2, "surfaces -1 to 3"),
        "range_fine": ((0, 1, 1), -1.0, "above 0 mm or NaN"),
        "edge_near": (0, 4, "surfaces -1 to 3"),
        "edge_far": (0, -5, "surfaces -1 to 3"),
        "edge_row": (0, 40.0, "in the image"),
        "edge_col": (0, np.nan, "in the image"),
        "edge_stderr": (0, -0.1, "not below 0"),
        "edge_line": (1, 3, "ascending from 0"),
        "n_pixels": (1, 3, "layers that are of the surface"),
        "plane_normal": ((1, 0), 0.5, "unit length"),
        "plane_offset_mm": (0, -3.0, "0 mm or more"),
        "rms_mm": (0, np.nan, "0 mm or more"),
        "edge_window": (0, 2, "ascending"),
        "surface_window": (0, 2, "ascending"),
    }
    for name, (place, value, text) in faults.items():
        path = write_surfaces(tmp_path / f"{name}.h5", board_and_wall(), board_and_wall(), nothing_found())
        with h5py.File(path, "r+") as root:
            root[name][place] = value
        lines = [line for line in verify(path).lines() if line.startswith(f"{name}: ")]
        assert len(lines) == 1, (name, verify(path).lines())
        assert text in lines[0]


def test_verify_finds_a_surface_in_another_window(tmp_path: Path) -> None:
    path = write_surfaces(tmp_path / "a.h5", board_and_wall(), board_and_wall())
    with h5py.File(path, "r+") as root:
        root["surface"][1, 0, 0, 2] = 0
        root["n_pixels"][0] += 1
    assert any("of the surfaces of its window" in line for line in verify(path).lines())


def test_verify_finds_a_flipped_bit(path: Path) -> None:
    with h5py.File(path) as root:
        chunk = root["range_fine"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset + chunk.size // 2] ^= 4
    path.write_bytes(bytes(data))
    (line,) = verify(path).lines()
    assert line.startswith("range_fine: ")
