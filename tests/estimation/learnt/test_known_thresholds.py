"""Thresholds of the same noise: drawn once in a process."""

from dataclasses import replace

import numpy as np
import pytest
from learnt_pixels import camera_with, pixel_noise

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.learnt import known_thresholds
from tofmix.estimation.learnt.counting import Thresholds
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.thresholds import calibrate

RANGES_MM = np.array([1500.0, 2500.0, 4000.0])
NOISE = pixel_noise("skewed", drift_mm=(10.0, 0.0, 0.0))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[PixelNoise]:
    """The noise of each table that is drawn; few draws each, in a process that knows none."""
    calls: list[PixelNoise] = []

    def few(noise: PixelNoise, *given: object, **named: object) -> Thresholds:
        calls.append(noise)
        return calibrate(noise, *given, draws=40, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(known_thresholds, "calibrate", few)
    monkeypatch.setattr(known_thresholds, "_known", type(known_thresholds._known)())
    return calls


def _thresholds(noise: PixelNoise = NOISE, ranges_mm: FloatArray = RANGES_MM, *, workers: int = 1) -> Thresholds:
    beam = beam_of(camera_with(noise))
    return known_thresholds.known_thresholds(noise, beam, ranges_mm.copy(), samples=(20, 20), workers=workers)


def test_the_same_noise_is_drawn_once_whatever_the_workers(drawn: list[PixelNoise]) -> None:
    first, again = _thresholds(), _thresholds(replace(NOISE), workers=2)
    assert len(drawn) == 1
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("other", ["drift", "ranges"])
def test_other_noise_or_other_ranges_are_drawn_anew(drawn: list[PixelNoise], other: str) -> None:
    first = _thresholds()
    if other == "drift":
        then = _thresholds(replace(NOISE, drift_mm=np.array([30.0, 0.0, 0.0])))
    else:
        then = _thresholds(ranges_mm=RANGES_MM + 700.0)
    assert len(drawn) == 2
    assert not np.array_equal(first.more, then.more)


def test_only_the_tables_used_last_are_kept(drawn: list[PixelNoise], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known_thresholds, "KEPT", 2)
    for shift_mm in (0.0, 1.0, 0.0, 2.0):
        _thresholds(ranges_mm=RANGES_MM + shift_mm)
    assert len(drawn) == 3
    _thresholds()
    assert len(drawn) == 3
    _thresholds(ranges_mm=RANGES_MM + 1.0)
    assert len(drawn) == 4
