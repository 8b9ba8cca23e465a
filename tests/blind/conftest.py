"""Fixtures of the bench's own tests."""

import sys
from pathlib import Path

import pytest

from blind import calibrate

TESTS = Path(__file__).parents[1]


@pytest.fixture
def quick_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """A noise table from fewer flat fields: good to about 0.3 %, where the table itself is not what is tested."""
    monkeypatch.setattr(calibrate, "SAMPLES", 4_000)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """The command of a stand-in for `tofmix reconcile`; what it adds comes next."""
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
    return (sys.executable, "-m", "blind.fake_reconcile")
