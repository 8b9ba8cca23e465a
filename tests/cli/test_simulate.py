"""`tofmix simulate`: what it writes, prints and refuses."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from commandline import Tofmix

from tofmix.errors import ExitCode
from tofmix.simulation.builtin import BUILTIN_MODELS
from tofmix.simulation.model_toml import parse_model

SMALL = """
[sensor]
profile = "sr3000"
rows = 6
cols = 8
integration_time_ms = 1.2
[recording]
frames = 20
seed = 3
[[surface]]
name = "board"
center_mm = [0.0, 0.0, 2000.0]
size_mm = [600.0, 4000.0]
"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_list_names_the_built_in_models(tofmix: Tofmix) -> None:
    shown = tofmix("simulate", "--list")
    assert shown.code == 0
    assert [line.split()[0] for line in shown.out.splitlines()] == list(BUILTIN_MODELS)


@pytest.mark.parametrize("name", list(BUILTIN_MODELS))
def test_print_model_prints_a_model(tofmix: Tofmix, name: str) -> None:
    shown = tofmix("simulate", name, "--print-model")
    assert parse_model(shown.out, source="printed").surfaces


def test_a_recording_holds_what_was_asked_for(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
    outcome = tofmix("simulate", model, "-o", tmp_path / "a.h5", "--frames", 7, "--seed", 11)
    assert outcome.code == 0, outcome.err
    assert outcome.out == f"{tmp_path / 'a.h5'}: 7 frames of 6 x 8 pixels, seed 11\n"
    with h5py.File(tmp_path / "a.h5") as root:
        assert root["range"].shape == (7, 6, 8)
        assert root.attrs["seed"] == 11
        assert root["truth"].attrs["model"] == SMALL
        assert root["sensor"].attrs["integration_time_ms"] == 1.2
        np.testing.assert_allclose(root["time"][...], np.arange(7) / 25)


def test_the_same_seed_gives_the_same_bytes(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        tofmix("simulate", model, "-o", tmp_path / name, "--seed", seed)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert (tmp_path / "a").read_bytes() != (tmp_path / "c").read_bytes()


def test_averaged_frames_have_the_default_integration_time(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
    tofmix("simulate", model, "-o", tmp_path / "a.h5")
    outcome = tofmix("simulate", model, "-o", tmp_path / "b.h5", "--averaged")
    assert "20 averaged frames" in outcome.out
    with h5py.File(tmp_path / "a.h5") as single, h5py.File(tmp_path / "b.h5") as averaged:
        assert averaged["sensor"].attrs["integration_time_ms"] == 10.0
        ratio = single["sensor/noise_sigma"][...] / averaged["sensor/noise_sigma"][...]
        np.testing.assert_allclose(ratio, np.sqrt(10 / 1.2))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[sensor]\nrows = \n", "line 2"),
        (SMALL.replace("sr3000", "sr9000"), "sr9000"),
        (SMALL.replace("rows = 6", "rows = -1"), "rows"),
        (SMALL.replace("2000.0]", "inf]"), "center_mm"),
        (SMALL + "[sensor.noise]\nrange_mm = [1.0, 2.0]\nsigma_mm = [1.0, -2.0]\n", "sigma"),
        (SMALL + '[[effect]]\nkind = "wigling"\n', 'did you mean "wiggling"'),
    ],
)
def test_a_bad_model_is_bad_input(tofmix: Tofmix, tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    outcome = tofmix("simulate", path, "-o", tmp_path / "a.h5")
    assert outcome.code == ExitCode.BAD_INPUT
    assert outcome.err.count("\n") == 1
    assert str(path) in outcome.err
    assert reason in outcome.err
    assert [p.name for p in tmp_path.iterdir()] == ["bad.toml"]


def test_other_refusals(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
    (tmp_path / "old.h5").write_text("old")
    for arguments, code in (
        (("no-such-model", "-o", tmp_path / "a.h5"), ExitCode.BAD_INPUT),
        ((model, "-o", tmp_path / "old.h5"), ExitCode.USAGE),
        ((model, "-o", model, "--overwrite"), ExitCode.USAGE),
        ((model, "-o", tmp_path / "none" / "a.h5"), ExitCode.STORAGE),
        ((model, "-o", "/dev/null", "--overwrite"), ExitCode.STORAGE),
    ):
        outcome = tofmix("simulate", *arguments)
        assert outcome.code == code, arguments
        assert outcome.err.count("\n") == 1
    assert (tmp_path / "old.h5").read_text() == "old"
    assert model.read_text() == SMALL
    assert tofmix("simulate", model, "-o", tmp_path / "old.h5", "--overwrite").code == 0
