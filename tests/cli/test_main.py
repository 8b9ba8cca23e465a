"""The command as a whole: help, what it imports, exit codes, signals and streams."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

import click
import pytest
from support.commandline import Tofmix
from support.files import boards, write_recording

from tofmix import __version__
from tofmix.cli.main import main
from tofmix.errors import EXIT_CODE_MEANINGS, ExitCode

COMMANDS = (
    "simulate",
    "estimate",
    "report",
    "inspect",
    "info",
    "compare",
    "import",
    "export",
    "map",
    "surfaces",
    "merge",
    "warmup",
)
PROGRAM = (sys.executable, "-m", "tofmix")


def test_help_shows_how_to_start_and_the_exit_codes(tofmix: Tofmix) -> None:
    shown = tofmix("--help")
    assert shown.code == 0
    assert "tofmix simulate three-boards -o boards.h5" in shown.out
    for code, text in EXIT_CODE_MEANINGS.items():
        assert f"{int(code)}  {text}" in shown.out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command_has_examples(tofmix: Tofmix, command: str) -> None:
    shown = tofmix(command, "--help")
    assert shown.code == 0
    assert f"Examples:\n    tofmix {command}" in shown.out
    assert max(len(line) for line in shown.out.splitlines()) <= 100


def test_version_option_prints_the_version(tofmix: Tofmix) -> None:
    assert tofmix("--version").out == f"tofmix, version {__version__}\n"


def test_help_imports_no_large_library() -> None:
    program = (
        "import sys\n"
        "from tofmix.cli.main import run\n"
        "try:\n    run(['--help'])\n"
        "except SystemExit:\n    pass\n"
        "print([m for m in ('numba', 'scipy', 'h5py', 'numpy', 'matplotlib') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "[]"


def test_the_bare_command_prints_its_help_as_help_does(tofmix: Tofmix) -> None:
    bare, asked = tofmix(), tofmix("--help")
    assert (bare.code, asked.code) == (ExitCode.USAGE, 0)
    assert (bare.out, bare.err) == ("", asked.out)
    assert bare.err.count("\n") > 30


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["estimate"],
        ["estimate", "a.h5", "--nonsense"],
        ["estimate", "a.h5", "--window", "0"],
        ["estimate", "a.h5", "--sigma", "loose"],
        ["simulate", "corridor"],
        ["simulate", "corridor", "-o"],
        ["report", "a.h5", "--window", "-1"],
    ],
)
def test_usage_errors_leave_with_2(tofmix: Tofmix, arguments: list[str]) -> None:
    outcome = tofmix(*arguments)
    assert outcome.code == ExitCode.USAGE
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith("tofmix: ")


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), ExitCode.STORAGE, "out of memory; close other programs"),
        (OSError(28, "No space left on device", "x.h5"), ExitCode.STORAGE, "x.h5: No space left on device"),
        (click.ClickException("no\nsuch"), ExitCode.USAGE, "no such"),
    ],
)
def test_any_error_prints_one_line_and_returns_its_exit_code(
    tofmix: Tofmix, monkeypatch: pytest.MonkeyPatch, error: Exception, code: ExitCode, said: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("tofmix.cli.main._discard", lambda _: None)  # pytest's own
    for command in main.commands.values():
        monkeypatch.setattr(command, "callback", fail)
    outcome = tofmix("warmup")
    assert outcome.code == code
    assert outcome.err.startswith(f"tofmix: {said}")
    assert outcome.err.count("\n") == 1


def test_variables_of_the_environment_do_not_switch_commands(tofmix: Tofmix, monkeypatch: pytest.MonkeyPatch) -> None:
    # TOFMIX_VERSION is what a CI job would call the version it installs.
    monkeypatch.setenv("TOFMIX_VERSION", "1")
    monkeypatch.setenv("TOFMIX_SIMULATE_LIST", "1")
    assert tofmix("simulate", "corridor").code == ExitCode.USAGE


def test_the_environment_sets_options(tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOFMIX_ESTIMATE_WINDOW", "10")
    path = write_recording(tmp_path / "a.h5", boards(30))
    assert "3 windows of 10 frames" in tofmix("estimate", path).out


def _to(stdout: int | IO[str]) -> "subprocess.CompletedProcess[str]":
    command = [*PROGRAM, "simulate", "--list"]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


def test_a_full_stdout_is_a_storage_error() -> None:
    with Path("/dev/full").open("w") as full:
        done = _to(full)
    assert done.returncode == ExitCode.STORAGE
    assert done.stderr == "tofmix: standard output: No space left on device\n"


def test_a_closed_pipe_gives_no_traceback() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = _to(writer)
    os.close(writer)
    assert done.returncode == 128 + signal.SIGPIPE
    assert done.stderr == ""


@pytest.mark.compiled("a scene of 25,344 pixels in another process")
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_signal_leaves_no_partial_output(tmp_path: Path, number: signal.Signals) -> None:
    # 10^6 frames take minutes: the signal comes in the middle.
    command = [*PROGRAM, "simulate", "three-boards", "--frames", "1000000", "-o", str(tmp_path / "a.h5")]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while running.poll() is None and not any(tmp_path.iterdir()):
            pass
        running.send_signal(number)
        _, err = running.communicate(timeout=60)
    finally:
        running.kill()
    assert running.returncode == -number  # a shell shows 128 + the signal's number
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_full_stderr_keeps_the_exit_code(tmp_path: Path) -> None:
    program = "from tofmix.cli.main import run; run(['info', 'none.h5'])"
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([sys.executable, "-c", program], stderr=full, cwd=tmp_path, check=False)
    assert done.returncode == ExitCode.BAD_INPUT


@pytest.mark.parametrize("then", [None, ValueError("cannot be closed")])
def test_memory_error_of_any_library_is_one_line(
    tofmix: Tofmix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, then: Exception | None
) -> None:
    def none(*_: object, **__: object) -> None:
        try:
            raise MemoryError
        finally:
            if then is not None:
                raise then

    monkeypatch.setattr("tofmix.io.guard.guard.StructureChecker.check", none)
    path = write_recording(tmp_path / "a.h5", boards())
    result = tofmix("info", path)
    assert result.code == ExitCode.STORAGE
    assert result.err.startswith("tofmix: out of memory; ")
    assert result.err.count("\n") == 1
