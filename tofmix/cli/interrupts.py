"""A first Ctrl-C that asks a command to end in its own time; the second ends it at once."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_SAID = b"\ntofmix: interrupted: the best so far is written; Ctrl-C again ends at once, and writes nothing\n"


@contextmanager
def asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Let the block look whether Ctrl-C was pressed; the second Ctrl-C has the meaning that it had before the block.

    No exception is raised: within a kernel that is compiled it would be lost.

    Yields
    ------
    callable
        Whether Ctrl-C was pressed.
    """
    before = signal.getsignal(signal.SIGINT)
    pressed = False

    def once(number: int, frame: FrameType | None) -> None:  # noqa: ARG001  as signals call it
        nonlocal pressed
        pressed = True
        signal.signal(number, before)
        os.write(sys.stderr.fileno(), _SAID)

    signal.signal(signal.SIGINT, once)
    try:
        yield lambda: pressed
    finally:
        signal.signal(signal.SIGINT, before)
