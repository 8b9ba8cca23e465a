"""pytest plugin: runs the chosen tests in the chosen order, and notes each outcome at once.

`run` loads it (`-p mutation.chosen`). `MUTATION_CHOSEN` names a file of JSON lines, a test's id and its limit in
seconds each; `MUTATION_OUTCOMES` the file to which "start", "passed" and "failed" are written. A test over its limit
ends the process: whatever hangs, compiled code included, is found so.
"""

import faulthandler
import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

LIMITS_S: dict[str, float] = dict(map(json.loads, Path(os.environ["MUTATION_CHOSEN"]).read_text().splitlines()))
OUTCOMES = Path(os.environ["MUTATION_OUTCOMES"])

with suppress(OSError):  # should a mutant take all memory, it is the one to go
    Path("/proc/self/oom_score_adj").write_text("1000")


def _note(word: str, test: str) -> None:
    with OUTCOMES.open("a") as file:
        file.write(json.dumps([word, test]) + "\n")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Keep the chosen tests, in their order, after all others have had their say."""
    yield
    places = {test: place for place, test in enumerate(LIMITS_S)}
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in places])
    items[:] = sorted((item for item in items if item.nodeid in places), key=lambda item: places[item.nodeid])


def pytest_runtest_logstart(nodeid: str) -> None:
    """Set the limit."""
    _note("start", nodeid)
    faulthandler.dump_traceback_later(LIMITS_S[nodeid], exit=True)


def pytest_runtest_logfinish(nodeid: str) -> None:
    """Lift the limit."""
    faulthandler.cancel_dump_traceback_later()
    _note("end", nodeid)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note a failure of any phase."""
    if report.failed:
        _note("failed", report.nodeid)
