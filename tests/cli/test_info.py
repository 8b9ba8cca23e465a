"""`tofmix info`: recordings, layers, models and sensors, as text and as JSON."""

import json
from importlib.resources import files
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode
from tofmix.simulation.builtin import BUILTIN_MODELS

FOV = {"fov_horizontal_deg": 40.0, "fov_vertical_deg": 30.0}


def codes(description: dict[str, list[dict[str, str]]]) -> set[str]:
    """Codes of the warnings."""
    return {warning["code"] for warning in description["warnings"]}


def test_info_prints_shape_and_units_of_a_recording(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(30), attributes=FOV)
    with h5py.File(path, "r+") as root:
        root["time"] = np.arange(30) / 25.0
        root.attrs["title"] = "two boards"
        root.attrs["gain"] = np.nan
    described = json.loads(tofmix("info", path, "--json").out)
    assert described["kind"] == "recording"
    assert described["sizes"] == {"frames": 30, "rows": 4, "cols": 6, "file_bytes": path.stat().st_size}
    assert described["range"]["units"] == "mm"
    assert described["range"]["type"] == "uint16"
    assert described["range"]["invalid_value"] == 0
    assert described["time"]["frame_rate_hz"] == pytest.approx(25)
    assert described["sensor"]["fov_horizontal_deg"] == 40.0
    assert described["sensor"]["noise_sigma_mm"] == [15.0, 15.0]
    assert described["attributes"]["title"] == "two boards"
    assert described["attributes"]["gain"] is None
    assert codes(described) == set()


def test_info_warns_of_missing_range_max_and_noise(tofmix: Tofmix, tmp_path: Path) -> None:
    path = tmp_path / "bare.h5"
    with h5py.File(path, "w") as root:
        root["range"] = boards(4).astype("f4")
        root["time"] = [0.0, 0.1, 0.2, 0.9]
    described = json.loads(tofmix("info", path, "--json").out)
    assert codes(described) == {"no_noise_curve", "no_range_max", "no_field_of_view", "time_gaps"}
    assert described["range"]["invalid_value"] is None
    with h5py.File(path, "r+") as root:
        root["time"][...] = [0.0, 0.3, 0.2, 0.9]
    assert "time_disordered" in codes(json.loads(tofmix("info", path, "--json").out))
    with h5py.File(path, "r+") as root:
        del root["time"]
        root["time"] = [0.0, 0.3]
    refused = tofmix("info", path)
    assert refused.code == ExitCode.BAD_INPUT
    assert "time" in refused.err


def test_info_prints_sizes_options_and_source_of_layers(tofmix: Tofmix, tmp_path: Path) -> None:
    path = tmp_path / "a.layers.h5"
    arguments = ("--window", 20, "--min-samples", 21)
    assert tofmix("estimate", write_recording(tmp_path / "a.h5", boards(45)), *arguments).code == 0
    described = json.loads(tofmix("info", path, "--json").out)
    assert described["kind"] == "layers"
    assert described["sizes"]["windows"] == 2
    assert described["sizes"]["window_frames"] == 20
    assert described["sizes"]["frames_left_out"] == 5
    assert described["options"]["min_samples"] == 21
    assert described["made_from"]["source"] == "a.h5"
    assert codes(described) == {"too_few_samples", "no_surface_anywhere", "no_field_of_view"}


def test_info_prints_models_and_sensors(tofmix: Tofmix, tmp_path: Path) -> None:
    described = json.loads(tofmix("info", "corridor", "--json").out)
    assert described["kind"] == "model"
    assert described["recording"]["frames"] == 100
    assert len(described["scene"]["surfaces"]) == 8
    (tmp_path / "empty.toml").write_text('[sensor]\nprofile = "sr3000"\n')
    assert codes(json.loads(tofmix("info", tmp_path / "empty.toml", "--json").out)) >= {"no_surface"}
    sensor = json.loads(tofmix("info", str(files("tofmix.sensors") / "sr3000.toml"), "--json").out)
    assert sensor["kind"] == "sensor"
    assert sensor["sensor"]["rows"] == 144


def test_the_text_has_every_number_that_json_has(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(30))
    for name in (path, *BUILTIN_MODELS):
        described = json.loads(tofmix("info", name, "--json").out)
        text = tofmix("info", name).out
        for title, section in described.items():
            if isinstance(section, dict):
                assert f"\n{title.replace('_', ' ')}\n" in text
                assert all(f"\n  {key} " in text for key in section)
        for warning in described["warnings"]:
            assert f"warning: {warning['text']}" in text


def test_control_characters_do_not_reach_the_terminal(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(30), attributes={"name": "\x1b[31mred\nx"})
    assert "\x1b" not in tofmix("info", path).out


def test_info_refuses_unknown_files_with_exit_code_3(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("no")
    (tmp_path / "bad.toml").write_text("[sensor")
    with h5py.File(tmp_path / "other.h5", "w") as root:
        root.attrs["format"] = "something-else"
    for name in ("none.h5", "text.h5", "bad.toml", "other.h5", "none.toml", "."):
        outcome = tofmix("info", tmp_path / name)
        assert outcome.code == ExitCode.BAD_INPUT, name
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
