"""Progress of a command on stderr: a bar in a terminal, a line a minute elsewhere, nothing with --quiet."""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

import click

from tofmix.cli.options import is_quiet

if TYPE_CHECKING:
    from tqdm import tqdm

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
