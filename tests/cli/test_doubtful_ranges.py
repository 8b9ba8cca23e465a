"""Metres that would be read as mm, from every command that takes a recording."""

import json
from pathlib import Path

import h5py
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode

MODEL = """\
[sensor]
profile = "sr4000"
rows = 4
cols = 6
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
"""


@pytest.fixture
def metres(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "metres.h5", (boards(40) * 1e-3).astype("f4"))


@pytest.mark.parametrize(
    "line",
    [
        "estimate METRES -o OUT",
        "estimate METRES --noise auto -o OUT",
        "report LAYERS --recording METRES",
        "inspect LAYERS --pixel 1,1 --recording METRES",
        "map LAYERS --from averaged --recording METRES -o OUT.yaml",
        "reconcile MODEL METRES -o OUT",
    ],
)
def test_metres_without_units_are_refused_by_every_command(
    tofmix: Tofmix, metres: Path, tmp_path: Path, line: str
) -> None:
    model, layers = tmp_path / "model.toml", tmp_path / "a.layers.h5"
    model.write_text(MODEL)
    view = {"fov_horizontal_deg": 12.0, "fov_vertical_deg": 8.0}
    assert tofmix("estimate", write_recording(tmp_path / "a.h5", boards(40), attributes=view)).code == 0
    names = {
        "METRES": metres,
        "OUT": tmp_path / "out",
        "OUT.yaml": tmp_path / "out.yaml",
        "LAYERS": layers,
        "MODEL": model,
    }
    before = sorted(tmp_path.iterdir())
    done = tofmix(*(names.get(word, word) for word in line.split()))
    assert done.code == ExitCode.BAD_INPUT
    assert f"tofmix import {metres} --units m" in done.err
    assert "attribute units to mm" in done.err
    assert done.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_info_warns_of_metres(tofmix: Tofmix, metres: Path) -> None:
    done = tofmix("info", metres, "--json")
    assert done.code == 0
    warnings = {warning["code"]: warning["text"] for warning in json.loads(done.out)["warnings"]}
    assert "--units m" in warnings["range_units"]


@pytest.mark.slow
def test_zeros_that_count_as_ranges_are_noted_once(tofmix: Tofmix, tmp_path: Path) -> None:
    samples = boards(40).astype("f4")
    samples[:10] = 0
    path = write_recording(tmp_path / "a.h5", samples)
    done = tofmix("estimate", path)
    assert done.code == 0
    assert done.err.count("240 of 960 checked samples are exactly 0") == 1
    assert "range_zeros" in tofmix("info", path, "--json").out
    with h5py.File(path, "a") as root:
        root["range"].attrs["_FillValue"] = 0.0
    assert "exactly 0" not in tofmix("estimate", path, "--overwrite").err
