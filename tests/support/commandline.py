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

    def refused(self, code: int, said: str) -> None:
        """Hold that the command ended with this exit code, and with nothing but a line on stderr that says this."""
        assert (self.code, self.out) == (code, ""), self.err
        assert said in self.err
        assert self.err.count("\n") == 1, self.err


@dataclass(frozen=True)
class Tofmix:
    """What the fixture `tofmix` of tests/cli returns: it runs `tofmix ARGUMENTS` in this process."""

    printed: Callable[[], tuple[str, str]]
    """What stdout and stderr got since the last call."""

    def __call__(self, *arguments: object) -> Outcome:
        """Run to the end, whatever the exit code."""
        self.printed()
        return Outcome(exit_code(*arguments), *self.printed())

    def done(self, *arguments: object) -> Outcome:
        """Run what must succeed."""
        outcome = self(*arguments)
        assert outcome.code == 0, (arguments, outcome.err)
        return outcome

    def same_in_pieces(self, recording: Path, *options: object) -> Path:
        """Layers whose bytes are the same of one worker, of three with little memory, of two parts, and resumed."""
        whole = recording.with_name("whole.h5")
        self.done("estimate", recording, *options, "-o", whole, "--workers", 1)
        self.done(
            "estimate", recording, *options, "-o", whole.with_name("three.h5"), "--workers", 3, "--memory", "250MB"
        )
        parts = [whole.with_name(f"{number}.part") for number in (1, 2)]
        for number, part in enumerate(parts, 1):
            self.done("estimate", recording, *options, "-o", part, "--shard", f"{number}/2")
        self.done("merge", *parts, "-o", whole.with_name("merged.h5"))
        for name in ("three.h5", "merged.h5"):
            assert whole.with_name(name).read_bytes() == whole.read_bytes(), name
        before = whole.stat().st_mtime_ns
        again = self.done("estimate", recording, *options, "-o", whole, "--resume")
        assert "blocks from the interrupted run" in again.err
        assert whole.stat().st_mtime_ns == before
        return whole


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
