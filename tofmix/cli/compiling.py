"""What people see while kernels are compiled: in a terminal which part and how far, elsewhere one line."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

from tofmix.cli.options import is_quiet
from tofmix.cli.progress import is_terminal
from tofmix.compiled.watching import FIRST_RUN, Unwatched, watched

SHOWN_AFTER_S = 1.0
"""Time in seconds after which a terminal shows what is compiled: what takes less is no wait."""

SAID_AFTER_S = 4.0
"""Time in seconds after which a script is told, with one line."""

_PARTS = {
    "estimation.layering": "layers",
    "estimation.peaks": "peaks",
    "estimation.paper": "the paper's procedure",
    "estimation.learnt": "learnt noise",
    "estimation": "noise",
    "unmixing": "unmixing",
    "surfaces": "edges",
    "suspicion": "suspicions",
    "mapping": "maps",
    "simulation": "scenes",
    "reconciliation": "likelihoods",
}
"""Parts of the program by the start of a kernel's name, longest first."""


@contextmanager
def announced() -> Iterator[None]:
    """Tell the user of all kernels that are compiled within the block; of a command with --quiet, nothing."""
    said = Announcement(is_terminal=is_terminal(), is_quiet=is_quiet)
    with watched(said):
        try:
            yield
        finally:
            said.close()


class Announcement(Unwatched):
    """Tells of compiling on stderr.

    Parameters
    ----------
    is_terminal : bool
        Whether a line there may be written again and again.
    is_quiet : callable
        Returns whether nothing is to be told but that no code is kept.
    """

    def __init__(self, *, is_terminal: bool, is_quiet: Callable[[], bool]) -> None:
        self._is_terminal, self._is_quiet = is_terminal, is_quiet
        self._number, self._expected, self._part = 0, 0, ""
        self._start_s = 0.0
        self._width = 0  # of the line on the terminal
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._is_compiling = False

    def expects(self, kernels: int) -> None:
        """Count the kernels that are still to be compiled."""
        self._expected = self._number + kernels

    def begins(self, kernel: str) -> None:
        """Show the part that the kernel is of; after a while, if it is the first one."""
        with self._lock:
            self._number += 1
            self._part = next((part for start, part in _PARTS.items() if kernel.startswith(start)), kernel)
            self._is_compiling = True
        if self._thread is None and not self._is_quiet():
            self._start_s = time.monotonic()
            self._thread = threading.Thread(target=self._show, daemon=True)
            self._thread.start()

    def ends(self, kernel: str) -> None:  # noqa: ARG002  as the protocol has it
        """Wipe the line out: what follows may print."""
        with self._lock:
            self._is_compiling = False
            self._wipe()

    def cannot_keep(self, reason: str) -> None:
        """Warn that each run compiles again."""
        with self._lock:
            self._wipe()
        click.echo(f"tofmix: {reason}", err=True)

    def close(self) -> None:
        """Wipe the line out, and tell no more."""
        self._stop.set()
        with self._lock:
            self._wipe()

    def _show(self) -> None:
        if not self._is_terminal:
            while not self._stop.wait(SAID_AFTER_S):
                with self._lock:
                    is_compiling = self._is_compiling
                if is_compiling:
                    click.echo(f"tofmix: {FIRST_RUN}", err=True)
                    return
            return
        self._stop.wait(SHOWN_AFTER_S)
        while not self._stop.wait(0.2):
            with self._lock:
                if self._is_compiling and not self._stop.is_set():
                    self._draw()

    def _draw(self) -> None:
        of = f" of {self._expected}" if self._expected >= self._number else ""
        text = (
            f"tofmix: compiling for a first run: {self._part} ({self._number}{of}),"
            f" {time.monotonic() - self._start_s:.0f} s"
        )
        sys.stderr.write("\r" + text.ljust(self._width))
        sys.stderr.flush()
        self._width = len(text)

    def _wipe(self) -> None:
        if self._width:
            sys.stderr.write("\r" + " " * self._width + "\r")
            sys.stderr.flush()
            self._width = 0
