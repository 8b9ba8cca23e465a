"""The process that looks at HDF5 files first, forked instead of started: a fork that is warm already saves its start.

It runs `tofmix.io.guard.structure_process`, behind pipes, in a session of its own, and may die of
what it reads. That it starts as a program is tested wherever tests call the command line in a new process.
"""

import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from tofmix.io.guard import guard, structure_process


class ForkedChecker(subprocess.Popen[str]):
    """What `guard` takes for the process that it has started."""

    def __init__(self, program: Sequence[str], **_: Any) -> None:  # noqa: ANN401  as subprocess.Popen has it
        requests, send = os.pipe()
        receive, answers = os.pipe()
        child = os.fork()
        if child == 0:
            self._serve(requests, answers)
        os.close(requests)
        os.close(answers)
        # What subprocess.Popen keeps of a child, so that its wait, poll and kill work.
        self.args, self.pid, self.returncode = program, child, None
        self.stdin, self.stdout, self.stderr = os.fdopen(send, "w"), os.fdopen(receive), None
        self._child_created, self._waitpid_lock = True, threading.Lock()

    @staticmethod
    def _serve(requests: int, answers: int) -> None:
        os.setsid()
        for name in os.listdir("/proc/self/fd"):  # noqa: PTH208  as a program that is started would have none of them
            if int(name) > 2 and int(name) not in (requests, answers):
                with suppress(OSError):
                    os.close(int(name))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        library = ctypes.CDLL(None)
        if hasattr(library, "fault_disarm"):
            library.fault_disarm()
        sys.stdin, sys.stdout = os.fdopen(requests), os.fdopen(answers, "w")
        code = 1
        try:
            structure_process.main()
            code = 0
        finally:
            os._exit(code)


def use() -> None:
    """Let `guard` of this process and its forks fork its structure checkers."""
    names = ("PIPE", "DEVNULL", "TimeoutExpired")
    replaced = SimpleNamespace(Popen=ForkedChecker, **{name: getattr(subprocess, name) for name in names})
    guard.subprocess = replaced  # type: ignore[assignment,attr-defined]
