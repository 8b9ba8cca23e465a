"""Start of ``tofmix``: Ctrl-C and closed streams are handled before the imports, which take a while.

Standard streams that are closed, as daemons and some schedulers start their programs.

A file that is opened then gets the number of a standard stream, and what a library prints would be written into it.
"""

import os
import signal
import sys
from typing import NoReturn

_STREAMS = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))


def open_closed_streams() -> None:
    """Open each closed standard stream on the null device; to be called before any file is opened."""
    for number, (name, mode) in enumerate(_STREAMS):
        try:
            os.fstat(number)
        except OSError:
            handle = os.open(os.devnull, os.O_RDWR)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
            os.set_inheritable(number, True)  # noqa: FBT003  programs that are started from here have it too
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", errors="surrogateescape", closefd=False))  # noqa: SIM115  an open file, for the process's life


def run() -> NoReturn:
    """Import the command line and run it; a Ctrl-C meanwhile ends the process without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    open_closed_streams()
    from tofmix.cli.main import run as run_main

    run_main()
