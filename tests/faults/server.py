"""Runs `tofmix` commands one after the other in forks of one warm process: no start-up, whatever a command dies of.

Start it as `python -m faults.server`: jobs come as JSON lines on stdin, outcomes leave as JSON lines on stdout. A fresh
fork for each command ends as the program itself would, exit functions and the HDF5 library included, so that a crash
there is seen. A worker is a fork that runs many commands, which is quicker, and is replaced when one has killed it.
"""

import atexit
import ctypes
import gc
import json
import os
import resource
import select
import signal
import sys
import tempfile
import threading
import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import h5py

MOST_BYTES = 6 << 30
"""Address space of a command: a runaway must not take the machine with it."""

_MOST_TEXT = 20_000
_JOBS_OF_A_WORKER = 50


def main() -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what commands say while this process warms up is no answer
    run = _warm()
    gc.freeze()
    workers: list[_Worker] = []
    for line in sys.stdin:
        streams = {name: Path(_stream(name)) for name in ("out", "err")}
        job = json.loads(line) | {name: str(path) for name, path in streams.items()}
        start = time.monotonic()
        if job["fresh"]:
            answer = _in_a_fork(run, job)
        else:
            if not workers:
                workers.append(_Worker(run))
            answer = workers[0].run(job)
            if workers[0].ended:
                workers.clear()
        answer["seconds"] = time.monotonic() - start
        for name, path in streams.items():  # no context manager: a fork would leave it, too
            answer[name] = path.read_bytes()[:_MOST_TEXT].decode("utf-8", "replace")
            path.unlink()
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
    for worker in workers:
        worker.end()


def _stream(name: str) -> str:
    """Make an empty file for a stream."""
    descriptor, path = tempfile.mkstemp(prefix=f"{name}-")
    os.close(descriptor)
    return path


def _warm() -> Any:  # noqa: ANN401  the program's entry, imported late
    """Import what commands import, and compile or load every kernel."""
    from tqdm import tqdm

    from faults import structure_checker
    from tofmix.cli.main import run

    tqdm.monitor_interval = 0  # no thread of the parent's
    structure_checker.use()
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
            ("estimate", recording, "--window", 5, "-o", folder / "b.layers.h5"),
            ("estimate", recording, "--window", 10, "--noise", "auto", "--outliers", "auto"),
            ("estimate", recording, "--wrap", "-o", folder / "c.layers.h5"),
            ("info", recording),
            ("report", layers, "--recording", recording, "--html", folder / "a.html"),
            ("inspect", layers, "--pixel", "1,2", "--recording", recording, "-o", folder / "a.png"),
            ("export", layers, "-o", folder / "a.csv"),
            ("map", layers, "-o", folder / "a.yaml"),
            ("map", layers, "--from", "averaged", "--recording", recording, "-o", folder / "b.yaml"),
        )
    ]


def _in_a_fork(run: Any, job: dict[str, Any]) -> dict[str, Any]:  # noqa: ANN401  the program's entry
    """Run one command in a process of its own, faults and limits included."""
    child = os.fork()
    if child == 0:
        _begin()
        _redirect(job)
        resource.setrlimit(resource.RLIMIT_CPU, (job["cpu_s"], job["cpu_s"] + 1))
        if job["file_bytes"] is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (job["file_bytes"],) * 2)
        if job["fault"] is not None:
            operation, number, error, once = job["fault"]
            ctypes.CDLL(None).fault_arm(str(job["cwd"]).encode(), operation.encode(), number, error, once)
        if job["unprivileged"]:
            _give_up_privileges()
        _leave(_code_of(run, job))
    waiting = os.pidfd_open(child)
    hung = not _until(waiting, job["timeout_s"] if job["kill_after_s"] is None else job["kill_after_s"])
    if hung and job["kill_after_s"] is not None:
        _kill(child, job["kill_signal"])
        hung = not _until(waiting, job["timeout_s"])
    if hung:
        _kill(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    os.close(waiting)
    code = os.waitstatus_to_exitcode(status)
    return {
        "code": code,
        "hung": hung or code == -signal.SIGXCPU,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "extra_bytes": max(0, usage.ru_maxrss * 1024 - _resident()),
        "calls": _calls(job),
    }


def _give_up_privileges() -> None:
    """Be an administrator no longer: the owner's permissions hold for this process, as for any user's."""
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # the third version of Linux's structure; this process
    if ctypes.CDLL(None).capset(header, (ctypes.c_uint32 * 6)()):
        raise OSError("capset")


def _code_of(run: Any, job: dict[str, Any]) -> int:  # noqa: ANN401  the program's entry
    """Run a command; return the exit code that the interpreter would leave with."""
    try:
        run(job["argv"])
    except SystemExit as leave:
        return int(leave.code or 0)
    except BaseException:  # noqa: BLE001  as the interpreter would
        traceback.print_exc()
    return 1


def _leave(code: int) -> NoReturn:
    """End as the interpreter does, with the ends of threads, Python's exit functions and the HDF5 library.

    Objects are not destroyed, because that would copy all shared memory: half a second a command. Exit handlers of
    other C libraries do not run; `test_exit.py` runs them.
    """
    threading._shutdown()  # type: ignore[attr-defined]  # what the interpreter calls
    atexit._run_exitfuncs()
    with suppress(OSError, ValueError):
        sys.stdout.flush()
    ctypes.PyDLL(h5py.h5.__file__).H5close()  # what HDF5 does when a process ends
    os._exit(code)


class _Worker:
    """A fork that runs commands, one after the other."""

    def __init__(self, run: Any) -> None:  # noqa: ANN401  the program's entry
        jobs_out, self._jobs = os.pipe()
        self._answers, answers_in = os.pipe()
        self._child = os.fork()
        if self._child == 0:
            os.close(self._jobs)
            os.close(self._answers)
            _begin()
            _work(run, os.fdopen(jobs_out), answers_in)
        os.close(jobs_out)
        os.close(answers_in)
        self._done = 0
        self.ended = False

    def run(self, job: dict[str, Any]) -> dict[str, Any]:
        os.write(self._jobs, json.dumps(job).encode() + b"\n")
        hung = not select.select([self._answers], [], [], job["timeout_s"])[0]
        if hung:
            _kill(self._child, signal.SIGKILL)
        text = os.read(self._answers, 1 << 16)
        self._done += 1
        if text and not hung:
            answer: dict[str, Any] = json.loads(text)
            if self._done == _JOBS_OF_A_WORKER:
                answer["code"] = self.end() or answer["code"]  # a crash at its end is the last command's
            return answer
        code = self.end()
        return {"code": code, "hung": hung or code == -signal.SIGXCPU, "cpu_s": 0.0, "extra_bytes": 0, "calls": 0}

    def end(self) -> int:
        """Let it end; return its exit code."""
        os.close(self._jobs)
        os.close(self._answers)
        self.ended = True
        return os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])


def _work(run: Any, jobs: Any, answers: int) -> NoReturn:  # noqa: ANN401  the program's entry, a text stream
    for line in jobs:
        job = json.loads(line)
        Path("/proc/self/clear_refs").write_text("5")  # the highest memory begins anew
        before, used = _resident(), time.process_time()
        _redirect(job)
        limit = int(used) + job["cpu_s"] + 1
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
        code = _code_of(run, job)
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        peak = next(line for line in Path("/proc/self/status").read_text().split("\n") if line.startswith("VmHWM"))
        extra = max(0, int(peak.split()[1]) * 1024 - before)
        answer = {"code": code, "hung": False, "cpu_s": time.process_time() - used, "extra_bytes": extra, "calls": 0}
        os.write(answers, json.dumps(answer).encode())
    sys.exit(0)


def _begin() -> None:
    """Make this fork look like a fresh process that a shell has started."""
    from tqdm import tqdm

    from tofmix.io.guard import watchdog

    tqdm.set_lock(threading.RLock())  # its own is shared by all forks, and a killed one may hold it
    watchdog._watchdog.clear()  # its thread has stayed with the parent
    os.setpgid(0, 0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _redirect(job: dict[str, Any]) -> None:
    os.chdir(job["cwd"])
    for name, descriptor in (("out", 1), ("err", 2)):
        file = os.open("/dev/full" if name in job["full"] else job[name], os.O_WRONLY)
        os.dup2(file, descriptor)
        os.close(file)


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _calls(job: dict[str, Any]) -> int:
    """How many calls of the kind that was to fail there were."""
    return 0 if job["fault"] is None else int(ctypes.CDLL(None).fault_count())


def _until(process: int, seconds: float) -> bool:
    """Wait for a process to end; False if it has not in time."""
    return bool(select.select([process], [], [], seconds)[0])


def _kill(child: int, number: int) -> None:
    with suppress(ProcessLookupError):  # it was quicker
        os.kill(child, number)


if __name__ == "__main__":
    main()
