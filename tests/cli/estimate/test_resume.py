"""`tofmix estimate --resume`, `--shard` and `merge`: the same bytes in however many pieces."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording
from support.full_disk import FullDisk
from support.sizes import sized

from tofmix.errors import ExitCode
from tofmix.io.layers.journal import journal_path, open_journal

WINDOWS = ("--window", 10, "--stride", 5)
CELL_PIXELS = sized(4096, 128)
ROWS, COLS = sized((16, 20), (2, 5))


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # 39 windows in 4 cells.
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", CELL_PIXELS)
    return write_recording(tmp_path / "a.h5", boards(200, ROWS, COLS))


_EXPECTED: list[bytes] = []
"""The layers file of one run, made by the first test that needs it."""


@pytest.fixture
def expected(tofmix: Tofmix, recording: Path, tmp_path: Path) -> bytes:
    if not _EXPECTED:
        path = tmp_path / "expected"
        assert tofmix("estimate", recording, "-o", path, *WINDOWS).code == 0
        _EXPECTED.append(path.read_bytes())
        path.unlink()
    return _EXPECTED[0]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
def test_full_disk_keeps_the_journal_and_resume_gives_the_same_bytes(
    tofmix: Tofmix, recording: Path, tmp_path: Path, expected: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("os.pwrite", FullDisk(3))
        outcome = tofmix("estimate", recording, *WINDOWS)
    assert outcome.code == ExitCode.STORAGE
    assert "No space left on device; --resume continues from the finished blocks" in outcome.err
    assert names(tmp_path) == [".a.layers.h5.journal", "a.h5"]
    resumed = tofmix("estimate", recording, *WINDOWS, "--resume")
    assert "blocks from the interrupted run: 4 of 4" in resumed.err
    assert (tmp_path / "a.layers.h5").read_bytes() == expected
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
    tofmix: Tofmix, recording: Path, tmp_path: Path, expected: bytes, number: signal.Signals
) -> None:
    done = _killed_at(recording, 2, number)
    assert done.returncode == -number
    assert "Traceback" not in done.stderr
    if number != signal.SIGKILL:
        assert "--resume continues" in done.stderr
    resumed = tofmix("estimate", recording, *WINDOWS, "--resume")
    assert resumed.code == 0, resumed.err
    assert "blocks from the interrupted run: 2 of 4" in resumed.err
    assert (tmp_path / "a.layers.h5").read_bytes() == expected
    assert names(tmp_path) == ["a.h5", "a.layers.h5"]


@pytest.mark.slow
def test_old_journal_is_refused_for_another_window_or_recording_and_unused_without_resume(
    tofmix: Tofmix, recording: Path, tmp_path: Path, expected: bytes
) -> None:
    _killed_at(recording, 3, signal.SIGKILL)
    other = tofmix("estimate", recording, "--window", 20, "--resume")
    assert other.code == ExitCode.USAGE
    assert "--stride (5, now 20), --window (10, now 20)" in other.err
    write_recording(recording, boards(200, ROWS, COLS)[::-1])
    changed = tofmix("estimate", recording, *WINDOWS, "--resume")
    assert changed.code == ExitCode.USAGE
    assert "its recording (a.h5), which has other content" in changed.err
    write_recording(recording, boards(200, ROWS, COLS))
    afresh = tofmix("estimate", recording, *WINDOWS)
    assert afresh.code == 0
    assert "an interrupted run left 3 of 4 blocks; starting afresh" in afresh.err
    assert "there already" not in afresh.err
    assert (tmp_path / "a.layers.h5").read_bytes() == expected
    assert names(tmp_path) == ["a.h5", "a.layers.h5"]


@pytest.mark.slow
def test_damaged_journal_is_not_resumed(tofmix: Tofmix, recording: Path, expected: bytes) -> None:
    journal = journal_path(recording.with_name("a.layers.h5"))
    journal.write_bytes(b"something else altogether" * 100)
    assert tofmix("estimate", recording, *WINDOWS, "--resume").code == ExitCode.USAGE
    assert "starting afresh" in tofmix("estimate", recording, *WINDOWS).err
    assert recording.with_name("a.layers.h5").read_bytes() == expected


def test_resume_starts_missing_outputs_and_keeps_finished_ones(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    assert tofmix("estimate", recording, *WINDOWS, "--resume").code == 0
    output = tmp_path / "a.layers.h5"
    written = output.stat().st_mtime_ns
    again = tofmix("estimate", recording, *WINDOWS, "--resume")
    assert again.code == 0
    assert "blocks from the interrupted run: 4 of 4" in again.err
    assert "pixels by surfaces" in again.out
    assert output.stat().st_mtime_ns == written
    assert tofmix("estimate", recording, "--window", 20, "--resume").code == ExitCode.USAGE  # another result is there


@pytest.mark.slow
def test_kill_after_the_renaming_leaves_a_valid_output(
    tofmix: Tofmix, recording: Path, tmp_path: Path, expected: bytes
) -> None:
    _killed_at(recording, 4, signal.SIGKILL)
    (tmp_path / "a.layers.h5").write_bytes(expected)
    (tmp_path / ".a.layers.h5.journal.partial").write_bytes(expected[:1000])
    assert tofmix("estimate", recording, *WINDOWS, "--resume").code == 0
    assert names(tmp_path) == ["a.h5", "a.layers.h5"]


@pytest.mark.slow
def test_running_estimate_is_not_disturbed_by_a_second_one(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    with open_journal(journal_path(tmp_path / "a.layers.h5"), b"x"):
        for extra in ([], ["--resume"], ["--overwrite"]):
            outcome = tofmix("estimate", recording, *extra)
            assert outcome.code == ExitCode.USAGE
            assert "another run is using it" in outcome.err


@pytest.mark.slow
def test_merged_shards_have_the_bytes_of_one_run(
    tofmix: Tofmix, recording: Path, tmp_path: Path, expected: bytes
) -> None:
    parts = []
    for number in (3, 1, 2):
        outcome = tofmix("estimate", recording, *WINDOWS, "--shard", f"{number}/3")
        assert outcome.code == 0, outcome.err
        parts.append(tmp_path / f"a.layers.{number}-of-3.part")
        assert outcome.out.startswith(f"{parts[-1]}: part {number} of 3 of {ROWS} x {COLS} pixels")
    merged = tofmix("merge", *parts, "-o", tmp_path / "merged")
    assert merged.code == 0, merged.err
    assert (tmp_path / "merged").read_bytes() == expected
    assert names(tmp_path) == sorted(["a.h5", "merged", *(part.name for part in parts)])
    # A finished part is left as it is.
    assert (
        "blocks from the interrupted run" in tofmix("estimate", recording, *WINDOWS, "--shard", "1/3", "--resume").err
    )


@pytest.mark.slow
def test_parts_that_do_not_make_one_run_are_refused(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    def part(number: int, count: int, *extra: object) -> Path:
        path = tmp_path / f"{number}-{count}{len(extra)}"
        assert tofmix("estimate", recording, *WINDOWS, "--shard", f"{number}/{count}", "-o", path, *extra).code == 0
        return path

    one, two, other, foreign = part(1, 2), part(2, 2), part(2, 3), part(2, 2, "--gamma", 0.5)
    (tmp_path / "cut").write_bytes(two.read_bytes()[:5000])
    for given, code, reason in (
        ([one], ExitCode.USAGE, "the run has 2 parts; missing: 2"),
        ([one, two, one], ExitCode.USAGE, "part 1 twice"),
        ([one, other], ExitCode.USAGE, "of 3 parts, but"),
        ([one, foreign], ExitCode.USAGE, "it differs in --gamma (0.5, now 0.02)"),
        ([one, recording], ExitCode.BAD_INPUT, "not a journal"),
        ([one, tmp_path / "cut"], ExitCode.BAD_INPUT, "cut"),
        ([one, tmp_path / "none"], ExitCode.BAD_INPUT, "No such file"),
    ):
        outcome = tofmix("merge", *given, "-o", tmp_path / "out")
        assert outcome.code == code, outcome.err
        assert reason in outcome.err
        assert outcome.err.count("\n") == 1
        assert not (tmp_path / "out").exists()
    assert tofmix("merge", one, two, "-o", one, "--overwrite").code == ExitCode.USAGE


@pytest.mark.slow
def test_more_shards_than_cells_make_empty_parts(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "b.h5", boards(20))
    for number in (1, 2):
        assert tofmix("estimate", recording, "--shard", f"{number}/2").code == 0
    parts = sorted(tmp_path.glob("*.part"))
    assert tofmix("merge", *parts, "-o", tmp_path / "merged").code == 0
    assert tofmix("estimate", recording).code == 0
    assert (tmp_path / "merged").read_bytes() == (tmp_path / "b.layers.h5").read_bytes()
