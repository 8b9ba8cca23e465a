"""Runs `tofmix` commands one after the other, each in a fork of one warm process: no start-up, whatever a command dies of.

Start it as `python -m faults.server`: jobs come as JSON lines on stdin, outcomes leave as JSON lines on stdout. The fork
ends as the program itself would, through the interpreter's exit, so that what crashes there is seen.
"""

import ctypes
import gc
import json
import os
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

MOST_BYTES = 6 << 30
"""Address space of a command: a runaway must not take the machine with it."""

_MOST_TEXT = 20_000


def main() -> None:
    """Serve until stdin ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what commands say while this process warms up is no answer
    run = _warm()
    gc.freeze()
    for line in sys.stdin:
        job = json.loads(line)
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            start = time.monotonic()
            child = os.fork()
            if child == 0:
                _begin(job, out.fileno(), err.fileno())
                run(job["argv"])  # leaves by SystemExit, through the interpreter's own end
            answer = _end(child, job) | {"seconds": time.monotonic() - start, "calls": _calls(job)}
            for name, file in (("out", out), ("err", err)):
                file.seek(0)
                answer[name] = file.read(_MOST_TEXT).decode("utf-8", "replace")
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _warm() -> Any:  # noqa: ANN401  the program's entry, imported late
    """Import what commands import, and compile or load every kernel."""
    import h5py  # noqa: F401  before the commands need it
    import numpy  # noqa: F401, ICN001  likewise

    from tofmix.cli.main import run

    with tempfile.TemporaryDirectory() as name:
        for argv in _rehearsal(Path(name)):
            try:
                run(argv)
            except SystemExit as leave:
                if leave.code:
                    raise
    return run


def _rehearsal(folder: Path) -> list[list[str]]:
    """Commands that touch what the others will need."""
    from faults.originals import MODEL

    model, recording, layers = folder / "a.toml", folder / "a.h5", folder / "a.layers.h5"
    model.write_text(MODEL)
    return [
        [str(part) for part in argv]
        for argv in (
            ("simulate", model, "-o", recording),
            ("estimate", recording, "--window", 10),
            ("estimate", recording, "--noise", "auto", "--outliers", "auto", "-o", folder / "b.layers.h5"),
            ("info", recording),
            ("report", layers, "--recording", recording, "--html", folder / "a.html"),
            ("inspect", layers, "--pixel", "1,2", "--recording", recording, "-o", folder / "a.png"),
            ("compare", layers, layers, "--html", folder / "c.html"),
            ("export", layers, "-o", folder / "a.csv"),
            ("export", layers, "-o", folder / "a.ply"),
            ("map", layers, "-o", folder / "a.yaml"),
        )
    ]


def _begin(job: dict[str, Any], out: int, err: int) -> None:
    """Make this fork look like a fresh process that a shell has started."""
    os.setpgid(0, 0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(out, 1)
    os.dup2(err, 2)
    os.chdir(job["cwd"])
    sys.excepthook = traceback.print_exception
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (job["cpu_s"], job["cpu_s"] + 1))
    if job["file_bytes"] is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (job["file_bytes"],) * 2)
    if job["fault"] is not None:
        shim = ctypes.CDLL(None)
        operation, number, error, once = job["fault"]
        shim.fault_arm(str(job["cwd"]).encode(), operation.encode(), number, error, once)


def _calls(job: dict[str, Any]) -> int:
    """How many calls of the kind that was to fail there were."""
    return 0 if job["fault"] is None else int(ctypes.CDLL(None).fault_count())


def _end(child: int, job: dict[str, Any]) -> dict[str, Any]:
    """Wait for a fork, kill it when its time is over or as it was asked for."""
    waiting = os.pidfd_open(child)
    limit, hung = job["timeout_s"], False
    if job["kill_after_s"] is not None:
        select.select([waiting], [], [], job["kill_after_s"])
        _kill(child, job["kill_signal"])
    elif not select.select([waiting], [], [], limit)[0]:
        hung = True
        _kill(child, signal.SIGKILL)
    if not hung and not select.select([waiting], [], [], limit)[0]:
        hung = True
        _kill(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    os.close(waiting)
    code = os.waitstatus_to_exitcode(status)
    hung = hung or code == -signal.SIGXCPU
    here = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    used = {"cpu_s": usage.ru_utime + usage.ru_stime, "extra_bytes": max(0, usage.ru_maxrss * 1024 - here)}
    return {"code": code, "hung": hung} | used


def _kill(child: int, number: int) -> None:
    try:
        os.kill(child, number)
    except ProcessLookupError:
        pass  # it was quicker


if __name__ == "__main__":
    main()
