"""pytest plugin: tells coverage which test runs, and keeps to the chosen tests, in their order.

`MUTATION_CHOSEN` names a file with a test's id a line. Processes that a test starts have pytest's own
`PYTEST_CURRENT_TEST` as their context.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import coverage
import pytest


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Name the test."""
    following = coverage.Coverage.current()
    if following is not None:
        following.switch_context(item.nodeid)
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> Iterator[None]:
    """Keep the chosen tests, after all others have had their say."""
    yield
    if "MUTATION_CHOSEN" in os.environ:
        places = {test: place for place, test in enumerate(Path(os.environ["MUTATION_CHOSEN"]).read_text().split("\n"))}
        items[:] = sorted((item for item in items if item.nodeid in places), key=lambda item: places[item.nodeid])
