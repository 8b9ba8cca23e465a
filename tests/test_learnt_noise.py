"""What a sensor carries of the learnt noise: its bounds, its equality, and what becomes of it in kernels."""

from typing import Any

import numpy as np
import pytest

from tofmix.estimation.mixture.false_alarms import FALSE_ALARMS
from tofmix.learnt_noise import LearntNoise

CHANCES = len(FALSE_ALARMS)


def _values(**other: Any) -> dict[str, Any]:  # noqa: ANN401  fields of LearntNoise
    return {
        "background": (1.0, 9.0),
        "drift_mm": np.array([3.0, 0.0, 1.0]),
        "memory": 0.2,
        "gain_samples": np.array([10.0, 100.0]),
        "gain_background": np.array([0.0, 0.1, 0.6]),
        "gain_more": np.arange(6.0 * CHANCES).reshape(2, 3, CHANCES),
        "gain_first": np.arange(2.0 * CHANCES).reshape(2, CHANCES),
    } | other


@pytest.mark.parametrize(
    ("other", "text"),
    [
        ({"drift_mm": np.zeros(2)}, "drift_mm: 2 numbers, not 3"),
        ({"drift_mm": np.array([1.0, -1.0, 0.0])}, "drift_mm: expected 1 dimensions of finite numbers, none negative"),
        ({"drift_mm": np.zeros((1, 3))}, "drift_mm: expected 1 dimensions"),
        ({"gain_more": np.full((2, 3, CHANCES), np.nan)}, "gain_more: expected 3 dimensions of finite numbers"),
        ({"gain_more": np.zeros((2, 2, CHANCES))}, "tables of gains differ in size"),
        ({"gain_first": np.zeros((2, CHANCES - 1))}, "tables of gains differ in size"),
        ({"gain_samples": np.array([10.0])}, "tables of gains differ in size"),
        ({"gain_samples": np.zeros(0)}, "gain_samples"),
        ({"memory": 1.0}, r"memory 1 is not in \[0, 1\)"),
        ({"memory": -0.1}, "memory -0.1"),
        ({"memory": np.nan}, "memory nan"),
        ({"background": (0.0, 1.0)}, "background: two finite numbers above 0"),
        ({"background": (1.0, np.inf)}, "background: two finite numbers above 0"),
    ],
)
def test_learnt_noise_out_of_bounds_is_refused_by_name(other: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        LearntNoise(**_values(**other))


def test_equal_numbers_are_the_same_noise() -> None:
    one = LearntNoise(**_values())
    assert one.same_as(LearntNoise(**_values()))
    assert not one.same_as(None)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("background", None),
        ("background", (1.0, 9.5)),
        ("memory", 0.3),
        ("drift_mm", [3.0, 0.0, 1.5]),
        ("gain_samples", [10.0, 101.0]),
        ("gain_background", [0.0, 0.1, 0.7]),
        ("gain_more", np.arange(6.0 * CHANCES).reshape(2, 3, CHANCES) + 1e-9),
        ("gain_first", np.ones((2, CHANCES))),
    ],
)
def test_any_other_number_is_another_noise(name: str, value: object) -> None:
    one, other = LearntNoise(**_values()), LearntNoise(**_values(**{name: value}))
    assert not one.same_as(other)
    assert not other.same_as(one)


def test_arrays_are_copies_that_cannot_be_written() -> None:
    values = _values()
    learnt = LearntNoise(**values)
    values["drift_mm"][0] = 99.0
    assert learnt.drift_mm[0] == 3.0
    with pytest.raises(ValueError, match="read-only"):
        learnt.gain_more[0, 0, 0] = 1.0
