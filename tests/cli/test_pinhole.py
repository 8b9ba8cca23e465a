"""A pinhole camera through the commands: intrinsics from bags and calibration files, and walls that are flat again."""

import csv
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support import lens
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode

MODEL = """\
[sensor]
profile = "sr4000"
rows = 24
cols = 32
projection = "pinhole"
fx = 22.8
fy = 23.0
cx = 15.2
cy = 11.8
distortion = [-0.1, 0.0, 0.0, 0.0, 0.0]
[recording]
frames = 60
[[surface]]
name = "board"
center_mm = [-500.0, 100.0, 1500.0]
size_mm = [700.0, 900.0]
yaw_deg = 10.0
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 2500.0]
size_mm = [9000.0, 9000.0]
"""
EQUAL_ANGLES = """\
[sensor]
profile = "sr4000"
rows = 24
cols = 32
fov_horizontal_deg = 70.0
fov_vertical_deg = 55.0
""" + MODEL[MODEL.index("[recording]") :]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pinhole")


@pytest.fixture
def recording(tofmix: Tofmix, folder: Path) -> Path:
    (folder / "model.toml").write_text(MODEL)
    if not (folder / "a.h5").exists():
        tofmix.done("simulate", folder / "model.toml", "-o", folder / "a.h5")
    return folder / "a.h5"


@pytest.fixture
def layers(tofmix: Tofmix, recording: Path, folder: Path) -> Path:
    if not (folder / "a.layers.h5").exists():
        tofmix.done("estimate", recording)
    return folder / "a.layers.h5"


def test_recording_and_layers_store_the_pinhole(recording: Path, layers: Path) -> None:
    for path in (recording, layers):
        with h5py.File(path) as file:
            about = file["sensor"].attrs
            assert about["projection"] == "pinhole"
            assert [about[key] for key in ("fx", "fy", "cx", "cy")] == [22.8, 23.0, 15.2, 11.8]
            np.testing.assert_array_equal(about["distortion"], [-0.1, 0.0, 0.0, 0.0, 0.0])
            assert np.isnan(about["fov_horizontal_deg"])


def test_explain_and_info_print_the_field_of_view(tofmix: Tofmix, recording: Path, folder: Path) -> None:
    shown = tofmix("simulate", folder / "model.toml", "--explain")
    assert "24 x 32 pixels over 73.2 x 56.5 degrees of a pinhole with distortion" in shown.out
    shown = tofmix("info", recording, "--json")
    about = json.loads(shown.out)
    assert about["sensor"]["projection"] == "pinhole"
    assert about["sensor"]["distortion"] == [-0.1, 0.0, 0.0, 0.0, 0.0]
    assert not [w for w in about["warnings"] if "view" in w["code"]]


def test_exported_points_of_the_wall_lie_on_it(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    tofmix.done("export", layers, "-o", tmp_path / "a.csv", "--min-probability", 0.999)
    with (tmp_path / "a.csv").open() as file:
        points = [{key: float(value) for key, value in line.items()} for line in csv.DictReader(file)]
    wall = [p for p in points if p["z"] > 2.3]
    assert len(wall) > 500
    off = np.array([1000 * p["z"] - 2500 for p in wall])
    errors = np.array([p["range_stderr"] for p in wall])
    assert np.abs(np.median(off)) < 0.5
    assert (np.abs(off) < 5 * errors + 2).all()


@pytest.mark.slow
def test_map_report_and_inspect_take_a_pinhole(tofmix: Tofmix, recording: Path, layers: Path, tmp_path: Path) -> None:
    made = tofmix.done("map", layers, "-o", tmp_path / "a.yaml", "--cell", 100, "--json")
    assert json.loads(made.out)["map"]["occupied"] > 20
    tofmix.done("inspect", layers, "--pixel", "12,10", "--recording", recording)
    tofmix.done("report", layers, "--html", tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert "pinhole, fx" in page
    assert "22.8 pixels" in page


@pytest.mark.slow
def test_right_model_agrees_and_another_projection_is_noted(
    tofmix: Tofmix, recording: Path, folder: Path, tmp_path: Path
) -> None:
    made = tofmix.done("reconcile", folder / "model.toml", recording, "-o", tmp_path / "gap", "--seed", 3)
    assert "degrees beside" not in made.err
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "agree"
    (tmp_path / "other.toml").write_text(EQUAL_ANGLES)
    made = tofmix.done(
        "reconcile", tmp_path / "other.toml", recording, "-o", tmp_path / "other", "--effects", "range_offset"
    )
    assert "its pixels see 73.2 x 56.5 degrees of a pinhole with distortion; the model's see" in made.err
    assert json.loads((tmp_path / "other" / "gap.json").read_text())["verdict"] != "agree"


@pytest.mark.parametrize(
    ("attributes", "text"),
    [
        ({"fov_horizontal_deg": 400.0, "fov_vertical_deg": 30.0}, "fov_horizontal_deg: 400 is not above 0"),
        pytest.param(
            {"projection": "pinhole", "fx": 3.0, "fy": 3.0, "cx": 2.5, "cy": 1.5, "distortion": [-0.5, 0, 0, 0, 0]},
            "distortion: it folds",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_impossible_optics_are_noted_and_refused_where_needed(
    tofmix: Tofmix, tmp_path: Path, attributes: dict[str, Any], text: str
) -> None:
    path = write_recording(tmp_path / "a.h5", boards(40), attributes=attributes)
    tofmix.done("estimate", path)
    layers = tmp_path / "a.layers.h5"
    for file in (path, layers):
        described = json.loads(tofmix("info", file, "--json").out)
        (found,) = [w for w in described["warnings"] if w["code"] == "unfit_projection"]
        assert text in found["text"]
    tofmix.done("report", layers, "--html", tmp_path / "a.html")
    for command in (("export", layers, "-o", tmp_path / "a.csv"), ("map", layers, "-o", tmp_path / "a.yaml")):
        refused = tofmix(*command)
        assert refused.code == ExitCode.BAD_INPUT
        assert refused.err.startswith(f"tofmix: {layers}: ")
        assert text in refused.err
        assert refused.err.count("\n") == 1


ROS = """\
image_width: 6
image_height: 4
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: [5.0, 0.0, 2.4,
         0.0, 5.5, 1.4, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.02, 1e-3, 0.001, -0.001, 0.0]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix:
  rows: 3
  cols: 4
  data: [4.8, 0, 2.3, 0, 0, 5.2, 1.3, 0, 0, 0, 1, 0]
"""
OPENCV = """\
%YAML:1.0
---
image_width: 6
image_height: 4
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5., 0., 2.4, 0., 5.5, 1.4, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.02, 1.0e-03, 0.001, -0.001, 0. ]
"""
ECHOED = """\
height: 8
width: 18
distortion_model: plumb_bob
d: [-0.02, 0.001, 0.001, -0.001, 0.0]
k: [10.0, 0.0, 6.8, 0.0, 11.0, 3.8, 0.0, 0.0, 1.0]
p:
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
- 0.0
binning_x: 2
binning_y: 2
roi: {x_offset: 2, y_offset: 1, height: 8, width: 12, do_rectify: false}
"""
WHOLE = (5.0, 5.5, 2.4, 1.4)


@pytest.mark.parametrize(("text", "expected"), [(ROS, WHOLE), (OPENCV, WHOLE), (ECHOED, (5.0, 5.5, 2.4, 1.4))])
def test_calibration_file_sets_the_pixel_directions(
    tofmix: Tofmix, tmp_path: Path, text: str, expected: tuple[float, ...]
) -> None:
    (tmp_path / "lens.yaml").write_text(text)
    np.save(tmp_path / "depth.npy", np.full((3, 4, 6), 2000, dtype=np.uint16))
    arguments = ("import", tmp_path / "depth.npy", "-o", tmp_path / "r.h5", "--intrinsics", tmp_path / "lens.yaml")
    tofmix.done(*arguments, "--depth-axis", "z")
    row, col = np.mgrid[:4, :6].astype(float)
    keys = dict(zip(("fx", "fy", "cx", "cy"), expected, strict=True))
    beam, _ = lens.beams(row, col, **keys, distortion=(-0.02, 0.001, 0.001, -0.001, 0.0))
    with h5py.File(tmp_path / "r.h5") as file:
        np.testing.assert_allclose(file["range"][0], 2000 / beam[..., 2], rtol=1e-6)
        about = file["sensor"].attrs
        assert about["projection"] == "pinhole"
        np.testing.assert_allclose([about[key] for key in keys], expected)
        np.testing.assert_allclose(about["distortion"], [-0.02, 0.001, 0.001, -0.001, 0.0])
    tofmix.done(*arguments, "--overwrite")
    with h5py.File(tmp_path / "r.h5") as file:
        assert (file["range"][...] == 2000).all()
        assert file["sensor"].attrs["fx"] == 5.0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: [1", "cannot be read"),
        ("[1, 2]", "no table of keys"),
        ("image_width: 6", "it has no camera_matrix"),
        (ROS.replace("[5.0, 0.0,", "["), "a camera matrix of 7 and a projection of 12 numbers"),
        (ROS.replace("[5.0,", "[a,"), "not made of numbers"),
        (ROS.replace("[5.0,", "[.inf,"), "not finite"),
        (ROS.replace("[5.0,", "[0.0,").replace("[4.8,", "[0,"), "not calibrated"),
        (ROS.replace("image_width: 6", "image_width: 640"), "describes 4 x 640 pixels, the depths have 4 x 6"),
        (ROS.replace("image_width: 6", "image_width: six"), "'six' is not a whole number"),
        (ROS.replace("plumb_bob", "equidistant"), "distortion model equidistant is not a pinhole's"),
        (
            ROS.replace("0.001, -0.001, 0.0]", "0, 0, 0, 0, 0, 0, 0.1]"),
            "thin prisms and tilted sensors are not supported",
        ),
        (ROS.replace("-0.02,", "-2,"), "distortion: it folds"),
        ("!!python/object/apply:os.system ['true']", "cannot be read"),
        ("[" * 10_000, "cannot be read"),
        (" " * 1_000_001, "a calibration has no more than"),
    ],
)
def test_invalid_calibration_is_refused_in_one_line(tofmix: Tofmix, tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "lens.yaml").write_text(text)
    np.save(tmp_path / "depth.npy", np.full((3, 4, 6), 2000, dtype=np.uint16))
    arguments = ("import", tmp_path / "depth.npy", "-o", tmp_path / "r.h5", "--intrinsics", tmp_path / "lens.yaml")
    done = tofmix(*arguments)
    done.refused(ExitCode.BAD_INPUT, reason)
    assert done.err.startswith(f"tofmix: {tmp_path / 'lens.yaml'}: ")
    assert done.err.count("\n") == 1
    assert not (tmp_path / "r.h5").exists()


def test_sensor_projection_is_used_for_its_image_size_only(tofmix: Tofmix, tmp_path: Path) -> None:
    text = 'projection = "pinhole"\nfx = 5.0\nfy = 5.5\ncx = 2.4\ncy = 1.4\n'
    np.save(tmp_path / "depth.npy", np.full((3, 4, 6), 2000, dtype=np.uint16))
    for rows, known in ((4, True), (5, False)):
        (tmp_path / "camera.toml").write_text(f"[sensor]\nrows = {rows}\ncols = 6\n{text}")
        out = tmp_path / f"{rows}.h5"
        done = tofmix.done("import", tmp_path / "depth.npy", "-o", out, "--sensor", tmp_path / "camera.toml")
        assert ("projection is not used" in done.err) != known
        assert ("not known: field of view" in done.out) != known
        with h5py.File(out) as file:
            assert ("projection" in file["sensor"].attrs) == known


WALL_MM, SHAPE_VIEW_PROJECTION, VIEW = 2500.0, (6, 8), "64x50"


@pytest.fixture
def layers_view_projection(tofmix: Tofmix, tmp_path: Path) -> Path:
    """Layers of a flat wall, whose ranges are along the beams of an ideal pinhole; their file knows no lens."""
    rows, cols = SHAPE_VIEW_PROJECTION
    x = (np.arange(cols) - (cols - 1) / 2) / (cols / 2) * np.tan(np.radians(32.0))
    y = (np.arange(rows) - (rows - 1) / 2) / (rows / 2) * np.tan(np.radians(25.0))
    ranges = WALL_MM * np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    noise = np.random.default_rng(5).normal(0.0, 1.0, (40, *SHAPE_VIEW_PROJECTION))
    np.save(tmp_path / "wall.npy", ranges + noise)
    tofmix.done("import", tmp_path / "wall.npy", "-o", tmp_path / "wall.h5")
    tofmix.done("estimate", tmp_path / "wall.h5")
    return tmp_path / "wall.layers.h5"


def depths_mm(path: Path) -> np.ndarray:
    names = path.read_text().splitlines()[0].split(",")
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=names.index("z")) * 1000.0


def test_wall_seen_by_a_pinhole_is_exported_flat(tofmix: Tofmix, layers_view_projection: Path) -> None:
    output = layers_view_projection.with_name("wall.csv")
    done = tofmix.done("export", layers_view_projection, "-o", output, "--fov", VIEW, "--projection", "pinhole")
    assert "placed by an ideal pinhole of 64 x 50 degrees" in done.out
    assert np.abs(depths_mm(output) - WALL_MM).max() < 1.0
    done = tofmix("export", layers_view_projection, "-o", output, "--fov", VIEW, "--overwrite")
    assert "placed by field of view 64 x 50 degrees, equal angles" in done.out
    assert np.ptp(depths_mm(output)) > 30.0


def test_surfaces_take_the_view_of_a_file_that_has_none(tofmix: Tofmix, layers_view_projection: Path) -> None:
    assert tofmix("surfaces", layers_view_projection).code == ExitCode.BAD_INPUT
    done = tofmix.done("surfaces", layers_view_projection, "--fov", VIEW, "--projection", "pinhole")
    assert "1 surface" in done.out
    assert "an ideal pinhole of 64 x 50 degrees" in done.out
    planes = layers_view_projection.with_name("wall.json")
    tofmix.done("export", layers_view_projection.with_name("wall.surfaces.h5"), "-o", planes, "--what", "planes")
    (plane,) = json.loads(planes.read_text())["surfaces"]
    assert abs(abs(plane["offset_mm"]) - WALL_MM) < 1.0
