"""`tofmix reconcile` on files: its folder, its refusals, its noise, and that the refined model runs."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from support.commandline import Tofmix

from tofmix.arrays import FloatArray
from tofmix.io.model_file import load_model
from tofmix.io.recording.recording_file import open_recording
from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile

SAMPLES = Path(__file__).parents[2] / "sample_data"
BLIND = Path(__file__).parents[1] / "benchmarks" / "hidden_effect.py"
SURFACES = """\
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
MODEL = (
    """\
[sensor]
profile = "sr4000"
rows = 12
cols = 16
[recording]
frames = 80
"""
    + SURFACES
)
PATTERN = '[[effect]]\nkind = "fixed_pattern"\npixel_sigma_mm = 60.0\n'


def simulated(tofmix: Tofmix, folder: Path, text: str, effect: str) -> tuple[Path, Path]:
    """The file of a model, and a recording of it with one effect more."""
    model, real, measured = (folder / name for name in ("model.toml", "real.toml", "measured.h5"))
    model.write_text(text)
    real.write_text(text + effect)
    tofmix.done("simulate", real, "-o", measured)
    return model, measured


@pytest.fixture
def files(tofmix: Tofmix, tmp_path: Path) -> tuple[Path, Path]:
    return simulated(tofmix, tmp_path, MODEL, PATTERN)


def change(measured: Path, name: str, by: Callable[[NDArray[Any]], ArrayLike]) -> None:
    """Change a dataset of a recording, by a function of its values."""
    with h5py.File(measured, "r+") as file:
        file[name][...] = by(file[name][...])


def pause(time_s: FloatArray) -> FloatArray:
    """20 s in the middle of the recording."""
    return np.where(np.arange(time_s.size) < time_s.size // 2, time_s, time_s + 20.0)


def verdict(*files: Path, kinds: tuple[str, ...]) -> str:
    """What reconciling model and recording files, in turn, comes to, without the pages that the command writes."""
    pairs = []
    for model_file, measured in zip(files[::2], files[1::2], strict=True):
        model = load_model(str(model_file))
        with open_recording(measured) as recording:
            ranges = recording.read_range(slice(None), slice(None))
            pairs.append((model, make_evidence(model, ranges, time_s=recording.read_time())))
    (model, evidence), *also = pairs
    return reconcile(model, evidence, Settings(kinds=kinds), also=also).verified.verdict


@pytest.mark.slow
def test_max_effects_limits_the_added_effects(tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path) -> None:
    options = "--effects", "fixed_pattern", "--max-effects", "0", "--json"
    done = tofmix.done("reconcile", *files, "-o", tmp_path / "gap", *options)
    said = json.loads(done.out)
    assert said["effects"] == []
    assert said["verdict"] == "unexplained"


def test_folder_holds_gap_report_and_a_model_that_runs(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path
) -> None:
    """Doubts about the recording are told, a line each; a pause does not change its frame rate."""
    change(files[1], "time", lambda time_s: pause(time_s) * 2.5)
    with h5py.File(files[1], "r+") as file:
        file["sensor"].attrs["integration_time_ms"] = 7.5
    folder = tmp_path / "gap"
    done = tofmix("reconcile", *files, "-o", folder, "--effects", "fixed_pattern,range_offset,surface_pose", "--json")
    assert done.code == 0
    setting, rate = sorted(done.err.splitlines())
    assert f"{files[1]}: sensor: integration_time_ms is 7.5; the model has" in setting
    assert rate == f"tofmix: {files[1]}: time: 10 Hz; the model has frame_rate_hz 25"
    gap = json.loads((folder / "gap.json").read_text())
    assert json.loads(done.out) == gap
    assert gap["verdict"] == "explained"
    assert [e["kind"] for e in gap["effects"]] == ["fixed_pattern"]
    assert {"verdict", "effects", "where", "candidates", "aliases", "panel", "gap", "considered"} <= gap.keys()
    assert gap["complete"] is True
    first, *others = gap["considered"]
    assert (first["effects"], first["why_not"]) == ([{"kind": "fixed_pattern"}], None)
    assert all(other["why_not"] for other in others)
    assert {"before", "after", "floor", "closed"} == gap["gap"].keys()
    assert gap["where"][0].keys() >= {"axis", "interval", "statistic", "size", "unit", "p_value"}
    effects = tomllib.loads((folder / "model.toml").read_text())["effect"]
    assert effects == [{"kind": "fixed_pattern", "map": "fixed_pattern.npy"}]
    page = (folder / "report.html").read_text()
    assert "Verdict: explained" in page
    titles = re.findall(r"<h3>(residual of each pixel, .*?)</h3>", page)
    assert titles == [f"residual of each pixel, {when}" for when in ("before", "after")]
    before, after = re.findall(r'<img src="(data:image/png.*?)"', page)  # the same for dark and light pages
    assert before != after
    tofmix.done("simulate", folder / "model.toml", "-o", tmp_path / "again.h5")
    assert verdict(folder / "model.toml", files[1], kinds=("fixed_pattern", "range_offset")) == "agree"
    tofmix("reconcile", *files, "-o", folder).refused(2, "--overwrite")


def begun(files: tuple[Path, Path], folder: Path) -> "subprocess.Popen[str]":
    """A process of `reconcile --trace` that has weighed three sets."""
    command = [sys.executable, "-m", "tofmix", "reconcile", *map(str, files), "-o", str(folder), "--trace"]
    kinds = "fixed_pattern,range_offset,surface_pose,wiggling,amplitude_walk,excess_noise"
    process = subprocess.Popen(
        [*command, "--effects", kinds], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    lines: list[str] = []
    while sum(" nats  " in line for line in lines) < 3:
        lines.append(process.stderr.readline())
        assert lines[-1], "".join(lines)
    return process


@pytest.mark.compiled("a search in another process")
def test_ctrl_c_ends_the_search_and_the_folder_is_whole(files: tuple[Path, Path], tmp_path: Path) -> None:
    folder = tmp_path / "gap"
    with begun(files, folder) as process:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert process.returncode == -signal.SIGINT  # a shell shows 130
    assert "Traceback" not in err
    assert "interrupted: the best so far is written" in err
    gap = json.loads((folder / "gap.json").read_text())
    assert gap["complete"] is False
    assert gap["considered"][0]["why_not"] is None
    assert "the search was interrupted" in out
    assert "by a search that was interrupted" in (folder / "report.html").read_text()
    model = load_model(str(folder / "model.toml"))
    assert [e.kind for e in model.effects] == [e["kind"] for e in gap["effects"]]


@pytest.mark.compiled("a search in another process")
def test_second_ctrl_c_ends_at_once_and_writes_nothing(files: tuple[Path, Path], tmp_path: Path) -> None:
    before = sorted(tmp_path.iterdir())
    with begun(files, tmp_path / "gap") as process:
        assert process.stderr is not None
        process.send_signal(signal.SIGINT)
        while "Ctrl-C again" not in process.stderr.readline():
            pass
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert process.returncode == -signal.SIGINT
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_effect_of_two_recordings_is_written_to_both_models(tofmix: Tofmix, tmp_path: Path) -> None:
    hidden = '[[effect]]\nkind = "wiggling"\namplitude_mm = 30.0\nphase_rad = 0.4\n'
    moved = '[[effect]]\nkind = "surface_pose"\nsurface = "wall"\nshift_mm = 25.0\n'
    other = MODEL.replace("1500.0", "2200.0").replace("yaw_deg = 20.0", "yaw_deg = -45.0")
    files = []
    for name, text, extra in (("one", MODEL, ""), ("two", other, moved)):
        model, real, measured = (tmp_path / f"{name}{end}" for end in (".toml", "_real.toml", ".h5"))
        model.write_text(text)
        real.write_text(text + hidden + extra)
        tofmix.done("simulate", real, "-o", measured)
        files += [model, measured]
    folder = tmp_path / "gap"
    done = tofmix.done(
        "reconcile", *files[:2], "-o", folder, "--also", *files[2:], "--effects", "wiggling,surface_pose,range_offset"
    )
    assert "recording 2" in done.out
    assert "model_2.toml" in done.out
    gap = json.loads((folder / "gap.json").read_text())
    assert gap["verdict"] == "explained"
    assert [(e["kind"], e["recordings"]) for e in gap["effects"]] == [("wiggling", [1, 2])]
    assert [(e["kind"], e["recordings"]) for e in gap["also"][0]["effects"]] == [("surface_pose", [2])]
    assert {line["recording"] for line in gap["panel"]} == {1, 2}
    kinds = [_effects(folder / name) for name in ("model.toml", "model_2.toml")]
    assert kinds == [["wiggling"], ["surface_pose", "wiggling"]]
    page = (folder / "report.html").read_text()
    assert "Added to the model of recording 2" in page
    refined = folder / "model.toml", files[1], folder / "model_2.toml", files[3]
    assert verdict(*refined, kinds=("range_offset", "excess_noise")) == "agree"


def _effects(model: Path) -> list[str]:
    return sorted(effect["kind"] for effect in tomllib.loads(model.read_text()).get("effect", []))


def test_recording_of_another_camera_is_refused(tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(MODEL.replace("rows = 12", "rows = 12\nrange_max_mm = 4000.0"))
    done = tofmix("reconcile", *files, "-o", tmp_path / "gap", "--also", other, files[1])
    done.refused(3, f"{other}: sensor: range_max_mm")
    assert not (tmp_path / "gap").exists()


def _blind(output: Path, *options: str) -> Path:
    """A recording of the blind camera, which `sample_data/hidden_effect.h5` is made by."""
    subprocess.run([sys.executable, str(BLIND), str(output), *options], check=True, capture_output=True)
    return output


@pytest.mark.slow
@pytest.mark.long
def test_effect_hidden_in_the_sample_recording_is_found(tofmix: Tofmix, tmp_path: Path) -> None:
    files = SAMPLES / "three_boards_model.toml", SAMPLES / "hidden_effect.h5"
    tofmix.done("reconcile", *files, "-o", tmp_path / "gap")
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert (gap["verdict"], [e["kind"] for e in gap["effects"]]) == ("explained", ["wiggling"])
    found, errors = gap["effects"][0]["parameters"], gap["effects"][0]["stderr"]
    for name, hidden in (("amplitude_mm", 18.8754), ("phase_rad", -2.11915)):  # tests/benchmarks/hidden_effect.py
        assert abs(found[name] - hidden) < 4 * errors[name]
    assert gap["gap"]["closed"] > 0.85


@pytest.mark.slow
def test_sample_recording_without_its_effect_agrees_with_the_model(tofmix: Tofmix, tmp_path: Path) -> None:
    """The same camera without the effect agrees with the model."""
    agreeing = _blind(tmp_path / "agreeing.h5", "--without")
    model = SAMPLES / "three_boards_model.toml"
    done = tofmix.done("reconcile", model, agreeing, "-o", tmp_path / "gap", "--effects", "wiggling", "--json")
    assert json.loads(done.out)["verdict"] == "agree"
    with h5py.File(SAMPLES / "hidden_effect.h5") as kept, h5py.File(_blind(tmp_path / "again.h5")) as again:
        assert (kept["range"][...] == again["range"][...]).mean() > 0.999  # the arc tangent's last bit is the machine's


def test_ranges_in_metres_are_refused(tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path) -> None:
    change(files[1], "range", lambda r: np.where(r == 0, 0, np.rint(r / 1000.0)))
    done = tofmix("reconcile", *files, "-o", tmp_path / "gap")
    assert done.code == 3
    doubt, refusal = done.err.splitlines()
    assert "no camera sees so near" in doubt
    assert "are they in metres?" in refusal


@pytest.mark.slow
def test_pattern_without_a_map_is_noted_and_a_pause_is_not(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path
) -> None:
    change(files[1], "time", pause)
    model = tmp_path / "patterned.toml"
    model.write_text(MODEL + PATTERN)
    done = tofmix("reconcile", model, files[1], "-o", tmp_path / "gap", "--json")
    assert json.loads(done.out)["verdict"] == "agree"
    (line,) = done.err.splitlines()
    assert "the model's fixed_pattern has no map: every static error counts as part of the pattern" in line


def test_folder_that_cannot_be_written_is_refused_before_any_work(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    for folder, reason in (("file", "is not a folder"), ("no/such", "no such folder")):
        done = tofmix("reconcile", *files, "-o", tmp_path / folder)
        done.refused(4, reason)
    monkeypatch.setattr(os, "access", lambda _, mode: mode == os.R_OK)  # root may write everywhere
    tofmix("reconcile", *files, "-o", tmp_path / "gap").refused(4, "no permission")


def test_temperatures_that_are_not_one_a_frame_are_refused(
    tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path
) -> None:
    with h5py.File(files[1], "r+") as root:
        root["temperature"] = np.zeros(7, dtype="f4")
    done = tofmix("reconcile", *files, "-o", tmp_path / "gap")
    assert done.code == 3
    assert done.err.count(str(files[1])) == 1
    assert "temperature: expected one number a frame" in done.err


def test_unknown_effect_is_refused(tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path) -> None:
    for named, reason in (("wigling", "wiggling"), (" , ", "the list is empty")):
        tofmix("reconcile", *files, "-o", tmp_path / "gap", "--effects", named).refused(2, reason)


@pytest.mark.slow
def test_different_maps_of_one_name_are_refused(tofmix: Tofmix, files: tuple[Path, Path], tmp_path: Path) -> None:
    """Two models of one camera are written to one folder: a map's name there is one map."""
    models = []
    for k in range(2):
        (folder := tmp_path / str(k)).mkdir()
        np.save(folder / "map.npy", np.full((12, 16), 5.0 * k))
        models.append(folder / "model.toml")
        models[-1].write_text(MODEL + '[[effect]]\nkind = "fixed_pattern"\nmap = "map.npy"\n')
    done = tofmix(
        "reconcile",
        models[0],
        files[1],
        "--also",
        models[1],
        files[1],
        "-o",
        tmp_path / "gap",
        "--effects",
        "range_offset",
    )
    assert (done.code, done.out) == (3, "")
    assert "two models of one camera have different maps with the name map.npy" in done.err


LAW = """\
amplitude = [50.0, 200.0, 2000.0]
amplitude_factor = [4.0, 2.0, 0.2]
reference_amplitude = [900.0, 700.0, 500.0]
"""
MODEL_AMPLITUDE = """\
[sensor]
profile = "sr4000"
rows = 16
cols = 24
[sensor.noise]
range_mm = [500.0, 2000.0, 5000.0]
sigma_mm = [6.0, 15.0, 40.0]
LAW[recording]
frames = 100
[[surface]]
name = "dark"
center_mm = [-500.0, 0.0, 1800.0]
size_mm = [800.0, 3000.0]
reflectivity = 0.1
[[surface]]
name = "bright"
center_mm = [500.0, 0.0, 1800.0]
size_mm = [1000.0, 3000.0]
reflectivity = 0.9
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
"""


@pytest.mark.slow
@pytest.mark.parametrize(("law", "agrees"), [(LAW, True), ("", False)])
def test_law_of_amplitude_changes_the_verdict(tofmix: Tofmix, tmp_path: Path, law: str, *, agrees: bool) -> None:
    (tmp_path / "real.toml").write_text(MODEL_AMPLITUDE.replace("LAW", LAW))
    (tmp_path / "model.toml").write_text(MODEL_AMPLITUDE.replace("LAW", law))
    tofmix.done("simulate", tmp_path / "real.toml", "-o", tmp_path / "a.h5")
    arguments = ("--effects", "range_offset,excess_noise", "--noise", "model", "-o", tmp_path / "gap")
    tofmix.done("reconcile", tmp_path / "model.toml", tmp_path / "a.h5", *arguments)
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert (gap["verdict"] == "agree") == agrees
    if not agrees:
        assert gap["where"][0]["statistic"] == "spread"


MODEL_NOISE = (
    """\
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
"""
    + SURFACES
)
NOISIER = '[[effect]]\nkind = "excess_noise"\nfactor = 1.5\n'
ONLY_OFFSET = ("--effects", "range_offset")


@pytest.fixture
def files_noise(tofmix: Tofmix, tmp_path: Path) -> tuple[Path, Path]:
    """A model, and a recording whose noise is half as large again."""
    return simulated(tofmix, tmp_path, MODEL_NOISE, NOISIER)


def outcome(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "gap.json").read_text())
    return found


@pytest.mark.slow
def test_noise_of_the_model_leaves_the_difference_and_that_of_the_recording_agrees(
    tofmix: Tofmix, files_noise: tuple[Path, Path], tmp_path: Path
) -> None:
    for noise, verdict in (("model", "unexplained"), ("measured", "agree")):
        folder = tmp_path / noise
        tofmix.done("reconcile", *files_noise, "-o", folder, "--noise", noise, *ONLY_OFFSET)
        assert outcome(folder)["verdict"] == verdict
    assert outcome(tmp_path / "measured")["next_steps"][0].startswith(
        "The noise differs from the model's curve: the measured sigma is 1."
    )
    own, found = (load_model(str(path)).sensor for path in (files_noise[0], tmp_path / "measured" / "model.toml"))
    ratio = found.noise.sigma(3000.0) / own.noise.sigma(3000.0)
    assert ratio == pytest.approx(1.5, rel=0.05)
    tofmix.done("simulate", tmp_path / "measured" / "model.toml", "-o", tmp_path / "again.h5")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kinds", "verdict", "named"),
    [("range_offset", "agree", []), ("range_offset,excess_noise", "explained", ["excess_noise"])],
)
def test_noise_of_the_recording_is_tried_only_where_the_models_explains_nothing(
    tofmix: Tofmix, files_noise: tuple[Path, Path], tmp_path: Path, kinds: str, verdict: str, named: list[str]
) -> None:
    done = tofmix.done("reconcile", *files_noise, "-o", tmp_path / "gap", "--effects", kinds)
    found = outcome(tmp_path / "gap")
    assert (found["verdict"], [e["kind"] for e in found["effects"]]) == (verdict, named)
    assert ("The noise differs from the model's curve" in done.out) is (not named)
    assert ("agree, with measured noise in place of that of the model" in done.out) is (not named)
    assert found["noise"] == ("model" if named else "measured")


@pytest.mark.slow
def test_noise_of_one_board_alone_is_named_with_its_board_and_its_factor(
    tofmix: Tofmix, files_noise: tuple[Path, Path], tmp_path: Path
) -> None:
    """A curve that is learnt from the recording has a step at the board's ranges, and hides it."""
    still, measured = tmp_path / "still.h5", tmp_path / "sunlit.h5"
    tofmix.done("simulate", files_noise[0], "-o", still)
    shutil.copy(still, measured)
    with h5py.File(measured, "r+") as file:
        samples = file["range"][()].astype(np.float64)
        near = (samples > 0) & (samples < 2200.0)
        middle = np.nanmedian(np.where(near | ~near.any(axis=0), samples, np.nan), axis=0)
        file["range"][...] = np.where(near, np.rint(middle + 1.7 * (samples - middle)), samples).astype(np.uint16)
    tofmix.done("reconcile", files_noise[0], measured, "-o", tmp_path / "gap", "--effects", "excess_noise")
    found = outcome(tmp_path / "gap")
    assert (found["verdict"], found["noise"]) == ("explained", "model")
    (named,) = found["effects"]
    assert (named["kind"], named["parameters"]["surface"]) == ("excess_noise", "board")
    assert named["parameters"]["factor"] == pytest.approx(1.7, rel=0.05)


@pytest.mark.slow
def test_noise_of_a_layers_file_is_taken_and_info_prints_it_to_paste(
    tofmix: Tofmix, files_noise: tuple[Path, Path], tmp_path: Path
) -> None:
    layers, pasted = tmp_path / "a.layers.h5", tmp_path / "pasted.toml"
    tofmix.done("estimate", files_noise[1], "-o", layers, "--noise", "auto", "--workers", "1")
    tofmix.done("reconcile", *files_noise, "-o", tmp_path / "gap", "--noise", layers, *ONLY_OFFSET)
    assert outcome(tmp_path / "gap")["verdict"] == "agree"
    told = tofmix("info", layers).out
    table = told[told.index("[sensor.noise]") :].split("\nwarning:")[0]
    start, end = MODEL_NOISE.index("[sensor.noise]"), MODEL_NOISE.index("[recording]")
    pasted.write_text(f"{MODEL_NOISE[:start]}{table}\n{MODEL_NOISE[end:]}")
    own, written = (load_model(str(path)).sensor.noise for path in (pasted, tmp_path / "gap" / "model.toml"))
    assert own.sigma_mm.tolist() == written.sigma_mm.tolist()
    assert own.range_mm.tolist() == written.range_mm.tolist()
