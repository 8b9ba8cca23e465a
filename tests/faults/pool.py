"""Warm processes that run `tofmix` commands side by side; what a command did to its folder is judged here."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

TESTS = Path(__file__).parents[1]
HANG_CPU_S = 20
HANG_S = 300.0
"""A command hangs that takes more of the processor, or lasts longer: other work may hold it up, but not for ever."""

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One command in a folder."""

    argv: tuple[str, ...]
    """Arguments of `tofmix`."""
    cwd: str
    """The folder."""
    fresh: bool = True
    """Whether in a process of its own, which all that follows but the time needs."""
    timeout_s: float = HANG_S
    cpu_s: int = HANG_CPU_S
    """`timeout_s`, `cpu_s`: after which it hangs, and is killed."""
    file_bytes: int | None = None
    """As `ulimit -f` would say."""
    fault: tuple[str, int, int, int] | None = None
    """(operation, number, errno, once), optional. Which call fails, with the shim of `faults.shim`; `once` 0: and all
    calls of that kind after it."""
    kill_after_s: float | None = None
    """When it gets `kill_signal`."""
    kill_signal: int = 9
    full: tuple[str, ...] = ()
    """Which of its streams, "out" and "err", lead to a full device."""
    unprivileged: bool = False
    """Whether permissions hold for it even where the administrator runs us."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a command did.

    Its exit code (negative: the signal it died of), streams, time, memory beyond the warm process, and how many calls
    there were of the kind that was to fail.
    """

    code: int
    hung: bool
    out: str
    err: str
    seconds: float
    cpu_s: float
    extra_bytes: int
    calls: int


class _Server:
    """One warm process."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._environment = environment
        self._process: subprocess.Popen[str] | None = None

    def run(self, job: Job) -> Outcome:
        if self._process is None:
            path = os.pathsep.join([str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")])
            environment = os.environ | {"PYTHONPATH": path, "NUMBA_NUM_THREADS": "1"} | self._environment
            command = [sys.executable, "-m", "faults.server"]
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
            )
        stdin, stdout = self._process.stdin, self._process.stdout
        if stdin is None or stdout is None:
            raise AssertionError("pipes were asked for")
        stdin.write(json.dumps(asdict(job)) + "\n")
        stdin.flush()
        answer = stdout.readline()
        if not answer:
            raise RuntimeError(f"the server died of {self._process.wait()}")
        return Outcome(**json.loads(answer))

    def close(self) -> None:
        if self._process is not None:
            self._process.communicate()


class Pool:
    """Some servers; use it as a context manager.

    `processes`: how many.
    `environment`: variables beside those of this process.
    """

    def __init__(self, processes: int = 2, environment: dict[str, str] | None = None) -> None:
        self._servers = [_Server(environment or {}) for _ in range(processes)]
        self._idle = list(self._servers)
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(processes)

    def run(self, job: Job) -> Outcome:
        """Run one command."""
        with self._lock:
            server = self._idle.pop()
        try:
            return server.run(job)
        finally:
            with self._lock:
                self._idle.append(server)

    def map(self, work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Call `work` for each item in the pool's threads, one for each process; in the items' order."""
        yield from self._threads.map(work, items)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._threads.shutdown(cancel_futures=True)
        for server in self._servers:
            server.close()
