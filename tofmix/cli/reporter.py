"""What a command says on stderr while it works: doubts, notes, progress, and the compiling of kernels.

Notes are left out with --quiet. Progress is a bar in a terminal, a line a minute elsewhere, and nothing with --quiet.
While kernels are compiled, a terminal shows which part and how far, and elsewhere one line says so.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

import click

from tofmix.cli.options import is_quiet, note
from tofmix.compiled.watching import FIRST_RUN, Unwatched, watched
from tofmix.jobs.reporter import Reporter

if TYPE_CHECKING:
    from tqdm import tqdm

    from tofmix.report.summary.findings import Finding


LINE_EVERY_S = 60.0
"""Time between two lines where stderr is no terminal."""

_USUAL_SIZE = 80, 24  # columns and rows of a terminal that reports none


class Progress:
    """Progress of `total` steps of a command.

    Parameters
    ----------
    total : int
        Steps.
    what : str
        The command, or its part.
    unit : str
        Name of a step.
    """

    def __init__(self, total: int, what: str, unit: str) -> None:
        self.done, self._total, self._what, self._unit = 0, total, what, unit
        self._bar: tqdm[Any] | None = _bar(total, what, unit) if not is_quiet() and is_terminal() else None
        self._next_s = time.monotonic() + LINE_EVERY_S
        self._says_lines = not is_quiet() and self._bar is None

    @property
    def total(self) -> int:
        """Steps; may be changed where more or fewer turn out to be needed."""
        return self._total

    @total.setter
    def total(self, value: int) -> None:
        self._total = value
        if self._bar is not None:
            self._bar.total = value

    def update(self, steps: int = 1) -> None:
        """Count further steps as done."""
        self.done += steps
        if self._bar is not None:
            self._bar.update(steps)
        elif self._says_lines and (now := time.monotonic()) >= self._next_s:
            self._next_s = now + LINE_EVERY_S
            percent = 100 * self.done // max(self._total, 1)
            click.echo(f"tofmix: {self._what}: {self.done:,} of {self._total:,} {self._unit} ({percent} %)", err=True)

    def describe(self, what: str) -> None:
        """Say what the command does now."""
        self._what = what
        if self._bar is not None:
            self._bar.set_description(what)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Let the block print lines: the bar is wiped out before, and drawn again after it."""
        if self._bar is None:
            yield
        else:
            with self._bar.external_write_mode(file=sys.stderr):
                yield

    def close(self) -> None:
        """Wipe the bar out."""
        if self._bar is not None:
            self._bar.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def is_terminal() -> bool:
    """Whether stderr is a terminal."""
    try:
        return sys.stderr.isatty()
    except ValueError:  # it is closed
        return False


def _bar(total: int, what: str, unit: str) -> "tqdm[Any]":
    from tqdm import tqdm  # slow to import

    columns, rows = _size_of_stderr()
    return tqdm(total=total, desc=what, unit=unit, unit_scale=True, leave=False, ncols=columns, nrows=rows)


def _size_of_stderr() -> tuple[int, int] | tuple[None, None]:
    """Columns and rows for a terminal that reports none, as serial lines and some containers do; else tqdm asks it.

    With none of its own, tqdm would show nothing there.
    """
    try:
        unknown = os.get_terminal_size(sys.stderr.fileno()).columns == 0
    except (OSError, ValueError):  # no terminal, or no file at all
        return None, None
    return _USUAL_SIZE if unknown else (None, None)


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
    "image": "curved surfaces",
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


class CommandReporter(Reporter):
    """The callbacks of a command; `bar` is wiped out while a line is printed."""

    def __init__(self, bar: Progress | None = None) -> None:
        self._bar, self._is_aside = bar, False

    def option(self, name: str) -> str:
        """The name as on the command line."""
        return f"--{name.replace('_', '-')}"

    def spell(self, name: str, value: str) -> str:
        """The option as on the command line."""
        return f"{self.option(name)} {value}".rstrip()

    def warn(self, text: str) -> None:
        """Print a line on stderr."""
        with self.aside():
            click.echo(f"tofmix: {text}", err=True)

    def note(self, text: str) -> None:
        """Print a line on stderr, unless --quiet is set."""
        with self.aside():
            note(text)

    def finding(self, about: object, finding: "Finding") -> None:
        """Print it with its remedies; a note only without --quiet."""
        (self.note if finding.is_note else self.warn)(f"{about}: {finding.line}")

    @contextmanager
    def steps(self, total: int, what: str, unit: str) -> Iterator[None]:
        """Show a bar."""
        with Progress(total, what, unit) as self._bar:
            yield
        self._bar = None

    def progress(self, steps: int) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bar.update(steps)

    def before_learning(self) -> None:
        """Let a second process compile what learning needs."""
        from tofmix.pipeline.first_run import compile_learning_beside

        compile_learning_beside()

    @contextmanager
    def learning(self) -> Iterator[Callable[[int, int], None]]:
        """A bar of its own, once there is something to calibrate."""
        bars: list[Progress] = []

        def progress(done: int, of: int) -> None:
            if not bars:
                bars.append(Progress(of, "noise", "step"))
            bars[0].update(done - bars[0].done)

        try:
            yield progress
        finally:
            for bar in bars:
                bar.close()

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Wipe the bar out for a block; blocks may be nested."""
        if self._bar is None or self._is_aside:
            yield
            return
        self._is_aside = True
        try:
            with self._bar.aside():
                yield
        finally:
            self._is_aside = False
