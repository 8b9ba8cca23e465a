"""One line on stderr when compiling takes long."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import click

from tofmix.cli.options import is_quiet

_COMPILING_AFTER_S = 4.0  # of work without a result, after which compiling is said to be the cause

_compiling_said = threading.Event()


def _say_compiling() -> None:
    if not _compiling_said.is_set():
        _compiling_said.set()
        click.echo("tofmix: compiling the kernels; a first run takes half a minute or more", err=True)


@contextmanager
def announced() -> Iterator[None]:
    """Print one line on stderr if compiling takes long; once in a run."""
    timer = threading.Timer(_COMPILING_AFTER_S, _say_compiling)
    if not is_quiet():  # asked here, for the timer's thread knows no command
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
