"""Running the command line in this process."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from tofmix.cli.main import run


@dataclass(frozen=True)
class Outcome:
    """Exit code and streams of one call."""

    code: int
    out: str
    err: str


Tofmix: TypeAlias = Callable[..., Outcome]
"""What the fixture `tofmix` of tests/cli returns."""

Estimated: TypeAlias = Callable[..., Path]
"""What the fixture `estimated` of tests/cli returns."""


@contextmanager
def signals_kept() -> Iterator[None]:
    """Undo what a command does to this process: after the block, signals are handled as before."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def exit_code(*arguments: object) -> int:
    """Run `tofmix ARGUMENTS` to its end; return the exit code that the shell would see."""
    try:
        run([str(argument) for argument in arguments])
    except SystemExit as leave:
        return int(leave.code or 0)
    raise AssertionError("a command ends with an exit code")


def succeed(*arguments: object) -> None:
    """Run `tofmix ARGUMENTS`, which must succeed, where its streams do not matter."""
    with signals_kept():
        assert exit_code(*arguments) == 0
