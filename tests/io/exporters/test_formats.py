"""Every exported format, read back by a program that shares no code with its writer."""

import csv
import struct
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import plyfile
import pytest
from PIL import Image
from pypcd4.pypcd4 import PointCloud
from support import naive_png
from support.made_up import LayersInMemory, made_up_layers

from tofmix.errors import BadInputError, UsageError
from tofmix.io.exporters import POINT_WRITERS, export_image, export_points
from tofmix.io.exporters.clouds import SCALE_M
from tofmix.io.exporters.image import RangeImage
from tofmix.optics.equiangular import Equiangular
from tofmix.points import POINT_DTYPE, LayerPoints, PointArray, fields_of_names

SHAPE, MAX_LAYERS = (3, 6, 7), 4
VIEW: dict[str, Any] = {"optics": Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0)}
NAMES = POINT_DTYPE.names or ()
COORDINATES = ("x", "y", "z")


def points_of(shape: tuple[int, int, int] = SHAPE, max_layers: int = MAX_LAYERS) -> LayerPoints:
    return LayerPoints(LayersInMemory(made_up_layers(shape, max_layers)), **VIEW)


def written(path: Path, points: LayerPoints) -> PointArray:
    """Write the points; return what must be in the file."""
    expected = np.concatenate(list(points))
    assert export_points(path, points, title="a test") == len(expected) > 0
    assert list(path.parent.iterdir()) == [path]
    return expected


def assert_same(read: Any, expected: PointArray, names: tuple[str, ...] = NAMES) -> None:  # noqa: ANN401  any record
    assert len(read) == len(expected)
    for name in names:
        np.testing.assert_array_equal(np.asarray(read[name]), expected[name], err_msg=name)


def test_ply_reads_back_points_and_shares(tmp_path: Path) -> None:
    expected = written(tmp_path / "a.ply", points_of())
    (vertices,) = plyfile.PlyData.read(tmp_path / "a.ply").elements
    assert vertices.name == "vertex"
    assert tuple(prop.name for prop in vertices.properties) == NAMES
    assert vertices.data.dtype == POINT_DTYPE
    assert_same(vertices.data, expected)


def test_pcd_reads_back_points_and_shares(tmp_path: Path) -> None:
    expected = written(tmp_path / "a.pcd", points_of())
    cloud = PointCloud.from_path(tmp_path / "a.pcd")
    assert cloud.fields == NAMES
    assert cloud.points == len(expected)
    assert_same(cloud.pc_data, expected)


def test_csv_reads_back_points_and_shares(tmp_path: Path) -> None:
    expected = written(tmp_path / "a.csv", points_of())
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == NAMES
    for name in NAMES:
        read = np.array([row[name] for row in rows]).astype(POINT_DTYPE[name])
        np.testing.assert_array_equal(read, expected[name], err_msg=name)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_reads_back_with_laspy(tmp_path: Path, suffix: str) -> None:
    expected = written(tmp_path / f"a{suffix}", points_of())
    read = laspy.read(tmp_path / f"a{suffix}")
    assert str(read.header.version) == "1.4"
    assert read.header.point_format.id == 6
    assert read.header.are_points_compressed == (suffix == ".laz")
    assert_same(read, expected, tuple(name for name in NAMES if name not in COORDINATES))
    for axis, values in zip(COORDINATES, read.xyz.T, strict=True):
        np.testing.assert_allclose(values, expected[axis].astype("f8"), rtol=0, atol=0.5001 * SCALE_M)
    np.testing.assert_allclose(np.asarray(read.intensity) / 65535, expected["weight"], atol=1e-5)
    assert read.header.number_of_points_by_return[:MAX_LAYERS].tolist() == [
        int((expected["return_number"] == k + 1).sum()) for k in range(MAX_LAYERS)
    ]


def test_las_bytes_follow_the_standard(tmp_path: Path) -> None:
    expected = written(tmp_path / "a.las", points_of())
    data = (tmp_path / "a.las").read_bytes()
    assert data[:4] == b"LASF"
    assert data[24:26] == bytes([1, 4])
    assert struct.unpack_from("<HH", data, 90) == (1, 1970)  # no clock in the file
    offset, kind, length = struct.unpack_from("<I", data, 96)[0], data[104], struct.unpack_from("<H", data, 105)[0]
    scales, offsets = struct.unpack_from("<3d", data, 131), struct.unpack_from("<3d", data, 155)
    assert (kind, scales, offsets) == (6, (1e-6,) * 3, (0.0,) * 3)
    assert struct.unpack_from("<Q", data, 247)[0] == len(expected)
    own = [("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"), ("intensity", "<u2"), ("returns", "u1"), ("rest", "V15")]
    extra = [
        (name, POINT_DTYPE[name]) for name in NAMES if name not in (*COORDINATES, "return_number", "number_of_returns")
    ]
    record = np.dtype(own + extra)
    assert record.itemsize == length
    read = np.frombuffer(data, dtype=record, count=len(expected), offset=offset)
    np.testing.assert_array_equal(read["returns"] & 15, expected["return_number"])
    np.testing.assert_array_equal(read["returns"] >> 4, expected["number_of_returns"])
    assert_same(read, expected, tuple(name for name, _ in extra))
    for axis in COORDINATES:
        np.testing.assert_array_equal(read[axis.upper()], np.rint(expected[axis].astype("f8") * 1e6))


@pytest.mark.parametrize("suffix", POINT_WRITERS)
def test_the_same_layers_give_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in ("a", "b"):
        export_points(tmp_path / f"{name}{suffix}", points_of(), title="a test")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".las"])
def test_a_title_cannot_end_a_header(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    export_points(path, points_of(), title="näme\nend_header\nDATA ascii\n")
    first = np.concatenate(list(points_of()))["x"]
    read: Any
    if suffix == ".ply":
        read = plyfile.PlyData.read(path)["vertex"].data["x"]
    elif suffix == ".pcd":
        read = PointCloud.from_path(path).pc_data["x"]
    else:
        read = laspy.read(path)["range"]
        first = np.concatenate(list(points_of()))["range"]
    np.testing.assert_array_equal(read, first)


def test_las_holds_fifteen_returns_and_two_kilometres(tmp_path: Path) -> None:
    layers = made_up_layers((1, 1, 2), 16)
    layers.n_modes[...] = 15
    layers.range[..., :15] = np.arange(1000.0, 2500.0, 100.0)
    layers.range[..., 15:] = np.nan
    path = tmp_path / "a.las"
    assert export_points(path, LayerPoints(LayersInMemory(layers), **VIEW), title="15") == 30
    assert sorted(set(np.asarray(laspy.read(path).return_number).tolist())) == list(range(1, 16))
    layers.n_modes[...], layers.range[..., 15] = 16, 3000.0
    with pytest.raises(BadInputError, match="16 layers, LAS stores 15"):
        export_points(tmp_path / "b.las", LayerPoints(LayersInMemory(layers), **VIEW), title="16")
    far = made_up_layers((1, 1, 1), 1)
    far.n_modes[...], far.range[...] = 1, 3.0e6
    with pytest.raises(BadInputError, match="3000 m away"):
        export_points(tmp_path / "c.las", LayerPoints(LayersInMemory(far), **VIEW), title="far")
    assert [p.name for p in tmp_path.iterdir()] == ["a.las"]


@pytest.mark.parametrize(
    ("suffix", "module"), [(".las", "laspy"), (".laz", "lazrs"), (".png", "PIL.Image"), (".tif", "tifffile")]
)
def test_a_missing_library_is_named(tmp_path: Path, suffix: str, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    image = RangeImage(range_mm=np.ones((2, 2), "f4"), scale_mm=1.0, title="a test")
    path = tmp_path / f"a{suffix}"
    with pytest.raises(UsageError, match=r"pip install 'tofmix\[export\]'"):
        export_points(path, points_of(), title="") if suffix in POINT_WRITERS else export_image(path, image)
    assert list(tmp_path.iterdir()) == []


def range_image(scale_mm: float) -> RangeImage:
    range_mm = np.random.default_rng(1).uniform(300, 7500, (9, 11)).astype("f4")
    range_mm[2, 3] = np.nan
    return RangeImage(range_mm=range_mm, scale_mm=scale_mm, title="layer 1 of a.h5")


@pytest.mark.parametrize("scale_mm", [1.0, 0.25])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff"])
def test_range_image_reads_back_its_counts(tmp_path: Path, suffix: str, scale_mm: float) -> None:
    image, path = range_image(scale_mm), tmp_path / f"a{suffix}"
    export_image(path, image)
    if suffix == ".png":
        counts, texts = naive_png.decode(path.read_bytes())
        description = texts["Description"]
    else:
        with Image.open(path) as file:  # Pillow, where tifffile wrote
            counts, description = np.asarray(file), str(file.getexif()[270])
    assert counts.dtype == np.uint16
    assert counts[2, 3] == 0
    known = np.isfinite(image.range_mm)
    assert np.abs(counts[known] * scale_mm - image.range_mm[known]).max() <= 0.5 * scale_mm
    assert f"1 count = {scale_mm:g} mm" in description


@pytest.mark.parametrize("scale_mm", [0.1, 20000.0])
def test_ranges_that_do_not_fit_into_16_bits_are_refused(tmp_path: Path, scale_mm: float) -> None:
    with pytest.raises(BadInputError, match="does not fit into 16 bits"):
        export_image(tmp_path / "a.png", range_image(scale_mm))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("brightest", [0.5, 900.0, 1e6])
def test_amplitudes_are_written_and_are_the_intensity(tmp_path: Path, brightest: float) -> None:
    layers = made_up_layers(SHAPE, MAX_LAYERS)
    light = brightest * (layers.weight / np.nanmax(layers.weight))
    source = LayersInMemory(replace(layers, amplitude=light.astype(np.float32)))
    further = fields_of_names(["all"], [spec.name for spec in source.layers.fields])
    for ending in POINT_WRITERS:
        (tmp_path / ending[1:]).mkdir()
        written(tmp_path / ending[1:] / f"a{ending}", LayerPoints(source, **VIEW, further=further, intensity=True))
    expected = np.concatenate(list(LayerPoints(source, **VIEW, further=further, intensity=True)))
    assert_same(plyfile.PlyData.read(tmp_path / "ply/a.ply")["vertex"].data, expected, expected.dtype.names or ())
    assert_same(PointCloud.from_path(tmp_path / "pcd/a.pcd").pc_data, expected, expected.dtype.names or ())
    record = laspy.read(tmp_path / "laz/a.laz")
    np.testing.assert_array_equal(np.asarray(record["amplitude"]), expected["amplitude"])
    scale = 1.0 if brightest == 900.0 else 65535 / expected["amplitude"].max()
    np.testing.assert_allclose(np.asarray(record.intensity), expected["amplitude"] * scale, atol=0.51)
