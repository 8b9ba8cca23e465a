"""`tofmix simulate`: what it writes, prints and refuses."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix

from tofmix.errors import ExitCode
from tofmix.simulation import BUILTIN_MODELS
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
    shown = tofmix.done("simulate", "--list")
    assert [line.split()[0] for line in shown.out.splitlines()] == list(BUILTIN_MODELS)


@pytest.mark.parametrize("name", list(BUILTIN_MODELS))
def test_print_model_prints_a_model(tofmix: Tofmix, name: str) -> None:
    shown = tofmix("simulate", name, "--print-model")
    assert parse_model(shown.out, source="printed").surfaces


def test_recording_has_the_requested_frames_and_seed(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
    outcome = tofmix.done("simulate", model, "-o", tmp_path / "a.h5", "--frames", 7, "--seed", 11)
    assert outcome.out == f"{tmp_path / 'a.h5'}: 7 frames of 6 x 8 pixels, seed 11\n"
    with h5py.File(tmp_path / "a.h5") as root:
        assert root["range"].shape == (7, 6, 8)
        assert root.attrs["seed"] == 11
        assert root["truth"].attrs["model"] == SMALL
        assert root["sensor"].attrs["integration_time_ms"] == 1.2
        np.testing.assert_allclose(root["time"][...], np.arange(7) / 25)


def test_averaged_frames_have_the_default_integration_time(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
    tofmix("simulate", model, "-o", tmp_path / "a.h5")
    outcome = tofmix("simulate", model, "-o", tmp_path / "b.h5", "--averaged")
    assert "20 averaged frames" in outcome.out
    with h5py.File(tmp_path / "a.h5") as single, h5py.File(tmp_path / "b.h5") as averaged:
        assert averaged["sensor"].attrs["integration_time_ms"] == 10.0
        ratio = single["sensor/noise_sigma"][...] / averaged["sensor/noise_sigma"][...]
        np.testing.assert_allclose(ratio, np.sqrt(10 / 1.2))


EFFECTS = """
[[effect]]
kind = "stuck_pixels"
share = 0.2
value_mm = 1234.0
[[effect]]
kind = "dropout"
probability = 0.3
[[effect]]
kind = "interference"
probability = 0.5
sigma_mm = 40.0
[[effect]]
kind = "motion"
surface = "board"
velocity_mm_s = 100.0
"""


def test_effects_and_their_draws_are_stored(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(SMALL + EFFECTS)
    tofmix.done("simulate", tmp_path / "m.toml", "-o", tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as root:
        ranges, truth = root["range"][...], root["truth"]
        assert set(truth["effects"]) == {"stuck_pixels", "interference"}
        stuck = truth["effects/stuck_pixels"][...] == 1234
        np.testing.assert_array_equal(stuck, (ranges == 1234).all(axis=0))
        assert [d[0].name for d in truth["effects/stuck_pixels"].dims] == ["/row", "/col"]
        assert root["range"].attrs["_FillValue"][0] == 0
        assert (ranges[:, ~stuck] == 0).mean() == pytest.approx(0.3, abs=0.06)
        disturbed = truth["effects/interference"][...]
        assert disturbed.shape == (20,)
        assert set(disturbed) == {0, 1}
        frames = truth["range_true_frames"][...]
        assert [d[0].name for d in truth["range_true_frames"].dims] == ["/frame", "/row", "/col", "/truth/layer"]
        np.testing.assert_array_equal(frames[0], truth["range_true"][...])
        np.testing.assert_allclose(np.nanmean(frames[19] / frames[0]), 1 + 0.1 * 19 / 25 / 2, rtol=1e-3)


def test_explain_describes_the_simulation(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(SMALL + EFFECTS)
    shown = tofmix.done("simulate", tmp_path / "m.toml", "--explain", "--frames", 7, "--seed", 9)
    assert "recording: 7 frames at 25 Hz, 0.28 s in all, seed 9\n" in shown.out
    assert 'geometry: motion: "board" moves along its normal at +100 mm/s\n' in shown.out
    assert "read-out: dropout: 30 % of the samples are lost\n" in shown.out
    assert [path.name for path in tmp_path.iterdir()] == ["m.toml"]
    assert "effects: none" in tofmix("simulate", "corridor", "--explain").out


def test_repeat_writes_recordings_of_consecutive_seeds(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
    outcome = tofmix("simulate", model, "-o", tmp_path / "a.h5", "--repeat", 3, "--seed", 5)
    assert [Path(line.split(":")[0]).name for line in outcome.out.splitlines()] == ["a_001.h5", "a_002.h5", "a_003.h5"]
    assert not (tmp_path / "a.h5").exists()
    tofmix("simulate", model, "-o", tmp_path / "b.h5", "--seed", 6)
    assert (tmp_path / "a_002.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    (tmp_path / "a_001.h5").unlink()
    assert tofmix("simulate", model, "-o", tmp_path / "a.h5", "--repeat", 3).code == ExitCode.USAGE
    assert not (tmp_path / "a_001.h5").exists()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[sensor]\nrows = \n", "line 2"),
        (SMALL.replace("sr3000", "sr9000"), "sr9000"),
        (SMALL.replace("rows = 6", "rows = -1"), "rows"),
        (SMALL.replace("2000.0]", "inf]"), "center_mm"),
        (SMALL + "[sensor.noise]\nrange_mm = [1.0, 2.0]\nsigma_mm = [1.0, -2.0]\n", "sigma"),
        ((SMALL + EFFECTS).replace("seed = 3", "frame_rate_hz = 1e-3"), "motion: at 19000 s: center_mm"),
        (SMALL + '[[effect]]\nkind = "wigling"\n', 'did you mean "wiggling"'),
    ],
)
def test_a_bad_model_is_bad_input(tofmix: Tofmix, tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    outcome = tofmix("simulate", path, "-o", tmp_path / "a.h5")
    outcome.refused(ExitCode.BAD_INPUT, str(path))
    assert reason in outcome.err
    assert [p.name for p in tmp_path.iterdir()] == ["bad.toml"]


def test_simulate_refuses_invalid_models_with_exit_code_3(tofmix: Tofmix, model: Path, tmp_path: Path) -> None:
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
    tofmix.done("simulate", model, "-o", tmp_path / "old.h5", "--overwrite")
