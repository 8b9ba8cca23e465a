"""`tofmix estimate` with several recordings: one line each, and the others done if one fails."""

import io
import json
from pathlib import Path

import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.errors import ExitCode


@pytest.fixture
def recordings(tmp_path: Path) -> list[Path]:
    return [write_recording(tmp_path / f"{name}.h5", boards(20, cols=3 + k)) for k, name in enumerate("abc")]


def test_each_recording_gets_its_file_and_its_line(tofmix: Tofmix, recordings: list[Path], tmp_path: Path) -> None:
    outcome = tofmix("estimate", *recordings, "--output-dir", tmp_path / "out", "--mixing", "events")
    assert outcome.code == 0, outcome.err
    said = [" 20 frames a window; tofmix asks for 25 or more." in line for line in outcome.err.splitlines()]
    assert said == [True] * 3
    assert [line.split(":")[0] for line in outcome.out.splitlines()] == [
        str(tmp_path / "out" / f"{name}.layers.h5") for name in "abc"
    ]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.layers.h5", "b.layers.h5", "c.layers.h5"]
    assert tofmix("estimate", recordings[1]).code == 0
    assert (tmp_path / "b.layers.h5").read_bytes() == (tmp_path / "out" / "b.layers.h5").read_bytes()


@pytest.mark.slow
def test_failed_recording_does_not_stop_the_others(tofmix: Tofmix, recordings: list[Path], tmp_path: Path) -> None:
    recordings[1].write_text("not a recording")
    outcome = tofmix("estimate", *recordings, tmp_path / "none.h5", "--output-dir", tmp_path / "out", "--json")
    assert outcome.code == ExitCode.SOME_FAILED
    said = [json.loads(line) for line in outcome.out.splitlines()]
    assert [(Path(one["recording"]).stem, one["status"], one["exit_code"]) for one in said] == [
        ("a", "done", 0),
        ("b", "failed", 3),
        ("c", "done", 0),
        ("none", "failed", 3),
    ]
    assert "not an HDF5 file" in said[1]["error"]
    assert sum(said[0]["pixels_by_surfaces"]) == 4 * 3
    assert outcome.err.splitlines()[-1] == "tofmix: 2 of 4 recordings failed; the others are done"
    said = [line for line in outcome.err.splitlines() if "compiling the kernels" not in line]
    notes = "Mixing is not measured", "20 frames a window"
    assert len([line for line in said if not any(note in line for note in notes)]) == 3
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.layers.h5", "c.layers.h5"]
    # What is done is left as it is.
    again = tofmix("estimate", *recordings, "--output-dir", tmp_path / "out", "--resume")
    assert again.code == ExitCode.SOME_FAILED
    assert again.err.count("blocks from the interrupted run: 1 of 1") == 2


@pytest.mark.slow
def test_names_of_recordings_are_read_from_stdin(
    tofmix: Tofmix, recordings: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{recordings[0]}\n\n{recordings[2]}\n"))
    outcome = tofmix("estimate", "-", "--output-dir", tmp_path / "out")
    assert outcome.code == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.layers.h5", "c.layers.h5"]
    assert tofmix("estimate", "-", "--output-dir", tmp_path / "out").code == ExitCode.USAGE


def test_impossible_outputs_are_refused_before_the_first_recording_is_read(
    tofmix: Tofmix, recordings: list[Path], tmp_path: Path
) -> None:
    (tmp_path / "other").mkdir()
    twin = write_recording(tmp_path / "other" / "a.h5", boards())
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "c.layers.h5").write_text("old")
    for arguments, reason in (
        ([*recordings], "several recordings need --output-dir"),
        ([*recordings, "-o", tmp_path / "x"], "-o takes a single recording"),
        ([recordings[0], twin, "--output-dir", tmp_path / "out"], "would both be written to"),
        ([recordings[0], recordings[0], "--output-dir", tmp_path / "out"], "would both be written to"),
        ([*recordings, "--output-dir", tmp_path / "out"], "c.layers.h5 exists; pass --overwrite"),
    ):
        outcome = tofmix("estimate", *arguments)
        assert outcome.code == ExitCode.USAGE
        assert reason in outcome.err
        assert outcome.out == ""
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["c.layers.h5"]
    assert tofmix("estimate", *recordings, "--output-dir", recordings[0]).code == ExitCode.STORAGE


@pytest.mark.slow
def test_output_dir_accepts_a_single_recording(tofmix: Tofmix, recordings: list[Path], tmp_path: Path) -> None:
    outcome = tofmix("estimate", recordings[0], "--output-dir", tmp_path / "out", "--json")
    assert json.loads(outcome.out)["output"] == str(tmp_path / "out" / "a.layers.h5")
