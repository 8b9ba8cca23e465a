"""`tofmix estimate`: from recordings to layers files, with every option; the same bytes in however many pieces."""

import io
import json
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import boards, contents, write_recording
from support.full_disk import FullDisk
from support.sizes import sized

from tofmix.errors import ExitCode
from tofmix.io.layers.journal import journal_path, open_journal
from tofmix.io.recording.recording_file import file_sha256


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "a.h5", boards(40))


def test_estimate_finds_the_surfaces_of_the_model(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    outcome = tofmix.done("estimate", recording)
    found = contents(tmp_path / "a.layers.h5")
    assert outcome.out.startswith(f"{tmp_path / 'a.layers.h5'}: 4 x 6 pixels, 1 window of 40 frames")
    np.testing.assert_allclose(found["range"][0, :, 0, 0], 1200, atol=15)
    np.testing.assert_allclose(found["range"][0, :, -1, 0], 3000, atol=25)
    assert np.all(found["n_modes"][0, :, 3] == 2)
    assert found["source"] == "a.h5"
    assert found["source_sha256"] == file_sha256(recording)
    options = json.loads(found["options"])
    assert options == {
        "sigma": "prior",
        "refine": "likelihood",
        "false_alarm": 0.001,
        "counter": "kde",
        "gamma": 0.02,
        "epsilon": 0.01,
        "max_layers": 6,
        "max_iter": 50,
        "tol": 0.001,
        "min_samples": 3,
        "noise": "file",
        "outliers": "file",
        "window": 40,
        "stride": 40,
    }


def test_bytes_do_not_depend_on_workers_memory_or_time(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    for name, extra in (("x", ["--workers", 1]), ("y", ["--workers", 3, "--memory", "250MB"]), ("z", [])):
        tofmix.done("estimate", recording, "-o", tmp_path / name, "--window", 15, "--stride", 5, *extra)
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes() == (tmp_path / "z").read_bytes()


def test_frames_after_the_last_window_are_left_out_with_a_note(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    outcome = tofmix("estimate", recording, "--window", 15)
    assert "2 windows of 15 frames" in outcome.out
    assert "10 frames after the last whole window left out" in outcome.err
    found = contents(tmp_path / "a.layers.h5")
    assert found["window_stop"].tolist() == [15, 30]
    assert found["frames_left_out"] == 10


@pytest.mark.parametrize(
    ("option", "value", "changes"),
    [
        ("--sigma", "free", "sigma"),
        ("--max-layers", 1, "n_modes"),
        ("--noise", "sr3000", "sigma"),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (
                ("--sigma", "tied", "sigma"),
                ("--gamma", 0.9, "n_peaks"),
                ("--max-iter", 1, "n_iter"),
                ("--tol", 1e-12, "n_iter"),
                ("--min-samples", 41, "status"),
                ("--epsilon", 5.0, "n_peaks"),
            )
        ),
    ],
)
def test_every_option_of_estimate_changes_its_layers(
    tofmix: Tofmix, recording: Path, tmp_path: Path, option: str, value: object, changes: str
) -> None:
    # Counted by likelihood, surfaces so far apart are at their end after two steps.
    more = ["--refine", "none"] if option == "--tol" else []
    tofmix("estimate", recording, "-o", tmp_path / "plain", *more)
    tofmix.done("estimate", recording, "-o", tmp_path / "changed", option, value, *more)
    plain, changed = contents(tmp_path / "plain"), contents(tmp_path / "changed")
    assert not np.array_equal(plain[changes], changed[changes], equal_nan=True)
    assert plain["options"] != changed["options"]


@pytest.mark.slow
@pytest.mark.compiled("a frequency over 1600 pixels")
def test_higher_false_alarm_rate_gives_more_second_layers(tofmix: Tofmix, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    path = write_recording(tmp_path / "a.h5", rng.normal(1200, 22, (40, 40, 40)).astype("u2"))
    counts = []
    for false_alarm in (1e-5, 0.1):
        tofmix.done("estimate", path, "--overwrite", "--false-alarm", false_alarm)
        counts.append(np.sum(contents(tmp_path / "a.layers.h5")["n_modes"] > 1))
    assert counts[0] < 5
    assert counts[1] > 60
    tofmix.done("estimate", path, "--overwrite", "--refine", "none")
    found = contents(tmp_path / "a.layers.h5")
    # A component may lose its samples to another in the fit.
    assert np.mean(found["n_modes"] == found["n_peaks"]) > 0.99
    assert np.sum(found["n_modes"] > 1) > 60
    assert tofmix("estimate", path, "--refine", "none", "--false-alarm", 0.01).code == ExitCode.USAGE


@pytest.mark.parametrize("shape", [(20, 1, 16), (20, 16, 1), (20, 1, 1), (3, 2, 2), (25, 480, 3)])
def test_estimate_accepts_other_image_sizes(tofmix: Tofmix, tmp_path: Path, shape: tuple[int, int, int]) -> None:
    path = write_recording(tmp_path / "a.h5", np.full(shape, 1500, "u2"))
    tofmix.done("estimate", path)
    assert contents(tmp_path / "a.layers.h5")["range"].shape == (1, *shape[1:], 6)


def test_invalid_samples_are_skipped_and_counted(tofmix: Tofmix, tmp_path: Path) -> None:
    samples = boards().astype("f4")
    samples[:, 0, 0] = np.nan
    samples[:10, 1, 1] = np.nan
    path = write_recording(tmp_path / "a.h5", samples)
    tofmix.done("estimate", path)
    found = contents(tmp_path / "a.layers.h5")
    assert found["status"][0, 0, 0] == 1
    assert found["n_samples"][0, 1, 1] == 20


@pytest.mark.parametrize(
    ("extra", "code", "reason"),
    [
        (["--window", 41], ExitCode.USAGE, "longer than the recording's 40"),
        (["--noise", "sr9000"], ExitCode.USAGE, "unknown profile 'sr9000'"),
        (["--max-layers", 33], ExitCode.USAGE, "33 is not in the range 1<=x<=32"),
        (["--gamma", "nan"], ExitCode.USAGE, "gamma"),
        (["-o", "/proc/none/a.h5"], ExitCode.STORAGE, "no such folder"),
        (["--memory", "much"], ExitCode.USAGE, "'much' is not a size; write 300MB or 1.5GB"),
        (["--memory", "10MB"], ExitCode.USAGE, "'10MB' is too small; give at least 250MB"),
        (["--shard", "3/2"], ExitCode.USAGE, "'3/2' is not a part I/N"),
        (["--shard", "1/2", "--scheduler", "tcp://none:1"], ExitCode.USAGE, "--scheduler exclude each other"),
        (["--stride", 5], ExitCode.USAGE, "--stride needs --window"),
        (["-o", ""], ExitCode.USAGE, "the path is empty"),
    ],
)
def test_estimate_refuses_options_with_their_exit_code(
    tofmix: Tofmix, recording: Path, tmp_path: Path, extra: list[object], code: int, reason: str
) -> None:
    tofmix("estimate", recording, *extra).refused(code, reason)
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_existing_output_is_kept_without_overwrite(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    (tmp_path / "a.layers.h5").write_text("old")
    assert tofmix("estimate", recording).code == ExitCode.USAGE
    assert (tmp_path / "a.layers.h5").read_text() == "old"
    assert tofmix("estimate", recording, "-o", recording, "--overwrite").code == ExitCode.USAGE
    tofmix.done("estimate", recording, "--overwrite")


def test_damage_found_during_reading_leaves_no_output(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(400), chunks=(100, 4, 6), fletcher32=True)
    with h5py.File(path) as root:
        offset = root["range"].id.get_chunk_info(3).byte_offset
    data = bytearray(path.read_bytes())
    data[offset + 5] ^= 255
    path.write_bytes(data)
    outcome = tofmix("estimate", path, "--window", 100)
    assert outcome.code == ExitCode.BAD_INPUT
    assert outcome.err.startswith(f"tofmix: {path}: range: cannot be read")
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_layers_file_passes_the_format_checker(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    contract = Path(__file__).parents[4] / "shared" / "check_contract.py"
    if not contract.exists():
        pytest.skip("the contract's checker is not beside this checkout")
    tofmix("estimate", recording, "--window", 15)
    subprocess.run([sys.executable, contract, tmp_path / "a.layers.h5"], check=True)


def test_paper_option_writes_the_papers_algorithm_and_refuses_options_that_it_does_not_have(
    tofmix: Tofmix, recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "paper.layers.h5"
    tofmix.done("estimate", recording, "-o", out, "--paper", "--gamma", "0.1")
    with h5py.File(out) as file:
        options = json.loads(file.attrs["options"])
        assert (options["paper"], options["gamma"], options["sigma"]) == (True, 0.1, "free")
        assert set(np.unique(file["n_iter"][:])) <= {0, 50}
    for option in (("--sigma", "tied"), ("--refine", "likelihood"), ("--tol", "0.01"), ("--wrap",)):
        refused = tofmix("estimate", recording, "-o", tmp_path / "no.h5", "--paper", *option)
        refused.refused(2, f"{option[0]} and --paper exclude each other")


WINDOWS = ("--window", 10, "--stride", 5)
UNKNOWN = {"range_min_mm": np.nan, "range_max_mm": np.nan}


@pytest.fixture
def recording_endless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", sized(4096, 128))
    samples = boards(200, *sized((16, 20), (2, 5)))
    samples[3, 0, 0], samples[-1, -1, -1] = 90, 21_000  # each end in another block
    return write_recording(tmp_path / "a.h5", samples, attributes=UNKNOWN, chunks=(7, 2, 5))


def test_extreme_samples_are_stored_and_noted(tofmix: Tofmix, recording_endless: Path, tmp_path: Path) -> None:
    outcome = tofmix.done("estimate", recording_endless, *WINDOWS)
    assert "random values spread from the smallest sample to the largest, 90 to 21000 mm" in outcome.err
    with h5py.File(tmp_path / "a.layers.h5") as root:
        attributes = root["sensor"].attrs
        assert (attributes["sample_min_mm"], attributes["sample_max_mm"]) == (90.0, 21_000.0)
    tofmix.done("verify", tmp_path / "a.layers.h5")
    assert "sample_max_mm              21000" in tofmix("info", tmp_path / "a.layers.h5").out
    assert "sample_max_mm" not in tofmix("info", recording_endless).out


@pytest.fixture
def recordings(tmp_path: Path) -> list[Path]:
    return [write_recording(tmp_path / f"{name}.h5", boards(20, cols=3 + k)) for k, name in enumerate("abc")]


def test_each_recording_gets_its_file_and_its_line(tofmix: Tofmix, recordings: list[Path], tmp_path: Path) -> None:
    outcome = tofmix.done("estimate", *recordings, "--output-dir", tmp_path / "out", "--mixing", "events")
    said = [" 20 frames a window; tofmix asks for 25 or more." in line for line in outcome.err.splitlines()]
    assert said == [True] * 3
    assert [line.split(":")[0] for line in outcome.out.splitlines()] == [
        str(tmp_path / "out" / f"{name}.layers.h5") for name in "abc"
    ]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.layers.h5", "b.layers.h5", "c.layers.h5"]
    tofmix.done("estimate", recordings[1])
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
    tofmix.done("estimate", "-", "--output-dir", tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.layers.h5", "c.layers.h5"]
    assert tofmix("estimate", "-", "--output-dir", tmp_path / "out").code == ExitCode.USAGE


def test_impossible_outputs_are_refused_before_the_first_recording_iscontents(
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
        tofmix("estimate", *arguments).refused(ExitCode.USAGE, reason)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["c.layers.h5"]
    assert tofmix("estimate", *recordings, "--output-dir", recordings[0]).code == ExitCode.STORAGE


CELL_PIXELS = sized(4096, 128)
ROWS, COLS = sized((16, 20), (2, 5))


@pytest.fixture
def recording_resume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # 39 windows in 4 cells.
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", CELL_PIXELS)
    return write_recording(tmp_path / "a.h5", boards(200, ROWS, COLS))


_EXPECTED: list[bytes] = []
"""The layers file of one run, made by the first test that needs it."""


@pytest.fixture
def expected_resume(tofmix: Tofmix, recording_resume: Path, tmp_path: Path) -> bytes:
    if not _EXPECTED:
        path = tmp_path / "expected"
        tofmix.done("estimate", recording_resume, "-o", path, *WINDOWS)
        _EXPECTED.append(path.read_bytes())
        path.unlink()
    return _EXPECTED[0]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
def test_full_disk_keeps_the_journal_and_resume_gives_the_same_bytes(
    tofmix: Tofmix, recording_resume: Path, tmp_path: Path, expected_resume: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("os.pwrite", FullDisk(3))
        outcome = tofmix("estimate", recording_resume, *WINDOWS)
    assert outcome.code == ExitCode.STORAGE
    assert "No space left on device; --resume continues from the finished blocks" in outcome.err
    assert names(tmp_path) == [".a.layers.h5.journal", "a.h5"]
    resumed = tofmix("estimate", recording_resume, *WINDOWS, "--resume")
    assert "blocks from the interrupted run: 4 of 4" in resumed.err
    assert (tmp_path / "a.layers.h5").read_bytes() == expected_resume
    assert names(tmp_path) == ["a.h5", "a.layers.h5"]


def _killed_at(recording: Path, cells: int, number: signal.Signals) -> "subprocess.CompletedProcess[str]":
    """Run the command in a process that gets a signal when some cells are in the journal."""
    program = (
        f"import os, sys\nimport tofmix.grid\ntofmix.grid.CELL_PIXELS = {CELL_PIXELS}\n"
        "from tofmix.io.layers.journal import Journal\nadd, count = Journal.add, [0]\n"
        "def counted(self, cell, encoded):\n"
        "    add(self, cell, encoded)\n    count[0] += 1\n"
        f"    if count[0] == {cells}:\n        os.kill(os.getpid(), {int(number)})\n"
        "Journal.add = counted\nfrom tofmix.cli.main import run\nrun(sys.argv[1:])\n"
    )
    arguments = [str(argument) for argument in ("estimate", recording, *WINDOWS)]
    return subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_killed_run_resumes_to_the_same_bytes(
    tofmix: Tofmix, recording_resume: Path, tmp_path: Path, expected_resume: bytes, number: signal.Signals
) -> None:
    done = _killed_at(recording_resume, 2, number)
    assert done.returncode == -number
    assert "Traceback" not in done.stderr
    if number != signal.SIGKILL:
        assert "--resume continues" in done.stderr
    resumed = tofmix.done("estimate", recording_resume, *WINDOWS, "--resume")
    assert "blocks from the interrupted run: 2 of 4" in resumed.err
    assert (tmp_path / "a.layers.h5").read_bytes() == expected_resume
    assert names(tmp_path) == ["a.h5", "a.layers.h5"]


@pytest.mark.slow
def test_old_journal_is_refused_for_another_window_or_recording_and_unused_without_resume(
    tofmix: Tofmix, recording_resume: Path, tmp_path: Path, expected_resume: bytes
) -> None:
    _killed_at(recording_resume, 3, signal.SIGKILL)
    other = tofmix("estimate", recording_resume, "--window", 20, "--resume")
    other.refused(ExitCode.USAGE, "--stride (5, now 20), --window (10, now 20)")
    write_recording(recording_resume, boards(200, ROWS, COLS)[::-1])
    changed = tofmix("estimate", recording_resume, *WINDOWS, "--resume")
    changed.refused(ExitCode.USAGE, "its recording (a.h5), which has other content")
    write_recording(recording_resume, boards(200, ROWS, COLS))
    afresh = tofmix.done("estimate", recording_resume, *WINDOWS)
    assert "an interrupted run left 3 of 4 blocks; starting afresh" in afresh.err
    assert "there already" not in afresh.err
    assert (tmp_path / "a.layers.h5").read_bytes() == expected_resume
    assert names(tmp_path) == ["a.h5", "a.layers.h5"]


def test_resume_starts_missing_outputs_and_keeps_finished_ones(
    tofmix: Tofmix, recording_resume: Path, tmp_path: Path
) -> None:
    tofmix.done("estimate", recording_resume, *WINDOWS, "--resume")
    output = tmp_path / "a.layers.h5"
    written = output.stat().st_mtime_ns
    again = tofmix.done("estimate", recording_resume, *WINDOWS, "--resume")
    assert "blocks from the interrupted run: 4 of 4" in again.err
    assert "pixels by surfaces" in again.out
    assert output.stat().st_mtime_ns == written
    assert (
        tofmix("estimate", recording_resume, "--window", 20, "--resume").code == ExitCode.USAGE
    )  # another result is there


@pytest.mark.slow
def test_running_estimate_is_not_disturbed_by_a_second_one(
    tofmix: Tofmix, recording_resume: Path, tmp_path: Path
) -> None:
    with open_journal(journal_path(tmp_path / "a.layers.h5"), b"x"):
        for extra in ([], ["--resume"], ["--overwrite"]):
            tofmix("estimate", recording_resume, *extra).refused(ExitCode.USAGE, "another run is using it")


@pytest.mark.slow
def test_merged_shards_have_the_bytes_of_one_run(
    tofmix: Tofmix, recording_resume: Path, tmp_path: Path, expected_resume: bytes
) -> None:
    parts = []
    for number in (3, 1, 2):
        outcome = tofmix.done("estimate", recording_resume, *WINDOWS, "--shard", f"{number}/3")
        parts.append(tmp_path / f"a.layers.{number}-of-3.part")
        assert outcome.out.startswith(f"{parts[-1]}: part {number} of 3 of {ROWS} x {COLS} pixels")
    tofmix.done("merge", *parts, "-o", tmp_path / "merged")
    assert (tmp_path / "merged").read_bytes() == expected_resume
    assert names(tmp_path) == sorted(["a.h5", "merged", *(part.name for part in parts)])
    # A finished part is left as it is.
    assert (
        "blocks from the interrupted run"
        in tofmix("estimate", recording_resume, *WINDOWS, "--shard", "1/3", "--resume").err
    )


@pytest.mark.slow
def test_parts_that_do_not_make_one_run_are_refused(tofmix: Tofmix, recording_resume: Path, tmp_path: Path) -> None:
    def part(number: int, count: int, *extra: object) -> Path:
        path = tmp_path / f"{number}-{count}{len(extra)}"
        tofmix.done("estimate", recording_resume, *WINDOWS, "--shard", f"{number}/{count}", "-o", path, *extra)
        return path

    one, two, other, foreign = part(1, 2), part(2, 2), part(2, 3), part(2, 2, "--gamma", 0.5)
    (tmp_path / "cut").write_bytes(two.read_bytes()[:5000])
    for given, code, reason in (
        ([one], ExitCode.USAGE, "the run has 2 parts; missing: 2"),
        ([one, two, one], ExitCode.USAGE, "part 1 twice"),
        ([one, other], ExitCode.USAGE, "of 3 parts, but"),
        ([one, foreign], ExitCode.USAGE, "it differs in --gamma (0.5, now 0.02)"),
        ([one, recording_resume], ExitCode.BAD_INPUT, "not a journal"),
        ([one, tmp_path / "cut"], ExitCode.BAD_INPUT, "cut"),
        ([one, tmp_path / "none"], ExitCode.BAD_INPUT, "No such file"),
    ):
        tofmix("merge", *given, "-o", tmp_path / "out").refused(code, reason)
        assert not (tmp_path / "out").exists()
    assert tofmix("merge", one, two, "-o", one, "--overwrite").code == ExitCode.USAGE
