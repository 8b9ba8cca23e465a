"""What a job says, on stderr: doubts, notes unless --quiet, and progress."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import note
from tofmix.cli.progress import Progress
from tofmix.jobs.reporter import Reporter

if TYPE_CHECKING:
    from tofmix.report.summary.findings import Finding


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
