"""A read that hangs ends the program, in words; nothing unfinished stays."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest
from support.measured import coverage_environment

from tofmix.errors import ExitCode
from tofmix.io.guard.watchdog import Watchdog, limit_s, watched

PROGRAM = """
import sys, time
from pathlib import Path
from tofmix.io.storage import AtomicFile
from tofmix.io.guard.watchdog import arm, watched
arm()
arm()
with AtomicFile(Path(sys.argv[1]) / "out", overwrite=False), watched("a.h5: range"):
    time.sleep(100)
"""


def test_a_read_that_hangs_ends_the_program(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env={"TOFMIX_READ_TIMEOUT": "0.3", "PYTHONPATH": ":".join(sys.path)} | coverage_environment(),
    )
    assert done.returncode == ExitCode.STORAGE
    assert done.stderr == "tofmix: a.h5: range: reading returned no data for 0.3 s; given up\n"
    assert list(tmp_path.iterdir()) == []


def test_reads_that_end_in_time_are_not_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOFMIX_READ_TIMEOUT", "0.2")
    monkeypatch.setattr("tofmix.io.guard.watchdog.POLL_S", 0.01)
    told: list[tuple[str, float]] = []
    gone = threading.Event()

    def give_up(what: str, seconds: float) -> None:
        told.append((what, seconds))
        gone.set()

    dog = Watchdog(give_up)
    with dog.over("quick"):
        pass
    with dog.over("slow"):
        assert gone.wait(30)
    assert told == [("slow", 0.2)]


def test_without_a_watchdog_nothing_is_watched() -> None:
    with watched("a.h5"):
        pass


@pytest.mark.parametrize(("text", "expected"), [("3.5", 3.5), ("", 7.0), ("-1", 7.0), ("inf", 7.0), ("soon", 7.0)])
def test_the_limit_is_a_number_above_0(monkeypatch: pytest.MonkeyPatch, text: str, expected: float) -> None:
    monkeypatch.setenv("TOFMIX_READ_TIMEOUT", text)
    assert limit_s(7.0) == expected
