"""`tofmix estimate` says what is doubtful where the work is done, each with the command that mends it."""

import json
import shlex
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import write_recording

from tofmix.errors import ExitCode

NOISE = {"noise_range": [500.0, 5000.0], "noise_sigma": [20.0, 20.0]}


def _wall(path: Path, *, factor: float = 1.0, drift: float = 0.0, frames: int = 60) -> Path:
    """A wall at 1.5 m whose noise is `factor` times the curve, and that moves by `drift` sigmas."""
    rng = np.random.default_rng(3)
    moved = drift * 20.0 * np.arange(frames)[:, None, None] / frames
    samples = 1500.0 + moved + rng.normal(0.0, factor * 20.0, (frames, 10, 12))
    return write_recording(path, np.rint(samples).astype("u2"), noise=NOISE)


def _codes(text: str) -> list[str]:
    return [finding["code"] for finding in json.loads(text)["warnings"]]


def test_sound_recording_gives_no_finding(tofmix: Tofmix, tmp_path: Path) -> None:
    done = tofmix("estimate", _wall(tmp_path / "a.h5"), "--mixing", "events", "--json")
    assert done.code == 0
    assert "a.h5" not in done.err
    assert json.loads(done.out)["warnings"] == []


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.2, 4.0])
def test_contradiction_of_the_curve_is_reported_and_its_remedy_works(
    tofmix: Tofmix, tmp_path: Path, factor: float
) -> None:
    recording = _wall(tmp_path / "a.h5", factor=factor)
    done = tofmix("estimate", recording, "--noise", "file")
    assert done.code == 0
    (line,) = [line for line in done.err.splitlines() if "Samples scatter" in line]
    assert f"scatter {factor:.1g}" in line
    assert ("averaged" in line) == (factor < 1)
    command = line.partition("Try: ")[2]
    assert command == f"tofmix estimate {recording} --noise auto --overwrite"
    again = tofmix(*shlex.split(command)[1:], "--json")
    assert again.code == 0
    assert _codes(again.out) == []


def test_drift_is_reported_and_its_remedy_works(tofmix: Tofmix, tmp_path: Path) -> None:
    done = tofmix("estimate", _wall(tmp_path / "a.h5", drift=8.0))
    assert "ranges drift by 8" in done.err
    assert "two layers within 5 sigma" in done.err
    (line,) = [line for line in done.err.splitlines() if "ranges drift by" in line]
    again = tofmix(*shlex.split(line.partition("Try: ")[2])[1:], "--json")
    assert again.code == 0
    assert _codes(again.out) == []


@pytest.mark.slow
def test_findings_equal_those_of_report_for_any_engine(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _wall(Path("a.h5"), drift=20.0, frames=80)
    with h5py.File("a.h5", "r+") as root:  # nothing to say about mixing
        root["sensor"].attrs["measurement"] = "pulses"
    given = "--noise", "file", "--window", 40, "--mixing", "events"
    once = tofmix("estimate", "a.h5", *given, "--workers", 1)
    lines = once.err.splitlines()
    assert [("drift by" in line, "two layers within" in line) for line in lines] == [
        (True, False),
        (False, True),
    ]
    assert tofmix("estimate", "a.h5", *given, "--workers", 3, "--overwrite").err == once.err
    assert tofmix("estimate", "a.h5", *given, "--resume").err.splitlines()[:1] == lines[:1]
    assert lines[1] in tofmix("estimate", "a.h5", *given, "--resume").err.splitlines()
    for number in (1, 2):
        part = tofmix("estimate", "a.h5", *given, "--shard", f"{number}/2")
        assert part.err.splitlines() == lines[:1]
    merged = tofmix("merge", "a.layers.1-of-2.part", "a.layers.2-of-2.part", "-o", "a.layers.h5", "--overwrite")
    assert merged.err.splitlines() == lines[1:]
    told = json.loads(tofmix("report", "a.layers.h5", "--json").out)["warnings"]
    said = [f"{w['text']} Try: {', or: '.join(w['commands'])}" if w["commands"] else w["text"] for w in told]
    assert [f"tofmix: a.layers.h5: {text}" for text in said] == lines[1:]
    told = json.loads(tofmix("report", "a.layers.h5", "--recording", "a.h5", "--json").out)["warnings"]
    assert [warning["code"] for warning in told] == ["drift", "close_layers"]


@pytest.mark.slow
def test_each_of_several_recordings_has_its_own_findings(tofmix: Tofmix, tmp_path: Path) -> None:
    well, drifts = _wall(tmp_path / "a.h5"), _wall(tmp_path / "b.h5", drift=8.0)
    done = tofmix("estimate", well, drifts, "--output-dir", tmp_path / "out", "--mixing", "events", "--json")
    first, second = (json.loads(line)["warnings"] for line in done.out.splitlines())
    assert (first, [warning["code"] for warning in second]) == (
        [],
        ["drift", "close_layers"],
    )
    assert str(well) not in done.err


def test_recording_with_the_mark_averaged_is_refused_unless_it_is_0(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _wall(tmp_path / "a.h5")
    for mark, code in ((1, ExitCode.BAD_INPUT), (0, ExitCode.DONE), (np.int64(1), ExitCode.BAD_INPUT)):
        with h5py.File(recording, "a") as root:
            root.attrs["averaged"] = mark
        done = tofmix("estimate", recording, "-o", tmp_path / f"{mark}.layers.h5", "--overwrite")
        assert done.code == code
        if code:
            assert "marked as averaged" in done.err
            assert "--force" in done.err
            assert not (tmp_path / "1.layers.h5").exists()
    assert tofmix("estimate", recording, "--force").code == 0


def test_output_of_simulate_averaged_is_refused_with_exit_code_3(tofmix: Tofmix, tmp_path: Path) -> None:
    model = tmp_path / "m.toml"
    model.write_text(
        '[sensor]\nprofile = "sr3000"\nintegration_time_ms = 1.2\nrows = 4\ncols = 5\n[recording]\nframes = 12\n'
        '[[surface]]\nname = "w"\n'
        "center_mm = [0.0, 0.0, 2000.0]\nsize_mm = [4000.0, 4000.0]\n"
    )
    assert tofmix("simulate", model, "-o", tmp_path / "a.h5", "--averaged").code == 0
    assert tofmix("estimate", tmp_path / "a.h5").code == ExitCode.BAD_INPUT
