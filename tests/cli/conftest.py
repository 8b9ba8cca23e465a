"""Running the command line in this process, with the exit code that the shell would see."""

import signal
from collections.abc import Iterator

import pytest
from support.commandline import Outcome, Tofmix

from tofmix.cli.main import run


@pytest.fixture
def tofmix(capsys: pytest.CaptureFixture[str]) -> Iterator[Tofmix]:
    """Run `tofmix ARGUMENTS` and return exit code, stdout and stderr."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def call(*arguments: object) -> Outcome:
        capsys.readouterr()
        with pytest.raises(SystemExit) as leave:
            run([str(a) for a in arguments])
        captured = capsys.readouterr()
        return Outcome(int(leave.value.code or 0), captured.out, captured.err)

    yield call
    for number, handler in before.items():
        signal.signal(number, handler)
