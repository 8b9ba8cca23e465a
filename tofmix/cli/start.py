"""Start of ``tofmix``: Ctrl-C is handled before the imports, which take a while."""

import signal
from typing import NoReturn


def run() -> NoReturn:
    """Import the command line and run it; a Ctrl-C meanwhile ends the process without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from tofmix.cli.main import run as run_main

    run_main()
