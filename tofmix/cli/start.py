"""Start of ``tofmix``: Ctrl-C and closed streams are handled before the imports, which take a while."""

import signal
from typing import NoReturn

from tofmix.standard_streams import open_closed_streams


def run() -> NoReturn:
    """Import the command line and run it; a Ctrl-C meanwhile ends the process without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    open_closed_streams()
    from tofmix.cli.main import run as run_main

    run_main()
