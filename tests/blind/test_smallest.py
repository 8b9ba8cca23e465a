"""The search for the smallest magnitude that is named, on observers whose magnitude is known."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from blind.cases import OPEN_SEED
from blind.smallest import LAPSES, SHARE, Cell, Search

CELL = Cell(kind="range_offset", frames=40, rows=16, cols=20)


def _observed(middle: float, width: float, recordings: int, rng: np.random.Generator) -> Search:
    search = Search()
    for _ in range(recordings):
        octaves = search.next()
        search.add(octaves, named=bool(rng.random() < (1 - LAPSES) * ndtr((octaves - middle) / width)))
    return search


@pytest.mark.parametrize("width", [0.2, 0.5, 0.8])
def test_magnitude_of_95_percent_is_found_within_its_deviation(width: float) -> None:
    """100 searches of 16: off by a third of an octave in the mean at most, and by 2 deviations in no more than 10."""
    off, beyond = [], 0
    for number in range(100):
        rng = np.random.default_rng([number, int(10 * width)])
        middle = rng.uniform(-7.0, -2.0)
        found, deviation = _observed(middle, width, 16, rng).found()
        off.append(found - (middle + width * float(ndtri(SHARE / (1 - LAPSES)))))
        beyond += abs(off[-1]) > 2 * deviation
    assert abs(np.mean(off)) < 1 / 3
    assert np.std(off) < 0.6
    assert beyond <= 10


@pytest.mark.usefixtures("quick_calibration")
def test_steps_of_a_search_differ_in_the_magnitude_alone() -> None:
    strong, weak = CELL.built(0.0, 3, OPEN_SEED), CELL.built(-2.0, 3, OPEN_SEED)
    assert strong.device == weak.device
    assert (strong.device.frames, strong.device.rows, strong.device.cols) == (40, 16, 20)
    assert strong.scenes == weak.scenes
    big, small = (b.mechanisms[0].equivalent(b.place())["offset_mm"] for b in (strong, weak))  # type: ignore[attr-defined]
    assert big == pytest.approx(4 * small)
