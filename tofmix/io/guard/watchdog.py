"""A watchdog over reads: if a read returns nothing for minutes, it ends the program and names the file.

A read from a network disk that has gone never returns, and no exception can reach a thread inside the operating system
or the HDF5 library. So a separate thread watches the time, names the file, removes partial files and ends the process.
Only the command line arms it: a library must not end its caller's process.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

from tofmix.errors import ExitCode
from tofmix.io.locks import discard_partial_outputs, is_resumable

STRUCTURE_LIMIT_S = 20.0
"""For a look at a file's structure."""

VARIABLE = "TOFMIX_READ_TIMEOUT"
"""Variable of the environment with the time limit of a read, s."""

POLL_S = 0.5  # s between two looks at the clock


def limit_s(default: float) -> float:
    """Time limit of a read, s: the default, or the environment variable TOFMIX_READ_TIMEOUT."""
    chosen = _seconds(os.environ.get(VARIABLE, ""))
    return default if chosen is None else chosen


def is_limit(text: str) -> bool:
    """Whether a text, the value of TOFMIX_READ_TIMEOUT, is a time limit; nothing is the default."""
    return not text.strip() or _seconds(text) is not None


def _seconds(text: str) -> float | None:
    try:
        chosen = float(text)
    except ValueError:
        return None
    return chosen if 0.0 < chosen < float("inf") else None


class Watchdog:
    """Knows which reads are going on, and since when.

    Parameters
    ----------
    give_up : callable
        Called once, in the watching thread, with the name of the read and its seconds.
    """

    def __init__(self, give_up: Callable[[str, float], object]) -> None:
        self._give_up = give_up
        self._since: dict[object, tuple[float, str, float]] = {}
        threading.Thread(target=self._watch, name="tofmix-watchdog", daemon=True).start()

    @contextmanager
    def over(self, what: str, times: float = 1.0) -> Iterator[None]:
        """Watch a block that reads; it may take some times as long as a single read."""
        key = object()
        self._since[key] = time.monotonic(), what, times
        try:
            yield
        finally:
            self._since.pop(key, None)

    def _watch(self) -> None:
        read_limit_s = 120.0  # for one read, which is of one stored chunk or of some MB
        while True:
            time.sleep(POLL_S)
            for since, what, times in list(self._since.values()):
                limit = times * limit_s(read_limit_s)
                if time.monotonic() - since > limit:
                    self._give_up(what, limit)
                    return


_watchdog: list[Watchdog] = []


def arm() -> None:
    """End this process from now on when a read hangs; for programs, not for libraries."""
    if not _watchdog:
        _watchdog.append(Watchdog(_end))


@contextmanager
def watched(what: str, times: float = 1.0) -> Iterator[None]:
    """Watch a block that reads, `what`, if the watchdog is armed; it may take some times as long as a single read."""
    with _watchdog[0].over(what, times) if _watchdog else nullcontext():
        yield


def _end(what: str, seconds: float) -> None:
    discard_partial_outputs()
    rest = "; finished blocks are kept, --resume continues" if is_resumable() else ""
    text = f"tofmix: {what}: reading returned no data for {seconds:g} s; given up{rest}\n"
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, text.encode(errors="replace"))
    os._exit(ExitCode.STORAGE)
