"""`tofmix export`: points and images of real estimates, and refusals."""

import csv
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from support import naive_png
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode

FOV = {"fov_horizontal_deg": 40.0, "fov_vertical_deg": 30.0}


def estimated(tofmix: Tofmix, folder: Path, **attributes: float) -> Path:
    """Layers of two windows of 2 boards."""
    recording = write_recording(folder / "a.h5", boards(60), attributes=attributes)
    assert tofmix("estimate", recording, "--window", 30).code == 0
    return folder / "a.layers.h5"


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_exported_points_equal_the_layers(tofmix: Tofmix, tmp_path: Path) -> None:
    layers = estimated(tofmix, tmp_path, **FOV)
    shown = tofmix("export", layers, "-o", tmp_path / "a.csv")
    assert shown.code == 0, shown.err
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
    shown = tofmix(
        "export", layers, "-o", tmp_path / "some.csv", "--window", 1, "--min-weight", 0.6, "--min-probability", 0.9
    )
    assert shown.code == 0, shown.err
    wanted = [
        row
        for row in rows_of(tmp_path / "all.csv")
        if row["window"] == "1" and float(row["weight"]) >= 0.6 and float(row["probability"]) >= 0.9
    ]
    assert 0 < len(wanted) < 48
    assert rows_of(tmp_path / "some.csv") == wanted
    none = tofmix("export", layers, "-o", tmp_path / "none.csv", "--min-weight", 1.0)
    assert none.code == 0
    assert "no point" in none.err


@pytest.mark.parametrize("suffix", ["las", "laz", "ply", "pcd", "PLY"])
def test_every_point_format_is_written(tofmix: Tofmix, tmp_path: Path, suffix: str) -> None:
    layers = estimated(tofmix, tmp_path, **FOV)
    out = tmp_path / f"a.{suffix}"
    assert tofmix("export", layers, "-o", out).code == 0
    refused = tofmix("export", layers, "-o", out)
    assert refused.code == ExitCode.USAGE
    assert "--overwrite" in refused.err
    assert tofmix("export", layers, "-o", out, "--overwrite").code == 0


def test_points_need_a_field_of_view_that_fov_can_give(tofmix: Tofmix, tmp_path: Path) -> None:
    layers = estimated(tofmix, tmp_path)
    out = tmp_path / "a.csv"
    refused = tofmix("export", layers, "-o", out)
    assert refused.code == ExitCode.BAD_INPUT
    assert "--fov HxV" in refused.err
    assert not out.exists()
    assert tofmix("export", layers, "-o", out, "--fov", "40").code == ExitCode.USAGE
    for form in ("40x30", "40,30"):
        assert tofmix("export", layers, "-o", out, "--fov", form, "--overwrite").code == 0
    row = rows_of(out)[0]
    azimuth = np.rad2deg(np.arctan2(float(row["x"]), float(row["z"])))
    assert azimuth == pytest.approx(-2.5 * 40 / 6, abs=1e-4)


def test_image_of_one_layer_has_its_scaled_ranges(tofmix: Tofmix, tmp_path: Path) -> None:
    layers = estimated(tofmix, tmp_path)
    out = tmp_path / "second.png"
    shown = tofmix("export", layers, "-o", out, "--window", 1, "--layer", 2, "--scale", 0.5)
    assert shown.code == 0, shown.err
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
        assert outcome.code == code, arguments
        assert text in outcome.err
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
    monkeypatch.setitem(sys.modules, "laspy", None)
    outcome = tofmix("export", layers, "-o", tmp_path / "a.las")
    assert outcome.code == ExitCode.USAGE
    assert outcome.err == "tofmix: LAS needs laspy: pip install 'tofmix[export]'\n"
    assert sorted(tmp_path.iterdir()) == before
