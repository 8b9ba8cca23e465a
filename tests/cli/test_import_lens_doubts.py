"""Doubts about a lens that `import` says: radians, a centre outside of the image, and a bag without intrinsics."""

from pathlib import Path

import numpy as np
import pytest
from support.bags import DEPTH, INFO, new_bag
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode


def depths(folder: Path) -> Path:
    np.save(folder / "depths.npy", np.full((3, 10, 12), 1700, dtype=np.uint16))
    return folder / "depths.npy"


def test_a_field_of_view_that_may_be_in_radians_is_said_in_degrees(tofmix: Tofmix, tmp_path: Path) -> None:
    done = tofmix("import", depths(tmp_path), "-o", tmp_path / "o.h5", "--units", "mm", "--fov", "1.1x0.8")
    assert done.code == 0, done.err
    assert "--fov: 1.1 x 0.8 degrees is narrow; in radians: --fov 63.03x45.84" in done.err
    done = tofmix("import", depths(tmp_path), "-o", tmp_path / "p.h5", "--units", "mm", "--fov", "63x45")
    assert done.err == ""


@pytest.mark.parametrize(
    ("fov", "remedy"),
    [
        ("3.3x1.4", "in radians: --fov 189.1x80.21"),
        ("1.1x48", "if 1.1 is in radians: --fov 63.03x48"),
        ("62x0.9", "if 0.9 is in radians: --fov 62x51.57"),
        ("6.4x4", ""),
        ("40x2", ""),  # of 10 rows and 480 columns: in degrees the pixels are nearer to squares
    ],
)
def test_angles_that_may_be_in_radians_are_told_by_the_shape_of_a_pixel(
    tofmix: Tofmix, tmp_path: Path, fov: str, remedy: str
) -> None:
    samples = np.full((3, 10, 480) if fov == "40x2" else (3, 10, 12), 1700, dtype=np.uint16)
    np.save(tmp_path / "depths.npy", samples)
    done = tofmix("import", tmp_path / "depths.npy", "-o", tmp_path / "o.h5", "--fov", fov)
    assert done.code == 0, done.err
    assert done.err.endswith(f"{remedy}\n" if remedy else "")
    assert bool(done.err) == bool(remedy)


def test_export_and_surfaces_say_that_a_field_of_view_may_be_in_radians(tofmix: Tofmix, tmp_path: Path) -> None:
    assert tofmix("estimate", write_recording(tmp_path / "a.h5", boards(20))).code == 0
    layers = tmp_path / "a.layers.h5"
    for command in (("export", layers, "-o", tmp_path / "a.csv"), ("surfaces", layers)):
        done = tofmix(*command, "--fov", "0.7x0.5", "--overwrite")
        assert done.code == 0, done.err
        assert done.err == "tofmix: --fov: 0.7 x 0.5 degrees is narrow; in radians: --fov 40.11x28.65\n"
        assert tofmix(*command, "--fov", "40x30", "--overwrite").err == ""


def test_a_field_of_view_of_ranges_along_the_beam_is_said_to_be_of_equal_angles(tofmix: Tofmix, tmp_path: Path) -> None:
    arguments = ("import", depths(tmp_path), "-o", tmp_path / "o.h5", "--fov", "62x44", "--overwrite")
    for axis, said in (("ray", "62 x 44 degrees, equal angles"), ("z", "an ideal pinhole of 62 x 44 degrees")):
        done = tofmix(*arguments, "--depth-axis", axis)
        assert done.code == 0, done.err
        assert said in done.out


def test_a_centre_far_outside_of_the_image_is_said(tofmix: Tofmix, tmp_path: Path) -> None:
    for centre, said in (("40,30", True), ("5.5,4.5", False)):
        output = tmp_path / f"{said}.h5"
        done = tofmix(
            "import",
            depths(tmp_path),
            "-o",
            output,
            "--units",
            "mm",
            "--depth-axis",
            "z",
            "--intrinsics",
            f"60,60,{centre}",
        )
        assert done.code == 0, done.err
        assert ("--intrinsics: the centre, column 40, row 30, is far outside of the image" in done.err) == said


def test_refusal_of_a_bag_without_a_lens_says_why_it_has_none(tofmix: Tofmix, tmp_path: Path) -> None:
    for topic, reason in ((INFO, f"{INFO}: not calibrated"), ("/rgb/camera_info", "--camera-info takes one of: /rgb")):
        folder = tmp_path / topic.split("/")[1]
        folder.mkdir()
        with new_bag(folder, "mcap") as (bag, path):
            bag.info(topic, (4, 6), (0.0,) * 4)
            bag.image(DEPTH, np.full((4, 6), 800, "u2"), stamp_ns=10**9)
        done = tofmix("import", path, "-o", folder / "o.h5")
        assert done.code == ExitCode.BAD_INPUT
        assert "depths along z need a lens" in done.err
        assert reason in done.err
        assert done.err.count("\n") == 1
