"""Fixtures of the bench's own tests."""

import pytest

from blind import calibrate


@pytest.fixture
def quick_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """A noise table from fewer flat fields: good to about 0.3 %, where the table itself is not what is tested."""
    monkeypatch.setattr(calibrate, "SAMPLES", 4_000)
