"""Doubts about a lens that `import` says: radians, a centre outside of the image, and a bag without intrinsics."""

from pathlib import Path

import numpy as np
from support.bags import DEPTH, INFO, new_bag
from support.commandline import Tofmix

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


def test_a_centre_far_outside_of_the_image_is_said(tofmix: Tofmix, tmp_path: Path) -> None:
    for centre, said in (("40,30", True), ("5.5,4.5", False)):
        output = tmp_path / f"{said}.h5"
        done = tofmix(
            "import", depths(tmp_path), "-o", output, "--units", "mm", "--depth-axis", "z",
            "--intrinsics", f"60,60,{centre}",
        )  # fmt: skip
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
