"""The bar on a terminal, --quiet, and --json of the commands that make something."""

import fcntl
import json
import os
import pty
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix.cli.main import main
from tofmix.cli.reporter import Progress
from tofmix.errors import ExitCode

MODEL = """\
[sensor]
profile = "sr4000"
rows = 4
cols = 6
[recording]
frames = 20
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
"""


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A terminal of no size, as serial lines and some containers have: its two ends."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 0, 0, 0, 0))
    yield ours, theirs
    for end in (ours, theirs):
        os.close(end)


def _shown(terminal: tuple[int, int], *arguments: object) -> str:
    """What a command writes on the terminal that is its stderr."""
    command = [sys.executable, "-m", "tofmix", *map(str, arguments)]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=terminal[1], check=False, timeout=120)
    assert done.returncode == 0
    os.set_blocking(terminal[0], False)
    try:
        return os.read(terminal[0], 1 << 16).decode()
    except BlockingIOError:  # nothing was written
        return ""


@pytest.mark.slow
def test_progress_bar_moves_on_a_terminal_without_a_width(terminal: tuple[int, int], tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MODEL)
    shown = _shown(terminal, "simulate", tmp_path / "m.toml", "-o", tmp_path / "a.h5")
    assert "simulate:   0%" in shown
    assert shown.endswith("\r")  # wiped out
    assert max(len(line) for line in shown.split("\r")) <= 80


@pytest.mark.slow
def test_quiet_shows_no_bar(terminal: tuple[int, int], tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MODEL)
    assert _shown(terminal, "simulate", tmp_path / "m.toml", "-o", tmp_path / "a.h5", "--quiet") == ""


def test_quiet_keeps_results_and_warnings_and_drops_notes(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards(45))
    loud = tofmix("estimate", recording, "--window", 20)
    quiet = tofmix("estimate", recording, "--window", 20, "-q", "--resume")
    assert "blocks from the interrupted run" in tofmix("estimate", recording, "--window", 20, "--resume").err
    assert quiet.out == loud.out
    assert "blocks from the interrupted run" not in quiet.err
    assert "5 frames after the last whole window left out" in quiet.err


def test_every_command_takes_quiet(tofmix: Tofmix) -> None:
    without = [name for name in main.commands if "--quiet" not in tofmix(name, "--help").out]
    assert without == []


@pytest.mark.slow
def test_quiet_drops_notes_of_verify_and_names_of_pages_with_json(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", boards(20), noise=None)
    assert "no noise curve" in tofmix("verify", recording).err
    assert tofmix("verify", recording, "--quiet").err == ""
    assert tofmix("estimate", recording, "-q").code == 0
    layers, figure = tmp_path / "a.layers.h5", tmp_path / "a.svg"
    arguments = ("inspect", layers, "--pixel", "0,0", "-o", figure, "--json", "--overwrite")
    assert tofmix(*arguments).err == f"figure: {figure}\n"
    assert tofmix(*arguments, "--quiet").err == ""


@pytest.mark.parametrize("command", ["simulate", "estimate", "import", "surfaces", "merge"])
def test_hdf5_is_not_written_under_the_name_of_another_kind(tofmix: Tofmix, tmp_path: Path, command: str) -> None:
    source = write_recording(tmp_path / "a.h5", boards(20))
    refused = tofmix(command, source, "-o", tmp_path / "b.png")
    assert refused.code == ExitCode.USAGE
    assert "b.png: the file will be HDF5, so its name must not end in .png; choose .h5" in refused.err


def test_each_writing_command_describes_its_output_in_json(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MODEL)
    twice = tofmix("simulate", tmp_path / "m.toml", "-o", tmp_path / "a.h5", "--repeat", 2, "--json")
    first, second = (json.loads(line) for line in twice.out.splitlines())
    assert first == {
        "output": str(tmp_path / "a_001.h5"),
        "frames": 20,
        "rows": 4,
        "cols": 6,
        "seed": 1,
        "averaged": False,
    }
    assert second["seed"] == 2
    layers = tmp_path / "a_001.layers.h5"
    assert tofmix("estimate", tmp_path / "a_001.h5").code == 0
    points = json.loads(tofmix("export", layers, "-o", tmp_path / "a.csv", "--json").out)
    assert points == {"output": str(tmp_path / "a.csv"), "points": 24, "windows": 1}
    map_of = json.loads(tofmix("map", layers, "-o", tmp_path / "a.yaml", "--json").out)
    assert map_of["map"]["path"] == str(tmp_path / "a.yaml")


def test_json_without_an_output_is_refused(tofmix: Tofmix) -> None:
    for option in ("--explain", "--print-model"):
        assert tofmix("simulate", "corridor", option, "--json").code == ExitCode.USAGE


def test_help_describes_completion_and_environment(tofmix: Tofmix) -> None:
    said = tofmix("--help").out
    assert "_TOFMIX_COMPLETE=bash_source" in said
    assert "TOFMIX_ESTIMATE_WORKERS=1" in said


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_its_script(shell: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tofmix"],
        env=os.environ | {"_TOFMIX_COMPLETE": f"{shell}_source"},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert "_TOFMIX_COMPLETE" in done.stdout


def test_where_stderr_is_no_terminal_a_line_a_minute_says_how_far(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr("tofmix.cli.reporter.time.monotonic", lambda: now[0])
    with Progress(4000, "estimate", "px") as bar:
        for now[0] in (30.0, 61.0, 90.0, 130.0):
            bar.update(1000)
    expected = "tofmix: estimate: 2,000 of 4,000 px (50 %)\ntofmix: estimate: 4,000 of 4,000 px (100 %)\n"
    assert capsys.readouterr().err == expected
