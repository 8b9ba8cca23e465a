"""Areas that lines cut off a pixel, against counts of places in it."""

from typing import TYPE_CHECKING

import numpy as np
import pytest

from tofmix.surfaces.edge_shape import chord, chord_outside, covered, covered_by_both, covered_by_three

if TYPE_CHECKING:
    from tofmix.arrays import FloatArray

_PLACES = (np.arange(400) + 0.5) / 400 - 0.5
_U, _V = np.meshgrid(_PLACES, _PLACES, indexing="ij")
_LINES = [
    (float(np.cos(angle)) * scale, float(np.sin(angle)) * scale, at)
    for angle in (0.0, 0.3, np.pi / 4, 1.4, np.pi / 2, 2.5, 4.0, 5.9)
    for at in (-0.8, -0.45, -0.1, 0.0, 0.3, 0.6)
    for scale in (0.7, 1.0)
]


def _counted(line: tuple[float, float, float]) -> np.ndarray:
    return line[0] * _U + line[1] * _V + line[2] >= 0


@pytest.mark.parametrize("line", _LINES[:: len(_LINES) // 12])
def test_covered_area_equals_the_share_of_places_on_the_positive_side(line: tuple[float, float, float]) -> None:
    assert covered(*line) == pytest.approx(_counted(line).mean(), abs=2e-3)


def test_change_of_the_area_is_the_chord_over_the_slope() -> None:
    out = np.empty(3)
    for a, b, c in _LINES:
        chord(a, b, c, out)
        step = 1e-6
        assert out[0] == pytest.approx((covered(a, b, c + step) - covered(a, b, c - step)) / (2 * step), abs=1e-4)
        if out[0] > 0:  # the middle of the chord lies on the line, within the pixel
            assert a * out[1] + b * out[2] + c == pytest.approx(0.0, abs=1e-12)
            assert max(abs(out[1]), abs(out[2])) <= 0.5 + 1e-12


def test_area_of_both_sides_equals_the_share_of_places_on_both() -> None:
    work = np.empty((3, 8, 2))
    for one, other in zip(_LINES, _LINES[7:] + _LINES[:7], strict=True):
        expected = (_counted(one) & _counted(other)).mean()
        assert covered_by_both(*one, *other, work) == pytest.approx(expected, abs=4e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_area_on_one_side_of_three_lines_equals_the_share_of_places_there(side: float) -> None:
    work = np.empty((3, 8, 2))
    some = 0
    for lines in zip(_LINES, _LINES[7:] + _LINES[:7], _LINES[22:] + _LINES[:22], strict=True):
        expected = np.all([side * (a * _U + b * _V + c) >= 0 for a, b, c in lines], axis=0).mean()
        some += 0 < expected < 1
        area = covered_by_three(side, np.array(lines[0]), np.array(lines[1]), np.array(lines[2]), work)
        assert area == pytest.approx(expected, abs=4e-3)
    assert some > 10


def test_part_of_a_chord_outside_another_line_is_the_change_of_the_area_of_either() -> None:
    work, out = np.empty((3, 8, 2)), np.empty(3)
    step = 1e-6

    def either(c: float, a: float, b: float, other: tuple[float, float, float]) -> float:
        return covered(a, b, c) + covered(*other) - covered_by_both(a, b, c, *other, work)

    checked: list[FloatArray] = []
    for (a, b, c), other in zip(_LINES, _LINES[5:] + _LINES[:5], strict=True):
        chord_outside(a, b, c, *other, out)
        slope = (either(c + step, a, b, other) - either(c - step, a, b, other)) / (2 * step)
        assert out[0] == pytest.approx(slope, abs=1e-4)
        checked.append(out.copy())
    assert np.any(np.array(checked)[:, 0] > 0.1)
