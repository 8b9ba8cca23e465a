"""``reconcile --noise``: the model's, the recording's, or a layers file's; ``info`` prints a curve to paste."""

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix

from tofmix.io.model_file import load_model

MODEL = """\
[sensor]
profile = "sr4000"
rows = 14
cols = 18
integration_time_ms = 10.0
[sensor.noise]
range_mm = [500.0, 2000.0, 5000.0]
sigma_mm = [5.0, 12.0, 40.0]
reference_integration_time_ms = 10.0
[recording]
frames = 120
[[surface]]
name = "board"
center_mm = [-300.0, 0.0, 1500.0]
size_mm = [500.0, 500.0]
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
yaw_deg = 20.0
"""
NOISIER = '[[effect]]\nkind = "excess_noise"\nfactor = 1.5\n'
ONLY_OFFSET = ("--effects", "range_offset")


@pytest.fixture
def files(tofmix: Tofmix, tmp_path: Path) -> tuple[Path, Path]:
    """A model, and a recording whose noise is half as large again."""
    model, real, measured = (tmp_path / name for name in ("model.toml", "real.toml", "measured.h5"))
    model.write_text(MODEL)
    real.write_text(MODEL + NOISIER)
    assert tofmix("simulate", real, "-o", measured).code == 0
    return model, measured


def outcome(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "gap.json").read_text())
    return found


def test_noise_that_is_no_choice_and_no_file_is_a_wrong_option(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path
) -> None:
    done = tofmix("reconcile", *files, "-o", tmp_path / "gap", "--noise", "mesured")
    assert done.code == 2
    assert '"mesured" is not model, measured or a layers file: no such file' in done.err


@pytest.mark.slow
def test_noise_of_the_model_leaves_the_difference_and_that_of_the_recording_agrees(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path
) -> None:
    for noise, verdict in (("model", "unexplained"), ("measured", "agree")):
        folder = tmp_path / noise
        done = tofmix("reconcile", *files, "-o", folder, "--noise", noise, *ONLY_OFFSET)
        assert done.code == 0, done.err
        assert outcome(folder)["verdict"] == verdict
    assert outcome(tmp_path / "measured")["next_steps"][0].startswith(
        "The noise differs from the model's curve: the measured sigma is 1."
    )
    own, found = (load_model(str(path)).sensor for path in (files[0], tmp_path / "measured" / "model.toml"))
    ratio = found.noise.sigma(3000.0) / own.noise.sigma(3000.0)
    assert ratio == pytest.approx(1.5, rel=0.05)
    assert tofmix("simulate", tmp_path / "measured" / "model.toml", "-o", tmp_path / "again.h5").code == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kinds", "verdict", "named"),
    [("range_offset", "agree", []), ("range_offset,excess_noise", "explained", ["excess_noise"])],
)
def test_noise_of_the_recording_is_tried_only_where_the_models_explains_nothing(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path, kinds: str, verdict: str, named: list[str]
) -> None:
    done = tofmix("reconcile", *files, "-o", tmp_path / "gap", "--effects", kinds)
    assert done.code == 0, done.err
    found = outcome(tmp_path / "gap")
    assert (found["verdict"], [e["kind"] for e in found["effects"]]) == (verdict, named)
    assert ("The noise differs from the model's curve" in done.out) is (not named)
    assert ("agree, with measured noise in place of that of the model" in done.out) is (not named)
    assert found["noise"] == ("model" if named else "measured")


@pytest.mark.slow
def test_noise_of_one_board_alone_stays_unexplained_with_its_place(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path
) -> None:
    """A curve that is learnt from the recording has a step at the board's ranges, and hides it."""
    still, measured = tmp_path / "still.h5", tmp_path / "sunlit.h5"
    assert tofmix("simulate", files[0], "-o", still).code == 0
    shutil.copy(still, measured)
    with h5py.File(measured, "r+") as file:
        samples = file["range"][()].astype(np.float64)
        near = (samples > 0) & (samples < 2200.0)
        middle = np.nanmedian(np.where(near | ~near.any(axis=0), samples, np.nan), axis=0)
        file["range"][...] = np.where(near, np.rint(middle + 1.7 * (samples - middle)), samples).astype(np.uint16)
    done = tofmix("reconcile", files[0], measured, "-o", tmp_path / "gap", "--effects", "excess_noise")
    assert done.code == 0, done.err
    found = outcome(tmp_path / "gap")
    assert (found["verdict"], found["noise"]) == ("unexplained", "model")
    assert found["next_steps"][0].startswith('The noise differs from the model\'s curve by place: on "board" it is 1.')


@pytest.mark.slow
def test_noise_of_a_layers_file_is_taken_and_info_prints_it_to_paste(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path
) -> None:
    layers, pasted = tmp_path / "a.layers.h5", tmp_path / "pasted.toml"
    assert tofmix("estimate", files[1], "-o", layers, "--noise", "auto", "--workers", "1").code == 0
    done = tofmix("reconcile", *files, "-o", tmp_path / "gap", "--noise", layers, *ONLY_OFFSET)
    assert done.code == 0, done.err
    assert outcome(tmp_path / "gap")["verdict"] == "agree"
    told = tofmix("info", layers).out
    table = told[told.index("[sensor.noise]") :].split("\nwarning:")[0]
    start, end = MODEL.index("[sensor.noise]"), MODEL.index("[recording]")
    pasted.write_text(f"{MODEL[:start]}{table}\n{MODEL[end:]}")
    own, written = (load_model(str(path)).sensor.noise for path in (pasted, tmp_path / "gap" / "model.toml"))
    assert own.sigma_mm.tolist() == written.sigma_mm.tolist()
    assert own.range_mm.tolist() == written.range_mm.tolist()
