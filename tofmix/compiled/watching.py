"""Those who are told when a kernel is compiled: the command line, for people who wait.

Without a watcher, the first kernel of a process that is compiled is a line of the log `tofmix`, which Python prints on
stderr: `import tofmix` in a notebook is to say why a first estimate takes long.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

FIRST_RUN = "compiling the kernels; a first run takes up to a minute, later ones load them"
"""The line of the log."""


class Watcher(Protocol):
    """Receives the events of compiling; every kernel has a name such as ``estimation.layering._layer_block``."""

    def expects(self, kernels: int) -> None:
        """So many kernels are still to be compiled."""

    def begins(self, kernel: str) -> None:
        """Compiling of a kernel begins, or waiting for another process that compiles it."""

    def ends(self, kernel: str) -> None:
        """The kernel is there."""

    def cannot_keep(self, reason: str) -> None:
        """No folder can keep compiled code; told once."""


class Unwatched:
    """The watcher of those who want no word."""

    def expects(self, kernels: int) -> None:
        """Say nothing."""

    def begins(self, kernel: str) -> None:
        """Say nothing."""

    def ends(self, kernel: str) -> None:
        """Say nothing."""

    def cannot_keep(self, reason: str) -> None:
        """Say nothing."""


class _Log(Unwatched):
    """The watcher where there is no other: one line of each kind in a process."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def begins(self, kernel: str) -> None:  # noqa: ARG002  as the protocol has it
        self._say(FIRST_RUN)

    def cannot_keep(self, reason: str) -> None:
        self._say(reason)

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            logging.getLogger("tofmix").warning("tofmix: %s", text)


_watchers: list[Watcher] = [_Log()]


def watcher() -> Watcher:
    """The one who is told: the last that watches."""
    return _watchers[-1]


@contextmanager
def watched(by: Watcher) -> Iterator[None]:
    """Tell `by` of all compiling within the block."""
    _watchers.append(by)
    try:
        yield
    finally:
        _watchers.remove(by)
