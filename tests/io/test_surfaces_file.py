"""Surfaces files and every format that they export: round trip, the contract, other readers, and refusals."""

import csv
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import plyfile
import pytest
import shapely
import xarray
from numpy.typing import NDArray
from pypcd4.pypcd4 import PointCloud
from support.planes_found import (
    BOARD_MM,
    BOTTOM,
    COLS,
    FACTOR,
    LAYERS,
    LEFT,
    RIGHT,
    ROWS,
    TOP,
    WALL_MM,
    board_and_wall,
    nothing_found,
    provenance,
    write_surfaces,
)

from tofmix.errors import BadInputError, UsageError
from tofmix.io.exporters import (
    EDGE_WRITERS,
    OF_LAYERS,
    OF_SURFACES,
    PLANE_WRITERS,
    POINT_WRITERS,
    choose_what,
    export_edges,
    export_planes,
    export_points,
)
from tofmix.io.exporters.edge_lines import edge_lines
from tofmix.io.exporters.outlines import outlines, trace
from tofmix.io.exporters.placing import FIELDS, FinePoints
from tofmix.io.layers.layers_file import open_layers
from tofmix.io.surfaces_file import SurfacesFile, open_surfaces
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


def test_one_window_and_its_provenance_read_back(path: Path) -> None:
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
        found, given = file.provenance, provenance()
    for name in ("source", "source_sha256", "version", "options"):
        assert getattr(found, name) == getattr(given, name)
    assert found.sensor.optics == given.sensor.optics
    with h5py.File(path) as root:
        entry = root[root.attrs["default"]]
        view = entry[entry.attrs["default"]]
        assert [x.attrs["NX_class"] for x in (root, entry, view)] == ["NXroot", "NXentry", "NXdata"]
        assert view.attrs["signal"] == "range_fine"
        assert [len(view[axis]) for axis in view.attrs["axes"]] == [1, ROWS * FACTOR, COLS * FACTOR]


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


def test_the_same_surfaces_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_surfaces(tmp_path / name, board_and_wall(), nothing_found())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


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


def test_surfaces_and_layers_files_are_refused_as_each_other(path: Path) -> None:
    expected = f"is a surfaces file, not a layers file: tofmix export {path} -o {path.with_suffix('.ply')}"
    with pytest.raises(BadInputError, match=expected), open_layers(path):
        pass
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


FOV_DEG = (16.0, 12.0)
DEPTH_M = (BOARD_MM / 1000, WALL_MM / 1000)


@pytest.fixture
def file(tmp_path: Path) -> Iterator[SurfacesFile]:
    with open_surfaces(write_surfaces(tmp_path / "a.surfaces.h5", board_and_wall())) as opened:
        yield opened


@pytest.fixture
def three_export(tmp_path: Path) -> Iterator[SurfacesFile]:
    path = write_surfaces(tmp_path / "three.surfaces.h5", board_and_wall(), nothing_found(), board_and_wall())
    with open_surfaces(path) as opened:
        yield opened


def seen_from(row: Any, col: Any, depth_m: Any) -> NDArray[np.float64]:  # noqa: ANN401  numbers or arrays
    """Points (..., 3) of a plane z = depth at places of the image, by the words of the contract."""
    azimuth = np.deg2rad((np.asarray(col) - (COLS - 1) / 2) * FOV_DEG[0] / COLS)
    elevation = np.deg2rad((np.asarray(row) - (ROWS - 1) / 2) * FOV_DEG[1] / ROWS)
    along = np.stack(
        [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)], axis=-1
    )
    return np.asarray(along * (np.asarray(depth_m) / along[..., 2])[..., np.newaxis])


def test_edges_as_geojson_are_lines_of_the_image(file: SurfacesFile, tmp_path: Path) -> None:
    out = tmp_path / "a.geojson"
    export_edges(out, edge_lines(file, [0]), title="a test")
    content = json.loads(out.read_text())
    assert content["type"] == "FeatureCollection"
    first, second = content["features"]
    assert {feature["geometry"]["type"] for feature in content["features"]} == {"LineString"}
    assert first["geometry"]["coordinates"] == [[1.25, 0.25], [1.25, 1.5], [1.25, 3.75], [4.0, 3.75], [5.5, 3.75]]
    assert first["properties"] == {
        "line": 0,
        "near": 0,
        "far": 1,
        "window": 0,
        "stderr": [0.02, 0.03, 0.02, 0.05, None],
    }
    assert second["geometry"]["coordinates"] == [[6.5, -0.5], [6.5, 5.5]]
    assert (second["properties"]["near"], second["properties"]["far"]) == (1, -1)
    # shapely reads it as any GeoJSON.
    assert shapely.from_geojson(json.dumps(first["geometry"])).length == pytest.approx(3.5 + 4.25)


def test_a_line_that_passes_to_another_surface_has_no_gap(tmp_path: Path) -> None:
    found = board_and_wall()
    found.edges.far[2:5] = -1
    path = write_surfaces(tmp_path / "a.surfaces.h5", found)
    with open_surfaces(path) as file:
        pieces = edge_lines(file, [0])
    assert [(piece.line, piece.near, piece.far, len(piece.row)) for piece in pieces] == [
        (0, 0, 1, 3),
        (0, 0, -1, 3),
        (1, 1, -1, 2),
    ]
    assert (pieces[0].row[-1], pieces[0].col[-1]) == (pieces[1].row[0], pieces[1].col[0])


def test_edges_as_obj_lie_on_the_plane_of_the_nearer_surface(file: SurfacesFile, tmp_path: Path) -> None:
    out = tmp_path / "a.obj"
    export_edges(out, edge_lines(file, [0]), title="a test")
    lines = [line.split() for line in out.read_text().splitlines()]
    vertices = np.array([[float(x) for x in line[1:]] for line in lines if line[0] == "v"])
    joined = [[int(k) for k in line[1:]] for line in lines if line[0] == "l"]
    assert joined == [[1, 2, 3, 4, 5], [6, 7]]
    assert [line[1] for line in lines if line[0] == "o"] == ["line_0_near_0_far_1", "line_1_near_1_far_-1"]
    edges = board_and_wall().edges
    expected = seen_from(edges.row, edges.col, np.array(DEPTH_M)[edges.near])
    np.testing.assert_allclose(vertices, expected, rtol=0, atol=0.51e-6)


def test_edges_as_ply_are_joined_along_each_line(file: SurfacesFile, tmp_path: Path) -> None:
    out = tmp_path / "a.ply"
    export_edges(out, edge_lines(file, [0]), title="a test")
    read = plyfile.PlyData.read(out)
    edges = board_and_wall().edges
    vertices = read["vertex"].data
    for name in ("row", "col", "stderr", "near", "far", "line"):
        np.testing.assert_array_equal(vertices[name], getattr(edges, name), err_msg=name)
    expected = seen_from(edges.row, edges.col, np.array(DEPTH_M)[edges.near])
    np.testing.assert_allclose(np.stack([vertices[axis] for axis in "xyz"], -1), expected, rtol=1e-6)
    pairs = list(zip(read["edge"]["vertex1"].tolist(), read["edge"]["vertex2"].tolist(), strict=True))
    assert pairs == [(0, 1), (1, 2), (2, 3), (3, 4), (5, 6)]


def test_a_point_whose_beam_misses_the_plane_parts_the_line_in_space_alone(tmp_path: Path) -> None:
    found = board_and_wall()
    found.planes.normal[0] = [1, 0, 0]  # x = 1 m: only beams to the right meet it
    found.edges.col[:5] = [6.0, 5.0, 1.0, 4.0, 5.5]
    with open_surfaces(write_surfaces(tmp_path / "a.surfaces.h5", found)) as file:
        lines = edge_lines(file, [0])
    for suffix in (".obj", ".ply", ".geojson"):
        export_edges(tmp_path / f"a{suffix}", lines, title="a test")
    text = (tmp_path / "a.obj").read_text().splitlines()
    assert [line for line in text if line.startswith("l ")] == ["l 1 2", "l 3 4", "l 5 6"]
    assert "nan" not in (tmp_path / "a.obj").read_text()
    read = plyfile.PlyData.read(tmp_path / "a.ply")
    assert np.isfinite(read["vertex"]["x"]).all()
    assert read["edge"]["vertex1"].tolist() == [0, 2, 4]
    feature = json.loads((tmp_path / "a.geojson").read_text())["features"][0]
    assert len(feature["geometry"]["coordinates"]) == 5


def test_planes_that_are_not_finite_leave_no_vertex_and_no_nan(tmp_path: Path) -> None:
    found = board_and_wall()
    found.planes.normal[0] = np.nan
    found.planes.offset_mm[1] = np.inf
    with open_surfaces(write_surfaces(tmp_path / "a.surfaces.h5", found)) as file:
        for suffix in EDGE_WRITERS:
            export_edges(tmp_path / f"edges{suffix}", edge_lines(file, [0]), title="a test")
        for suffix in PLANE_WRITERS:
            export_planes(tmp_path / f"planes{suffix}", file, outlines(file, [0]), title="a test")
    for name in ("edges.obj", "planes.obj"):
        assert not [line for line in (tmp_path / name).read_text().splitlines() if line.startswith(("v", "f", "l "))]
    board, wall = json.loads((tmp_path / "planes.json").read_text())["surfaces"]
    assert (board["normal"], wall["offset_mm"]) == ([None] * 3, None)
    assert board["polygons"][0]["outline"] == []
    assert len(plyfile.PlyData.read(tmp_path / "edges.ply")["vertex"].data) == 0


def test_smooth_surface_is_no_plane_and_its_edges_lie_on_its_fine_ranges(tmp_path: Path) -> None:
    found = board_and_wall()
    found.planes.normal[0] = found.planes.offset_mm[0] = np.nan
    with open_surfaces(write_surfaces(tmp_path / "a.surfaces.h5", found)) as file:
        assert file.smooth_surfaces == 1
        assert [outline.surface for outline in outlines(file, [0])] == [1]
        line = edge_lines(file, [0])[0]
    assert line.near == 0
    # The made-up board faces the camera: ranges of its parts are within half a part of those at the points.
    assert line.place_m == pytest.approx(seen_from(line.row, line.col, DEPTH_M[0]), abs=0.005)
    assert verify(tmp_path / "a.surfaces.h5").ok


@pytest.mark.parametrize("suffix", OF_SURFACES["points"])
def test_fine_image_is_exported_as_points(three_export: SurfacesFile, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"a{suffix}"
    blocks: list[int] = []
    count = export_points(out, FinePoints(three_export, range(3)), title="a test", progress=blocks.append)
    assert len(blocks) == len(FinePoints(three_export, range(3)))
    read = points_read(out)
    found = board_and_wall()
    assert count == len(read["x"]) == 2 * int(np.isfinite(found.range_fine).sum())
    half = count // 2
    assert set(read["window"][:half]) == {0}
    assert set(read["window"][half:]) == {2}
    row, col = np.nonzero(np.isfinite(found.range_fine))
    for name, values in (
        ("range", found.range_fine[row, col]),
        ("surface", found.surface_fine[row, col]),
        ("row", (row + 0.5) / FACTOR - 0.5),
        ("col", (col + 0.5) / FACTOR - 0.5),
    ):
        np.testing.assert_array_equal(read[name][:half], values, err_msg=name)
    np.testing.assert_array_equal(read["surface"][half:], found.surface_fine[row, col] + 2)
    place = np.stack([read[axis][:half] for axis in "xyz"], axis=-1)
    depth_m = np.array(DEPTH_M)[found.surface_fine[row, col]]
    expected = seen_from((row + 0.5) / FACTOR - 0.5, (col + 0.5) / FACTOR - 0.5, depth_m)
    np.testing.assert_allclose(place, expected, rtol=0, atol=1e-6)


def points_read(path: Path) -> dict[str, NDArray[Any]]:
    names = [spec.name for spec in FIELDS]
    if path.suffix == ".csv":
        with path.open(newline="") as text:
            rows = list(csv.DictReader(text))
        return {spec.name: np.array([row[spec.name] for row in rows]).astype(spec.dtype) for spec in FIELDS}
    if path.suffix == ".pcd":
        cloud = PointCloud.from_path(path)
        assert list(cloud.fields) == names
        return {name: cloud.pc_data[name] for name in names}
    vertices = plyfile.PlyData.read(path)["vertex"]
    return {name: np.asarray(vertices[name]) for name in names}


def test_outlines_hold_the_parts_and_holes_of_each_surface() -> None:
    rng = np.random.default_rng(4)
    numbers = rng.integers(-1, 4, (12, 15)).repeat(3, axis=0).repeat(3, axis=1).astype(np.int32)
    polygons, number = trace(numbers, 6)
    assert (np.diff(number) >= 0).all()
    assert shapely.is_valid(polygons).all()
    row, col = np.indices(numbers.shape)
    for surface in range(4):
        whole = shapely.union_all(polygons[number == surface])
        inside = shapely.contains_xy(whole, (col + 0.5) / 6 - 0.5, (row + 0.5) / 6 - 0.5)
        # Blocks of 3 x 3 parts have no smaller detail to leave out.
        np.testing.assert_array_equal(inside, numbers == surface)
    holed = np.zeros((20, 20), dtype=np.int32)
    holed[5:15, 5:15] = 1
    holed[8:12, 8:12] = -1
    polygons, number = trace(holed, 4)
    assert number.tolist() == [0, 1]
    assert [len(polygon.interiors) for polygon in polygons] == [1, 1]
    assert [polygon.area * 16 for polygon in polygons] == pytest.approx([300.0, 84.0])
    assert polygons[0].bounds == (-0.5, -0.5, 4.5, 4.5)
    y, x = np.indices((160, 160))
    round_ = np.where(np.hypot(y - 70, x - 80) < 50, 0, np.where(y * 0.3 + x > 90, 1, 2)).astype(np.int32)
    polygons, number = trace(round_, 8)
    assert number.tolist() == [0, 1, 2]
    assert shapely.coverage_is_valid(polygons)
    assert shapely.area(polygons).sum() * 64 == pytest.approx(160 * 160)
    # Steps across the parts are left out, and no more than a part moves.
    assert shapely.get_num_coordinates(polygons[0]) < 150
    circle = shapely.Point((80 + 0.5) / 8 - 0.5, (70 + 0.5) / 8 - 0.5).buffer(50 / 8, quad_segs=64)
    assert shapely.hausdorff_distance(polygons[0].exterior, circle.exterior) < 1.5 / 8


def test_planes_json_holds_planes_and_outlines(file: SurfacesFile, tmp_path: Path) -> None:
    out = tmp_path / "a.json"
    export_planes(out, file, outlines(file, [0]), title="a test")
    board, wall = json.loads(out.read_text())["surfaces"]
    assert [surface["surface"] for surface in (board, wall)] == [0, 1]
    assert {key: board[key] for key in ("window", "normal", "offset_mm", "rms_mm", "n_pixels")} == {
        "window": 0,
        "normal": [0.0, 0.0, 1.0],
        "offset_mm": 1000.0,
        "rms_mm": 1.5,
        "n_pixels": int((board_and_wall().surface == 0).sum()),
    }
    (polygon,) = board["polygons"]
    assert polygon["outline"][0] == polygon["outline"][-1]
    corners = seen_from([TOP, TOP, BOTTOM, BOTTOM], [LEFT, RIGHT, RIGHT, LEFT], BOARD_MM / 1000)
    # The board's edges lie within parts: half a part of a pixel of 2 degrees at 1 m is 4.4 mm.
    for corner in corners:
        assert np.linalg.norm(np.subtract(polygon["outline"], corner), axis=-1).min() < 0.0065
    np.testing.assert_allclose(np.array(polygon["outline"])[:, 2], BOARD_MM / 1000, atol=1e-6)
    assert [len(wall["polygons"]), len(wall["polygons"][0]["holes"])] == [1, 1]
    np.testing.assert_allclose(np.array(wall["polygons"][0]["holes"][0])[:, 2], WALL_MM / 1000, atol=1e-6)


def test_planes_as_obj_are_triangles_that_face_the_sensor(file: SurfacesFile, tmp_path: Path) -> None:
    out = tmp_path / "a.obj"
    found = outlines(file, [0])
    export_planes(out, file, found, title="a test")
    lines = [line.split() for line in out.read_text().splitlines()]
    vertices = np.array([[float(x) for x in line[1:]] for line in lines if line[0] == "v"])
    faces = np.array([[int(k) for k in line[1:]] for line in lines if line[0] == "f"]) - 1
    assert faces.min() == 0
    assert faces.max() == len(vertices) - 1
    assert [line[1] for line in lines if line[0] == "o"] == ["surface_0", "surface_1"]
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    across = np.cross(b - a, c - a)
    assert ((across * a).sum(axis=-1) < 0).all()
    area = np.linalg.norm(across, axis=-1) / 2
    hole = found[1].polygons[0].interiors[0]
    for surface, depth_m in enumerate(DEPTH_M):
        expected = area_in_space(found[surface].polygons[0].exterior, depth_m)
        expected -= area_in_space(hole, depth_m) if surface else 0
        assert area[np.isclose(a[:, 2], depth_m)].sum() == pytest.approx(expected, rel=1e-4)


def area_in_space(ring: shapely.LinearRing, depth_m: float) -> float:
    """Area within a ring of the image on a plane z = depth, m^2."""
    col, row = np.array(ring.coords).T
    return float(shapely.Polygon(seen_from(row, col, depth_m)[:, :2]).area)


def test_a_surface_that_is_nowhere_the_nearest_is_listed_without_polygons(tmp_path: Path) -> None:
    found = board_and_wall()
    found.surface_fine[found.surface_fine == 0] = 1
    with open_surfaces(write_surfaces(tmp_path / "a.surfaces.h5", found)) as file:
        for suffix in PLANE_WRITERS:
            export_planes(tmp_path / f"a{suffix}", file, outlines(file, [0]), title="a test")
    board, wall = json.loads((tmp_path / "a.json").read_text())["surfaces"]
    assert board["polygons"] == []
    assert len(wall["polygons"]) == 1


def test_file_without_surfaces_exports_empty_files(tmp_path: Path) -> None:
    with open_surfaces(write_surfaces(tmp_path / "a.surfaces.h5", nothing_found())) as file:
        for suffix in EDGE_WRITERS:
            export_edges(tmp_path / f"edges{suffix}", edge_lines(file, [0]), title="a test")
        for suffix in PLANE_WRITERS:
            export_planes(tmp_path / f"planes{suffix}", file, outlines(file, [0]), title="a test")
        assert export_points(tmp_path / "points.pcd", FinePoints(file, [0]), title="a test") == 0
    assert json.loads((tmp_path / "edges.geojson").read_text())["features"] == []
    assert json.loads((tmp_path / "planes.json").read_text())["surfaces"] == []
    read = plyfile.PlyData.read(tmp_path / "edges.ply")
    assert [len(element.data) for element in read.elements] == [0, 0]


def test_file_without_pixel_directions_and_las_of_surfaces_are_refused(file: SurfacesFile, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="LAS stores points of layers"):
        export_points(tmp_path / "a.las", FinePoints(file, [0]), title="a test")
    assert {".las", ".laz"} == set(POINT_WRITERS) - set(OF_SURFACES["points"])
    object.__setattr__(file.provenance, "sensor", file.provenance.sensor.__class__(name="blind"))
    for export in (lambda: edge_lines(file, [0]), lambda: FinePoints(file, [0])):
        with pytest.raises(BadInputError, match="sensor: no field of view"):
            export()


@pytest.mark.parametrize(
    ("name", "what", "expected"),
    [
        ("a.geojson", None, "edges"),
        ("a.json", None, "edges"),
        ("a.json", "planes", "planes"),
        ("a.obj", None, "edges"),
        ("a.OBJ", "planes", "planes"),
        ("a.ply", None, "edges"),
        ("a.ply", "points", "points"),
        ("a.pcd", None, "points"),
        ("a.csv", None, "points"),
        ("a.png", None, "image"),
        ("a.tif", "image", "image"),
    ],
)
def test_export_content_follows_the_extension_or_the_option(name: str, what: str | None, expected: str) -> None:
    assert choose_what(Path(name), what, OF_SURFACES) == expected


@pytest.mark.parametrize(
    ("name", "what", "known", "text"),
    [
        ("a.las", None, OF_SURFACES, "must end in one of .geojson, .json, .obj, .ply"),
        (
            "a.png",
            "edges",
            OF_SURFACES,
            "--what edges cannot be written as .png; its formats: .geojson, .json, .obj, .ply",
        ),
        ("a.geojson", "planes", OF_SURFACES, "its formats: .json, .obj"),
        ("a.ply", "edges", OF_LAYERS, "tofmix surfaces"),
        ("a.ply", "image", OF_LAYERS, "--what image cannot be written as .ply"),
        ("a.obj", None, OF_LAYERS, "must end in one of .las"),
    ],
)
def test_content_that_the_extension_excludes_is_refused(
    name: str, what: str | None, known: dict[str, tuple[str, ...]], text: str
) -> None:
    with pytest.raises(UsageError, match=text):
        choose_what(Path(name), what, known)
