"""Running the command line in this process, with the exit code that the shell would see."""

from collections.abc import Iterator

import pytest
from support.commandline import Outcome, Tofmix, exit_code, signals_kept


@pytest.fixture
def tofmix(capsys: pytest.CaptureFixture[str]) -> Iterator[Tofmix]:
    """Run `tofmix ARGUMENTS` and return exit code, stdout and stderr."""

    def call(*arguments: object) -> Outcome:
        capsys.readouterr()
        code = exit_code(*arguments)
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    with signals_kept():
        yield call
