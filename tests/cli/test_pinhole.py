"""A pinhole camera through the commands: simulate, estimate, info, export, map, inspect, report, reconcile."""

import csv
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
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
        made = tofmix("simulate", folder / "model.toml", "-o", folder / "a.h5")
        assert made.code == 0, made.err
    return folder / "a.h5"


@pytest.fixture
def layers(tofmix: Tofmix, recording: Path, folder: Path) -> Path:
    if not (folder / "a.layers.h5").exists():
        made = tofmix("estimate", recording)
        assert made.code == 0, made.err
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
    made = tofmix("export", layers, "-o", tmp_path / "a.csv", "--min-probability", 0.999)
    assert made.code == 0, made.err
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
    made = tofmix("map", layers, "-o", tmp_path / "a.yaml", "--cell", 100, "--json")
    assert made.code == 0, made.err
    assert json.loads(made.out)["map"]["occupied"] > 20
    assert tofmix("inspect", layers, "--pixel", "12,10", "--recording", recording).code == 0
    made = tofmix("report", layers, "--html", tmp_path / "a.html")
    assert made.code == 0, made.err
    page = (tmp_path / "a.html").read_text()
    assert "pinhole, fx" in page
    assert "22.8 pixels" in page


@pytest.mark.slow
def test_right_model_agrees_and_another_projection_is_noted(
    tofmix: Tofmix, recording: Path, folder: Path, tmp_path: Path
) -> None:
    made = tofmix("reconcile", folder / "model.toml", recording, "-o", tmp_path / "gap", "--seed", 3)
    assert made.code == 0, made.err
    assert "degrees beside" not in made.err
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "agree"
    (tmp_path / "other.toml").write_text(EQUAL_ANGLES)
    made = tofmix(
        "reconcile", tmp_path / "other.toml", recording, "-o", tmp_path / "other", "--effects", "range_offset"
    )
    assert made.code == 0, made.err
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
    assert tofmix("estimate", path).code == 0
    layers = tmp_path / "a.layers.h5"
    for file in (path, layers):
        described = json.loads(tofmix("info", file, "--json").out)
        (found,) = [w for w in described["warnings"] if w["code"] == "unfit_projection"]
        assert text in found["text"]
    made = tofmix("report", layers, "--html", tmp_path / "a.html")
    assert made.code == 0, made.err
    for command in (("export", layers, "-o", tmp_path / "a.csv"), ("map", layers, "-o", tmp_path / "a.yaml")):
        refused = tofmix(*command)
        assert refused.code == ExitCode.BAD_INPUT
        assert refused.err.startswith(f"tofmix: {layers}: ")
        assert text in refused.err
        assert refused.err.count("\n") == 1
