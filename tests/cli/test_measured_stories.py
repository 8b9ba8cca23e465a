"""The stories of `docs/tutorials/measured.md`: a recording is the scene, and what changed since then is named.

The page's own commands run in small: fewer frames or pixels, and other seeds. Errors are given a margin of three.
"""

import json
import re
import runpy
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from measured_page import BLOCKS, STORIES, shown
from support.commandline import Tofmix

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_data"
PAGE = (ROOT / "docs/tutorials/measured.md").read_text(encoding="utf-8")


def test_each_story_of_the_page_has_the_outcome_of_its_command_and_a_picture() -> None:
    blocks = [(found[2], found[4]) for found in BLOCKS.finditer(PAGE)]
    assert [shell.split()[-1] for shell, _ in blocks] == [each.folder for each in STORIES]
    assert all("\nverdict " in printed for _, printed in blocks)
    pictures = [ROOT / "docs/images" / f"measured_{each.folder}.png" for each in STORIES]
    assert all(path.is_file() and f"({path.name})" in PAGE.replace("../images/", "") for path in pictures)


def test_outcome_of_the_page_has_the_sentence_and_one_line_of_a_sort() -> None:
    printed = "One\nsentence.\n\nverdict      agree\nwhere        a\nnext         b\nnext         c\n"
    assert list(shown(printed)) == ["One sentence.", "", "verdict      agree", "next         b"]


def outcome(tofmix: Tofmix, folder: Path, *arguments: object) -> dict[str, Any]:
    """The contents of gap.json of a run of `tofmix reconcile`."""
    tofmix("reconcile", *arguments, "-o", folder, "--quiet")
    found: dict[str, Any] = json.loads((folder / "gap.json").read_text(encoding="utf-8"))
    return found


@pytest.mark.slow
@pytest.mark.compiled("it reconciles recordings")
def test_a_drone_that_flies_towards_a_wall_is_named_with_its_speed(tofmix: Tofmix, tmp_path: Path) -> None:
    model = SAMPLES / "drone_model.toml"
    (added,) = re.findall(r"<<'TOML'\n(.*?)^TOML$", PAGE, re.DOTALL | re.MULTILINE)
    flying = tmp_path / "flying.toml"
    flying.write_text(model.read_text(encoding="utf-8") + added, encoding="utf-8")
    tofmix.done("simulate", model, "--frames", 40, "--seed", 11, "-o", tmp_path / "standing.h5")
    tofmix.done("simulate", flying, "--frames", 24, "--seed", 12, "-o", tmp_path / "flying.h5")
    found = outcome(tofmix, tmp_path / "gap", tmp_path / "standing.h5", tmp_path / "flying.h5")
    assert found["verdict"] == "explained"
    (motion,) = found["effects"]
    assert (motion["kind"], motion["parameters"]["surface"]) == ("motion", "surface 0")
    speed, error = motion["parameters"]["velocity_mm_s"], motion["stderr"]["velocity_mm_s"]
    assert abs(speed + 250.0) < 3 * error
    assert error < 5.0
    assert any("another recording of this scene" in step for step in found["next_steps"])


@pytest.mark.slow
@pytest.mark.compiled("it reconciles recordings")
def test_a_room_that_is_found_again_by_a_warm_camera_shows_its_drift(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, more in (("cold", []), ("warm", ["--warm", "--seed", "12"])):
        monkeypatch.setattr("sys.argv", ["warm_room.py", str(tmp_path / f"{name}.h5"), *more])
        runpy.run_path(str(ROOT / "tests/benchmarks/warm_room.py"), run_name="__main__")
    found = outcome(tofmix, tmp_path / "gap", tmp_path / "cold.h5", tmp_path / "warm.h5")
    assert found["verdict"] == "explained"
    (drift,) = found["effects"]
    assert drift["kind"] == "temperature_drift"
    for name, true in (("amplitude_mm", 12.0), ("time_constant_s", 40.0)):
        assert abs(drift["parameters"][name] - true) < 3 * drift["stderr"][name]


@pytest.mark.slow
@pytest.mark.compiled("it reconciles recordings")
def test_an_object_that_recedes_is_named_with_its_speed_and_no_wall_is(tofmix: Tofmix, tmp_path: Path) -> None:
    """The true speed is the slope of a straight line through the means of the object's pixels.

    The recording has its own frame rate, though the usual step of its later frames is longer by a twentieth than that
    of all; and no command is advised for a part of it.
    """
    recording = SAMPLES / "tmf8829_edge.h5"
    with h5py.File(recording) as file:
        samples, times_s = file["range"][()].astype(np.float64), file["time"][()]
    nearer_mm = 400.0  # than both walls
    true = np.polyfit(times_s, samples[:, (samples < nearer_mm).all(axis=0)].mean(axis=1), 1)[0]
    shown = tofmix("reconcile", "--self", recording, "-o", tmp_path / "gap")
    assert "its first 8 frames: 5.1 % of the pixels have two layers within 5 sigma" in shown.err
    assert "frame_rate_hz" not in shown.err
    assert "tofmix estimate" not in shown.err
    found = json.loads((tmp_path / "gap" / "gap.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "partly_explained"
    (motion,) = (effect for effect in found["effects"] if effect["parameters"].get("surface"))
    assert (motion["kind"], motion["parameters"]["surface"]) == ("motion", "surface 0")
    assert motion["parameters"]["velocity_mm_s"] == pytest.approx(true, rel=0.15)
    assert motion["parameters"]["velocity_mm_s"] == pytest.approx(true, abs=2 * motion["stderr"]["velocity_mm_s"])
    assert found["gap"]["after"] < 0.5 * found["gap"]["before"]
    assert all(place["axis"] == "col" and place["interval"][0] >= 5 for place in found["left"])


@pytest.mark.slow
@pytest.mark.compiled("it reconciles recordings")
def test_a_zone_sensor_that_stands_still_is_off_by_less_than_its_noise(tofmix: Tofmix, tmp_path: Path) -> None:
    found = outcome(tofmix, tmp_path / "gap", SAMPLES / "vl53l0x_minute.h5", SAMPLES / "vl53l0x_later.h5")
    assert found["verdict"] == "explained"
    (bias,) = found["effects"]
    told = {bias["kind"], *(kind for alias in found["aliases"] for kind in alias["kinds"])}
    assert "range_offset" in told
    (place,) = (p for p in found["where"] if (p["axis"], p["statistic"]) == ("all", "bias"))
    assert -1.2 < place["size"] < -0.5
