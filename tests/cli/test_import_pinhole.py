"""Intrinsics of bags and of calibration files: a wall comes back flat; and files that are no calibration."""

import csv
import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from support import lens
from support.bags import DEPTH, INFO, new_bag
from support.commandline import Tofmix

from tofmix.errors import ExitCode

SHAPE = (144, 176)
LENS: dict[str, Any] = {
    "fx": 88.0 / math.tan(math.radians(35.0)),
    "fy": 72.0 / math.tan(math.radians(27.5)),
    "cx": 87.5,
    "cy": 71.5,
}
"""70 x 55 degrees over 176 x 144 pixels, before the lens bends them."""

K1 = (-0.1, 0.0, 0.0, 0.0, 0.0)
NORMAL, OFFSET_MM = np.array([0.28, -0.1, 0.954775]) / np.linalg.norm([0.28, -0.1, 0.954775]), 2000.0
"""A wall at 2 m, turned by 17 degrees, so that no error of a direction hides in it."""


def wall(normal: NDArray[np.float64]) -> NDArray[np.float32]:
    """Depth along z (row, col) of the wall normal . x = 2 m, in metres: by the lens of `tests/support/lens.py`."""
    row, col = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    beam, _ = lens.beams(row, col, **LENS, distortion=K1)
    metres: NDArray[np.float32] = (OFFSET_MM / 1000 / (beam @ normal) * beam[..., 2]).astype(np.float32)
    return metres


@pytest.mark.slow
@pytest.mark.parametrize("normal", [np.array([0.0, 0.0, 1.0]), NORMAL], ids=["square", "slanted"])
def test_exported_points_of_a_wall_lie_on_its_plane(tofmix: Tofmix, tmp_path: Path, normal: NDArray[Any]) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, SHAPE, tuple(LENS.values()), distortion=K1)
        for number in range(20):
            bag.image(DEPTH, wall(normal), stamp_ns=(1 + number) * 10**9)
    done = tofmix("import", path, "-o", tmp_path / "wall.h5")
    assert done.code == 0, done.err
    assert done.err == ""
    assert (
        "depths along z converted to ranges by pinhole fx 125.677 fy 138.311 cx 87.5 cy 71.5 distortion -0.1 0 0 0 0"
        in done.out
    )
    with h5py.File(tmp_path / "wall.h5") as file:
        assert file["range"].dtype == np.float32
    done = tofmix("estimate", tmp_path / "wall.h5", "--noise", "sr4000")
    assert done.code == 0, done.err
    done = tofmix("export", tmp_path / "wall.layers.h5", "-o", tmp_path / "wall.csv")
    assert done.code == 0, done.err
    with (tmp_path / "wall.csv").open() as file:
        points = np.array([[float(line[axis]) for axis in "xyz"] for line in csv.DictReader(file)])
    off_mm = np.abs(1000 * points @ normal - OFFSET_MM)
    assert len(points) == SHAPE[0] * SHAPE[1]
    assert off_mm.max() < 0.01


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
    done = tofmix(*arguments, "--depth-axis", "z")
    assert done.code == 0, done.err
    row, col = np.mgrid[:4, :6].astype(float)
    keys = dict(zip(("fx", "fy", "cx", "cy"), expected, strict=True))
    beam, _ = lens.beams(row, col, **keys, distortion=(-0.02, 0.001, 0.001, -0.001, 0.0))
    with h5py.File(tmp_path / "r.h5") as file:
        np.testing.assert_allclose(file["range"][0], 2000 / beam[..., 2], rtol=1e-6)
        about = file["sensor"].attrs
        assert about["projection"] == "pinhole"
        np.testing.assert_allclose([about[key] for key in keys], expected)
        np.testing.assert_allclose(about["distortion"], [-0.02, 0.001, 0.001, -0.001, 0.0])
    done = tofmix(*arguments, "--overwrite")  # ranges along the beam stay as they are; points look as the lens says
    assert done.code == 0, done.err
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
    assert done.code == ExitCode.BAD_INPUT
    assert reason in done.err
    assert done.err.startswith(f"tofmix: {tmp_path / 'lens.yaml'}: ")
    assert done.err.count("\n") == 1
    assert not (tmp_path / "r.h5").exists()


def test_sensor_projection_is_used_for_its_image_size_only(tofmix: Tofmix, tmp_path: Path) -> None:
    text = 'projection = "pinhole"\nfx = 5.0\nfy = 5.5\ncx = 2.4\ncy = 1.4\n'
    np.save(tmp_path / "depth.npy", np.full((3, 4, 6), 2000, dtype=np.uint16))
    for rows, known in ((4, True), (5, False)):
        (tmp_path / "camera.toml").write_text(f"[sensor]\nrows = {rows}\ncols = 6\n{text}")
        out = tmp_path / f"{rows}.h5"
        done = tofmix("import", tmp_path / "depth.npy", "-o", out, "--sensor", tmp_path / "camera.toml")
        assert done.code == 0, done.err
        assert ("projection is not used" in done.err) != known
        assert ("not known: field of view" in done.out) != known
        with h5py.File(out) as file:
            assert ("projection" in file["sensor"].attrs) == known
