"""Closed standard streams, as daemons and schedulers start programs: whole outputs, and the usual exit codes."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.files import boards, write_recording

from tofmix.errors import ExitCode

TOFMIX = f"{shlex.quote(sys.executable)} -m tofmix"


def _run(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a line of the shell, where TOFMIX is the program."""
    command = ["sh", "-c", line.replace("TOFMIX", TOFMIX)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.slow
@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&-", ">&- 2>&- <&-"])
def test_outputs_are_whole_with_closed_streams(closed: str, tmp_path: Path) -> None:
    write_recording(tmp_path / "a.h5", boards(40))
    assert _run("TOFMIX estimate a.h5 -o open.h5", tmp_path).returncode == 0
    done = _run(f"TOFMIX estimate a.h5 -o closed.h5 {closed}", tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False)
    assert (tmp_path / "closed.h5").read_bytes() == (tmp_path / "open.h5").read_bytes()


@pytest.mark.slow
def test_a_report_without_stdout_and_a_refusal_without_stderr_end_with_their_codes(tmp_path: Path) -> None:
    write_recording(tmp_path / "a.h5", boards(40))
    assert _run("TOFMIX estimate a.h5 -o a.layers.h5", tmp_path).returncode == 0
    assert _run("TOFMIX report a.layers.h5 >&-", tmp_path).returncode == 0
    assert _run("TOFMIX report none.h5 2>&-", tmp_path).returncode == ExitCode.BAD_INPUT


def test_a_closed_stdin_names_no_recording(tmp_path: Path) -> None:
    done = _run("TOFMIX estimate - <&-", tmp_path)
    assert done.returncode == ExitCode.USAGE
    assert "stdin names no recording" in done.stderr
