"""The table of gains: monotone, read off both ways, and what it was drawn for."""

import math

import numpy as np
import pytest

from tofmix.estimation.mixture.false_alarms import (
    FALSE_ALARMS,
    SAMPLES,
    chance_of,
    gain_table,
    least_gain,
)
from tofmix.estimation.settings import EstimateOptions


def test_rarer_alarms_and_more_samples_need_more_gain() -> None:
    table = gain_table(2000)
    assert np.all(np.diff(table, axis=1) > 0)
    # Between 500 and 1000 samples the draws' own error is as large as the rise.
    assert np.all(np.diff(table[list(SAMPLES)], axis=0) > -0.3)
    np.testing.assert_array_equal(table[2000], table[1000])
    np.testing.assert_array_equal(table[0], table[5])


@pytest.mark.parametrize("n", [7, 15, 100, 777])
@pytest.mark.parametrize("chance", [0.1, 0.03, 0.001, 1e-5])
def test_chance_is_the_inverse_of_gain(n: int, chance: float) -> None:
    row = gain_table(1000)[n]
    assert chance_of(least_gain(chance, row), row) == pytest.approx(chance)


def test_gain_table_is_exact_at_its_columns() -> None:
    row = gain_table(100)[100]
    for chance, gain in zip(FALSE_ALARMS, row, strict=True):
        assert least_gain(chance, row) == pytest.approx(gain)


def test_chance_falls_from_one() -> None:
    row = gain_table(50)[50]
    chances = [chance_of(gain, row) for gain in np.linspace(0, 30, 200)]
    assert chances[0] == 1
    assert np.all(np.diff(chances) <= 1e-12)
    assert chance_of(math.inf, row) == 0


@pytest.mark.parametrize("false_alarm", [0.0, 0.2, -1.0, math.nan])
def test_false_alarm_rates_out_of_bounds_are_refused(false_alarm: float) -> None:
    with pytest.raises(ValueError, match="false_alarm"):
        EstimateOptions(false_alarm=false_alarm)
