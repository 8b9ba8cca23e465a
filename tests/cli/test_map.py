"""`tofmix map`: 2-D and 3-D occupancy grids."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.commandline import Estimated, Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode

SEES = {"fov_horizontal_deg": 12.0, "fov_vertical_deg": 8.0}


@pytest.fixture
def layers(estimated: Estimated) -> Path:
    return estimated(boards(40), window=20, attributes=SEES)


def grey(text: Path) -> np.ndarray:
    """The image of a map, row 0 at the least y."""
    about = yaml.safe_load(text.read_text())
    _, size, _, pixels = (text.parent / about["image"]).read_bytes().split(b"\n", 3)
    width, height = (int(n) for n in size.split())
    return np.frombuffer(pixels, dtype=np.uint8).reshape(height, width)[::-1]


def occupied_x(text: Path) -> set[float]:
    """Distances ahead of the camera at which the map has an obstacle, m."""
    about = yaml.safe_load(text.read_text())
    columns = np.nonzero(grey(text) == 0)[1]
    return {round(about["origin"][0] + (column + 0.5) * about["resolution"], 3) for column in columns}


def test_layers_lie_at_the_boards_and_averages_between_them(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    shown = tofmix("map", layers, "-o", tmp_path / "a.yaml", "--cell", 100)
    assert shown.code == 0, shown.err
    assert "cells of 100 mm; occupied" in shown.out
    places = occupied_x(tmp_path / "a.yaml")
    assert places
    assert all(abs(x - 1.2) <= 0.15 or abs(x - 3.0) <= 0.15 for x in places)
    arguments = ("--from", "averaged", "--recording", tmp_path / "a.h5", "--cell", 100)
    assert tofmix("map", layers, "-o", tmp_path / "averaged.yaml", *arguments).code == 0
    assert any(1.5 < x < 2.8 for x in occupied_x(tmp_path / "averaged.yaml"))


def test_a_thin_beam_has_one_surface(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    arguments = ("--from", "thin-beam", "--recording", tmp_path / "a.h5", "--cell", 100, "--window", 1)
    assert tofmix("map", layers, "-o", tmp_path / "thin.yaml", *arguments).code == 0
    assert {1.15, 1.25} & occupied_x(tmp_path / "thin.yaml")


def test_both_maps_have_json_and_repeatable_bytes(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    for name, workers in (("a", 1), ("b", 3)):
        outputs = "-o", tmp_path / f"{name}.yaml", "--voxels", tmp_path / f"{name}.npz"
        shown = tofmix("map", layers, *outputs, "--json", "--cell", 100, "--workers", workers)
        assert shown.code == 0, shown.err
        said = json.loads(shown.out)
        assert sum(said["map"][state] for state in ("occupied", "unknown", "free")) == np.prod(said["map"]["shape"])
        assert said["voxels"]["path"].endswith(f"{name}.npz")
    for ending in ("pgm", "npz"):
        assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()
    # Without the voxels the 2-D map is the same.
    assert tofmix("map", layers, "-o", tmp_path / "c.yaml", "--cell", 100).code == 0
    assert (tmp_path / "c.pgm").read_bytes() == (tmp_path / "a.pgm").read_bytes()
    with np.load(tmp_path / "a.npz") as voxels:
        assert list(voxels["log_odds"].shape) == said["voxels"]["shape"]


def test_the_pose_moves_and_turns_the_map(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    assert tofmix("map", layers, "-o", tmp_path / "a.yaml", "--cell", 100).code == 0
    for name, pose in (("moved", "2000,-500,0"), ("turned", "0,0,90")):
        assert tofmix("map", layers, "-o", tmp_path / f"{name}.yaml", "--cell", 100, "--pose", pose).code == 0
    before = yaml.safe_load((tmp_path / "a.yaml").read_text())["origin"]
    after = yaml.safe_load((tmp_path / "moved.yaml").read_text())["origin"]
    assert np.subtract(after, before).tolist() == pytest.approx([2.0, -0.5, 0.0])
    np.testing.assert_array_equal(grey(tmp_path / "moved.yaml"), grey(tmp_path / "a.yaml"))
    turned, still = grey(tmp_path / "turned.yaml"), grey(tmp_path / "a.yaml")
    assert turned.shape[0] > turned.shape[1]
    assert np.mean(turned.T[::-1] == still) > 0.98  # but for roundings on the cells' borders


def test_another_recording_is_noted(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    other = write_recording(tmp_path / "other.h5", boards(7), attributes=SEES)
    shown = tofmix("map", layers, "-o", tmp_path / "a.yaml", "--from", "averaged", "--recording", other, "--cell", 100)
    assert shown.code == 0
    assert "all its frames are used" in shown.err


def test_map_refuses_options_and_files_with_their_exit_code(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    small = write_recording(tmp_path / "small.h5", boards(20, 2, 2), attributes=SEES)
    blind = write_recording(tmp_path / "blind.h5", boards(20))
    assert tofmix("estimate", blind).code == 0
    (tmp_path / "old.pgm").write_text("old")
    out = ("-o", tmp_path / "a.yaml")
    for arguments, code, text in (
        ((layers,), ExitCode.USAGE, "nothing to write"),
        ((layers, "-o", tmp_path / "a.pgm"), ExitCode.USAGE, "must end in .yaml"),
        ((layers, "-o", tmp_path / "old.yaml"), ExitCode.USAGE, "old.pgm exists"),
        ((layers, "--voxels", tmp_path / "a.las"), ExitCode.USAGE, ".ply or .npz"),
        ((layers, *out, "--from", "averaged"), ExitCode.USAGE, "--recording"),
        ((layers, *out, "--recording", small), ExitCode.USAGE, "--from"),
        ((layers, *out, "--from", "averaged", "--recording", small), ExitCode.BAD_INPUT, "do not match"),
        ((layers, *out, "--from", "averaged", "--recording", tmp_path / "no.h5"), ExitCode.BAD_INPUT, "no.h5"),
        ((tmp_path / "blind.layers.h5", *out), ExitCode.BAD_INPUT, "the directions of its pixels are not known"),
        ((tmp_path / "none.h5", *out), ExitCode.BAD_INPUT, "none.h5"),
        ((layers, *out, "--window", 2), ExitCode.USAGE, "windows 0 to 1"),
        ((layers, *out, "--height", "3"), ExitCode.USAGE, "A,B"),
        ((layers, *out, "--height", "3,x"), ExitCode.USAGE, "A,B"),
        ((layers, *out, "--height", "300,-300"), ExitCode.USAGE, "first must be below"),
        ((layers, *out, "--pose", "1e99,0,0"), ExitCode.USAGE, "x_mm"),
        ((layers, *out, "--cell", 1), ExitCode.USAGE, "take larger cells"),
        ((layers, *out, "--min-share", 0), ExitCode.USAGE, "min-share"),
        ((layers, "-o", tmp_path / "none" / "a.yaml"), ExitCode.STORAGE, "no such folder"),
    ):
        outcome = tofmix("map", *arguments)
        assert outcome.code == code, (arguments, outcome.err)
        assert text in outcome.err
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
    assert not (tmp_path / "a.yaml").exists()
    assert not (tmp_path / "a.pgm").exists()
    assert (tmp_path / "old.pgm").read_text() == "old"


def test_an_input_is_never_replaced(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards(20), attributes=SEES)
    assert tofmix("estimate", recording).code == 0
    (tmp_path / "a.layers.h5").rename(tmp_path / "layers.npz")
    before = (tmp_path / "layers.npz").read_bytes()
    shown = tofmix("map", tmp_path / "layers.npz", "--voxels", tmp_path / "layers.npz", "--overwrite")
    assert shown.code == ExitCode.USAGE
    assert (tmp_path / "layers.npz").read_bytes() == before
