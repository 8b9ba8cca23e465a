"""Fixtures of the bench's own tests, which wait for the long run: the bench is another camera than the package's."""

import sys
from pathlib import Path

import pytest

from blind import calibrate

TESTS = Path(__file__).parents[1]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark this folder's tests as slow."""
    here = Path(__file__).parent
    for item in items:
        if item.path.is_relative_to(here):
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def quick_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """A noise table from fewer flat fields: good to about 0.3 %, where the table itself is not what is tested."""
    monkeypatch.setattr(calibrate, "SAMPLES", 4_000)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """The command of a stand-in for `tofmix reconcile`; what it adds comes next."""
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
    return (sys.executable, "-m", "blind.fake_reconcile")
