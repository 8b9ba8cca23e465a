"""`tofmix sensors`: the list, one camera, its file; and a profile that is used as it is printed."""

import json
from pathlib import Path

import h5py
import numpy as np
from support.commandline import Tofmix

from tofmix.errors import ExitCode
from tofmix.sensors import PROFILES


def test_list_names_every_profile_and_marks_unknown_values(tofmix: Tofmix) -> None:
    done = tofmix("sensors")
    assert done.code == 0
    lines = {line.split()[0]: line for line in done.out.splitlines()[1:]}
    assert list(lines) == list(PROFILES)
    assert "45 x 45" in lines["vl53l5cx"]
    assert "0.02 to 4 m" in lines["vl53l5cx"]
    assert lines["tmf8828"].split()[5] == "-"
    assert " yes " in lines["sr3000"]
    assert [lines[name].split()[1] for name in ("pico-flexx", "l515", "stoc")] == ["lock-in", "pulses", "stereo"]


def test_json_is_one_object_a_line(tofmix: Tofmix) -> None:
    objects = [json.loads(line) for line in tofmix("sensors", "--json").out.splitlines()]
    assert [one["profile"] for one in objects] == list(PROFILES)
    by_name = {one["profile"]: one for one in objects}
    assert by_name["vl53l8cx"]["fov_horizontal_deg"] is None
    assert by_name["l515"]["noise_sigma_mm"] is None
    assert by_name["azure-kinect-wfov"]["measurement"] == "lock-in"
    assert by_name["sr3000"]["noise_sigma_mm"][0] == 2.5
    assert json.loads(tofmix("sensors", "l515", "--json").out) == by_name["l515"]


def test_unknown_camera_is_a_usage_error(tofmix: Tofmix) -> None:
    done = tofmix("sensors", "nope")
    assert done.code == ExitCode.USAGE
    assert '"nope" is not a built-in sensor' in done.err


def test_one_camera_is_printed_with_its_sources(tofmix: Tofmix) -> None:
    done = tofmix("sensors", "tmf8828")
    assert done.code == 0
    assert "DS000693" in done.out
    assert "not known" in done.out
    assert tofmix("info", "tmf8828").out == done.out


def test_printed_camera_file_is_accepted_by_import(tofmix: Tofmix, tmp_path: Path) -> None:
    text = tofmix("sensors", "vl53l5cx", "--toml").out
    (tmp_path / "mine.toml").write_text(text.replace('"VL53L5CX"', '"mine"'))
    np.save(tmp_path / "a.npy", np.full((3, 8, 8), 1000, "u2"))
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--sensor", tmp_path / "mine.toml")
    assert done.code == 0, done.err
    with h5py.File(tmp_path / "a.h5") as root:
        assert root["sensor"].attrs["name"] == "mine"
        assert root["sensor"].attrs["fov_horizontal_deg"] == 45.0
        assert np.isnan(root["sensor"].attrs["integration_time_ms"])


def test_a_file_with_one_key_is_a_camera_for_import(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[sensor]\nrange_max_mm = 6000.0\n")
    np.save(tmp_path / "a.npy", np.full((3, 8, 8), 1000, "u2"))
    done = tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--sensor", tmp_path / "mine.toml")
    assert done.code == 0, done.err
    assert "largest range" not in done.out


def test_unknown_sensors_are_refused_with_their_exit_code(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((3, 8, 8), 1000, "u2"))
    tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    for arguments, code, text in (
        (("sensors", "sr300"), ExitCode.USAGE, 'did you mean "sr3000"'),
        (("sensors", "--toml"), ExitCode.USAGE, "give its NAME"),
        (("sensors", "l515", "--toml", "--json"), ExitCode.USAGE, "exclude each other"),
        (("estimate", tmp_path / "a.h5", "--noise", "l515"), ExitCode.USAGE, "the noise of L515 is not known"),
    ):
        refused = tofmix(*arguments)
        assert refused.code == code, refused.err
        assert text in refused.err
        assert refused.err.count("\n") == 1
