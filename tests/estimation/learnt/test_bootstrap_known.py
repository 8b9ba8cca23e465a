"""Thresholds of the same noise: drawn once."""

from dataclasses import replace

import numpy as np
import pytest
from support.learnt_pixels import camera_with, pixel_noise

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.learnt.bootstrap import KnownThresholds, calibrate
from tofmix.estimation.learnt.model import PixelNoise
from tofmix.estimation.learnt.thresholds import GainThresholds

RANGES_MM = np.array([1500.0, 2500.0, 4000.0])
NOISE = pixel_noise("skewed", drift_mm=(10.0, 0.0, 0.0))


class Asked:
    """Tables of few draws, known to one test; and how many were drawn."""

    def __init__(self, most: int = 32) -> None:
        self.drawn = 0
        self._known = KnownThresholds(self._few, most=most)

    def _few(self, *given: object, **named: object) -> GainThresholds:
        self.drawn += 1
        return calibrate(*given, draws=40, **named)  # type: ignore[arg-type]

    def table(
        self, noise: PixelNoise = NOISE, ranges_mm: FloatArray = RANGES_MM, *, workers: int = 1
    ) -> GainThresholds:
        return self._known(noise, beam_of(camera_with(noise)), ranges_mm.copy(), samples=(20, 20), workers=workers)


def test_the_same_noise_is_drawn_once_whatever_the_workers() -> None:
    asked = Asked()
    first, again = asked.table(), asked.table(replace(NOISE), workers=2)
    assert asked.drawn == 1
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("other", ["drift", "ranges"])
def test_other_noise_or_other_ranges_are_drawn_anew(other: str) -> None:
    asked = Asked()
    first = asked.table()
    if other == "drift":
        then = asked.table(replace(NOISE, drift_mm=np.array([30.0, 0.0, 0.0])))
    else:
        then = asked.table(ranges_mm=RANGES_MM + 700.0)
    assert asked.drawn == 2
    assert not np.array_equal(first.more, then.more)


def test_only_the_tables_used_last_are_kept() -> None:
    asked = Asked(most=2)
    for shift_mm in (0.0, 1.0, 0.0, 2.0):
        asked.table(ranges_mm=RANGES_MM + shift_mm)
    assert asked.drawn == 3
    asked.table()
    assert asked.drawn == 3
    asked.table(ranges_mm=RANGES_MM + 1.0)
    assert asked.drawn == 4
