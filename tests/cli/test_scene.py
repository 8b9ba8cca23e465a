"""`tofmix scene`: options, what is printed, and refusals."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.commandline import Estimated, Tofmix
from support.files import boards
from support.planes_found import COLS, FACTOR, LAYERS, ROWS, SENSOR, board_and_wall

from tofmix.io.surfaces_file import SurfacesWriter
from tofmix.sensor import NoiseCurve
from tofmix.surfaces.found import SurfacesProvenance


@pytest.fixture
def surfaces(tmp_path: Path) -> Path:
    """A surfaces file with a board before a wall, of a camera with noise whose integration time is not known."""
    sensor = replace(SENSOR, noise=NoiseCurve(np.array([500.0]), np.array([4.0])))
    made = SurfacesProvenance(source="a.layers.h5", source_sha256="ab" * 32, version="9.9", sensor=sensor)
    path = tmp_path / "a.surfaces.h5"
    with SurfacesWriter(path, shape=(1, ROWS, COLS), max_layers=LAYERS, factor=FACTOR, provenance=made) as writer:
        writer.write(board_and_wall())
    return path


def test_model_is_written_and_simulate_takes_it(tofmix: Tofmix, surfaces: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene.toml"
    shown = tofmix("scene", surfaces, "--planes", "-o", out)
    assert shown.code == 0, shown.err
    assert shown.out == f"{out}: 2 surfaces; a share changes by more than 0.1 in 0 of 48 pixels\n"
    assert shown.err == (
        f"tofmix: {surfaces}: integration_time_ms is not known: 1 is written, for which the noise holds\n"
    )
    assert tofmix("simulate", out, "-o", tmp_path / "again.h5", "--frames", 3).code == 0


def test_json_has_the_counts_and_quiet_leaves_out_the_notes(tofmix: Tofmix, surfaces: Path, tmp_path: Path) -> None:
    shown = tofmix("scene", surfaces, "--planes", "-o", tmp_path / "scene.toml", "--json", "--quiet")
    assert shown.code == 0
    assert shown.err == ""
    said = json.loads(shown.out)
    assert said.pop("notes")
    assert said == {
        "output": str(tmp_path / "scene.toml"),
        "window": 0,
        "surfaces": 2,
        "smooth_surfaces": 0,
        "hidden_surfaces": 0,
        "covering_surfaces": 0,
        "suspect_left_out": 0,
        "pixels": 48,
        "pixels_changed": 0,
    }


def test_surfaces_without_planes_are_refused_with_the_remedy(tofmix: Tofmix, surfaces: Path, tmp_path: Path) -> None:
    shown = tofmix("scene", surfaces, "-o", tmp_path / "scene.toml")
    assert shown.code == 3
    assert "or --planes" in shown.err
    assert not (tmp_path / "scene.toml").exists()


def test_layers_are_the_scene_without_planes(tofmix: Tofmix, estimated: Estimated, tmp_path: Path) -> None:
    view = {"fov_horizontal_deg": 24.0, "fov_vertical_deg": 16.0}
    layers, out = estimated(boards(), window=30, attributes=view), tmp_path / "scene.toml"
    shown = tofmix("scene", layers, "-o", out)
    assert shown.code == 0, shown.err
    assert (tmp_path / "scene.layers.h5").read_bytes() == layers.read_bytes()
    assert 'layers = "scene.layers.h5"' in out.read_text()
    assert tofmix("verify", out).code == 0
    assert tofmix("info", out).code == 0
    assert tofmix("simulate", out, "-o", tmp_path / "again.h5", "--frames", 3).code == 0
    assert "scene: as measured" in tofmix("simulate", out, "--explain").out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[scene]\nlayers = "b.layers.h5"\n', "no such file beside the model"),
        ('[scene]\nlayers = "../a.layers.h5"\n', "expected a path within the model's folder"),
        ('[scene]\nlayers = "a.layers.h5"\nwindow = 4\n', "window: 4"),
        ('[scene]\nlayers = "a.layers.h5"\nwidth = 4\n', "is not a key here"),
        ('[scene]\nlayers = "a.layers.h5"\n[sensor]\nprofile = "sr3000"\n', "those of the layers of [scene]"),
        ('[scene]\nlayers = "a.layers.h5"\nevery = 0\n', "not at least 1"),
        ('[scene]\nlayers = "a.layers.h5"\nsurfaces = "a.layers.h5"\n', "a.layers.h5"),
    ],
)
def test_wrong_scene_is_refused_in_one_line(
    tofmix: Tofmix, estimated: Estimated, tmp_path: Path, text: str, said: str
) -> None:
    estimated(boards(), window=30)
    model = tmp_path / "model.toml"
    model.write_text(text)
    shown = tofmix("verify", model)
    assert shown.code == 3
    refused = tofmix("simulate", model, "-o", tmp_path / "x.h5")
    assert refused.code == 3
    assert said in refused.err
    assert refused.err.count("\n") == 1


def test_an_output_that_exists_is_replaced_only_with_overwrite(tofmix: Tofmix, surfaces: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene.toml"
    out.write_text("mine")
    shown = tofmix("scene", surfaces, "--planes", "-o", out)
    assert shown.code == 2
    assert "pass --overwrite" in shown.err
    assert out.read_text() == "mine"
    assert tofmix("scene", surfaces, "--planes", "-o", out, "--overwrite").code == 0
    assert "[[surface]]" in out.read_text()


def test_bad_input_is_one_line_and_exit_code_3(tofmix: Tofmix, estimated: Estimated, tmp_path: Path) -> None:
    text = tmp_path / "text.h5"
    text.write_text("no HDF5")
    without_view = estimated(boards(40), window=40)
    refusals = {
        text: "HDF5",
        tmp_path / "missing.h5": "No such file",
        without_view: f"give them to tofmix surfaces {without_view} --fov HxV",
        tmp_path / "a.h5": "import it with --fov HxV",
    }
    for source, words in refusals.items():
        shown = tofmix("scene", source, "--planes", "-o", tmp_path / "scene.toml")
        assert shown.code == 3
        assert words in shown.err
        assert shown.err.count("\n") == 1
        assert not (tmp_path / "scene.toml").exists()
