"""`tofmix map` and `tofmix export`: grids, points and images of real estimates, and refusals."""

import csv
import json
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from support import naive_png
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
    shown = tofmix.done("map", layers, "-o", tmp_path / "a.yaml", "--cell", 100)
    assert "cells of 100 mm; occupied" in shown.out
    places = occupied_x(tmp_path / "a.yaml")
    assert places
    assert all(abs(x - 1.2) <= 0.15 or abs(x - 3.0) <= 0.15 for x in places)
    arguments = ("--from", "averaged", "--recording", tmp_path / "a.h5", "--cell", 100)
    tofmix.done("map", layers, "-o", tmp_path / "averaged.yaml", *arguments)
    assert any(1.5 < x < 2.8 for x in occupied_x(tmp_path / "averaged.yaml"))


def test_a_thin_beam_has_one_surface(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    arguments = ("--from", "thin-beam", "--recording", tmp_path / "a.h5", "--cell", 100, "--window", 1)
    tofmix.done("map", layers, "-o", tmp_path / "thin.yaml", *arguments)
    assert {1.15, 1.25} & occupied_x(tmp_path / "thin.yaml")


def test_both_maps_have_json_and_repeatable_bytes(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    for name, workers in (("a", 1), ("b", 3)):
        outputs = "-o", tmp_path / f"{name}.yaml", "--voxels", tmp_path / f"{name}.npz"
        shown = tofmix.done("map", layers, *outputs, "--json", "--cell", 100, "--workers", workers)
        said = json.loads(shown.out)
        assert sum(said["map"][state] for state in ("occupied", "unknown", "free")) == np.prod(said["map"]["shape"])
        assert said["voxels"]["path"].endswith(f"{name}.npz")
    for ending in ("pgm", "npz"):
        assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()
    # Without the voxels the 2-D map is the same.
    tofmix.done("map", layers, "-o", tmp_path / "c.yaml", "--cell", 100)
    assert (tmp_path / "c.pgm").read_bytes() == (tmp_path / "a.pgm").read_bytes()
    with np.load(tmp_path / "a.npz") as voxels:
        assert list(voxels["log_odds"].shape) == said["voxels"]["shape"]


def test_the_pose_moves_and_turns_the_map(tofmix: Tofmix, layers: Path, tmp_path: Path) -> None:
    tofmix.done("map", layers, "-o", tmp_path / "a.yaml", "--cell", 100)
    for name, pose in (("moved", "2000,-500,0"), ("turned", "0,0,90")):
        tofmix.done("map", layers, "-o", tmp_path / f"{name}.yaml", "--cell", 100, "--pose", pose)
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
    tofmix.done("estimate", blind)
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
        tofmix("map", *arguments).refused(code, text)
    assert not (tmp_path / "a.yaml").exists()
    assert not (tmp_path / "a.pgm").exists()
    assert (tmp_path / "old.pgm").read_text() == "old"


FOV = {"fov_horizontal_deg": 40.0, "fov_vertical_deg": 30.0}


def estimated(tofmix: Tofmix, folder: Path, **attributes: float) -> Path:
    """Layers of two windows of 2 boards."""
    recording = write_recording(folder / "a.h5", boards(60), attributes=attributes)
    tofmix.done("estimate", recording, "--window", 30)
    return folder / "a.layers.h5"


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_exported_points_equal_the_layers(tofmix: Tofmix, tmp_path: Path) -> None:
    layers = estimated(tofmix, tmp_path, **FOV)
    shown = tofmix.done("export", layers, "-o", tmp_path / "a.csv")
    rows = rows_of(tmp_path / "a.csv")
    assert shown.out == f"{tmp_path / 'a.csv'}: {len(rows)} points of 2 windows\n"
    with h5py.File(layers) as root:
        assert len(rows) == int(root["n_modes"][...].sum())
        for row in rows:
            place = int(row["window"]), int(row["row"]), int(row["col"]), int(row["return_number"]) - 1
            assert np.float32(row["range"]) == root["range"][place]
            assert np.float32(row["range_stderr"]) == root["range_stderr"][place]
            assert int(row["number_of_returns"]) == root["n_modes"][place[:3]]
            xyz = np.array([row["x"], row["y"], row["z"]], dtype=float)
            assert 1000 * np.linalg.norm(xyz) == pytest.approx(float(row["range"]), rel=1e-6)


def test_export_applies_filters_and_windows(tofmix: Tofmix, tmp_path: Path) -> None:
    layers = estimated(tofmix, tmp_path, **FOV)
    tofmix("export", layers, "-o", tmp_path / "all.csv")
    tofmix.done(
        "export", layers, "-o", tmp_path / "some.csv", "--window", 1, "--min-weight", 0.6, "--min-probability", 0.9
    )
    wanted = [
        row
        for row in rows_of(tmp_path / "all.csv")
        if row["window"] == "1" and float(row["weight"]) >= 0.6 and float(row["probability"]) >= 0.9
    ]
    assert 0 < len(wanted) < 48
    assert rows_of(tmp_path / "some.csv") == wanted
    none = tofmix.done("export", layers, "-o", tmp_path / "none.csv", "--min-weight", 1.0)
    assert "no point" in none.err


@pytest.mark.parametrize("suffix", ["las", "laz", "ply", "pcd", "PLY"])
def test_every_point_format_is_written(tofmix: Tofmix, tmp_path: Path, suffix: str) -> None:
    layers = estimated(tofmix, tmp_path, **FOV)
    out = tmp_path / f"a.{suffix}"
    tofmix.done("export", layers, "-o", out)
    tofmix("export", layers, "-o", out).refused(ExitCode.USAGE, "--overwrite")
    tofmix.done("export", layers, "-o", out, "--overwrite")


def test_points_need_a_field_of_view_that_fov_can_give(tofmix: Tofmix, tmp_path: Path) -> None:
    layers = estimated(tofmix, tmp_path)
    out = tmp_path / "a.csv"
    tofmix("export", layers, "-o", out).refused(ExitCode.BAD_INPUT, "--fov HxV")
    assert not out.exists()
    assert tofmix("export", layers, "-o", out, "--fov", "40").code == ExitCode.USAGE
    for form in ("40x30", "40,30"):
        tofmix.done("export", layers, "-o", out, "--fov", form, "--overwrite")
    row = rows_of(out)[0]
    azimuth = np.rad2deg(np.arctan2(float(row["x"]), float(row["z"])))
    assert azimuth == pytest.approx(-2.5 * 40 / 6, abs=1e-4)


def test_image_of_one_layer_has_its_scaled_ranges(tofmix: Tofmix, tmp_path: Path) -> None:
    layers = estimated(tofmix, tmp_path)
    out = tmp_path / "second.png"
    tofmix.done("export", layers, "-o", out, "--window", 1, "--layer", 2, "--scale", 0.5)
    counts, _ = naive_png.decode(out.read_bytes())
    with h5py.File(layers) as root:
        range_mm = root["range"][1, :, :, 1]
    expected = np.where(np.isfinite(range_mm), np.rint(range_mm / 0.5), 0)
    assert expected.any()
    np.testing.assert_array_equal(counts, expected)


def test_export_refuses_options_and_files_with_their_exit_code(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layers = estimated(tofmix, tmp_path, **FOV)
    surfaces = layers.with_name(layers.name.replace(".layers.h5", ".surfaces.h5"))
    before = sorted(tmp_path.iterdir())
    for arguments, code, text in (
        ((layers, "-o", tmp_path / "a.xyz"), ExitCode.USAGE, ".las, .laz"),
        ((layers, "-o", layers), ExitCode.USAGE, "must end in"),
        (
            (layers, "-o", tmp_path / "d.geojson", "--what", "edges"),
            ExitCode.USAGE,
            f"{layers} has no edges: run tofmix surfaces {layers}, then tofmix export {surfaces} -o",
        ),
        ((layers, "-o", tmp_path / "d.obj"), ExitCode.USAGE, f"{layers} has no edges: run tofmix surfaces"),
        ((layers, "-o", tmp_path / "d.obj", "--what", "planes"), ExitCode.USAGE, "d.obj --what planes"),
        ((layers, "-o", tmp_path / "none" / "a.ply"), ExitCode.STORAGE, "no such folder"),
        ((tmp_path / "none.h5", "-o", tmp_path / "a.ply"), ExitCode.BAD_INPUT, "No such file"),
        ((tmp_path / "a.h5", "-o", tmp_path / "a.ply"), ExitCode.BAD_INPUT, "not a layers file"),
        ((layers, "-o", tmp_path / "a.ply", "--window", 2), ExitCode.USAGE, "windows 0 to 1"),
        ((layers, "-o", tmp_path / "a.ply", "--fov", "40"), ExitCode.USAGE, "is not HxV in degrees"),
        ((layers, "-o", tmp_path / "a.ply", "--fov", "40x-1"), ExitCode.USAGE, "is not HxV in degrees"),
        ((layers, "-o", tmp_path / "a.ply", "--fov", "nanx1"), ExitCode.USAGE, "is not HxV in degrees"),
        ((layers, "-o", tmp_path / "a.ply", "--layer", 1), ExitCode.USAGE, "--layer does not belong to .ply"),
        ((layers, "-o", tmp_path / "a.png", "--min-weight", 0), ExitCode.USAGE, "--min-weight does not belong"),
        ((layers, "-o", tmp_path / "a.png"), ExitCode.USAGE, "--window"),
        ((layers, "-o", tmp_path / "a.png", "--window", 0, "--layer", 7), ExitCode.USAGE, "layers 1 to 6"),
        ((layers, "-o", tmp_path / "a.tif", "--window", 0, "--scale", 1e-3), ExitCode.BAD_INPUT, "--scale"),
    ):
        outcome = tofmix("export", *arguments)
        outcome.refused(code, text)
    monkeypatch.setitem(sys.modules, "laspy", None)
    outcome = tofmix("export", layers, "-o", tmp_path / "a.las")
    assert outcome.code == ExitCode.USAGE
    assert outcome.err == "tofmix: LAS needs laspy: pip install 'tofmix[export]'\n"
    assert sorted(tmp_path.iterdir()) == before
