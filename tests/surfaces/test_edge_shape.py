"""Areas under arcs, against the share of a fine grid of places that lie within the circle."""

import math

import numpy as np
import pytest

from tofmix.arrays import FloatArray
from tofmix.surfaces.edge_run import is_of_run
from tofmix.surfaces.edge_shape import ARC, predict
from tofmix.surfaces.settings import EdgeSettings

_GRID = (np.arange(400) + 0.5) / 400 - 0.5


def _pixel(x: float, y: float) -> FloatArray:
    """A collected pixel at a place, of the same grid as the fit's own."""
    pixel = np.zeros(13)
    pixel[0], pixel[1], pixel[2], pixel[5] = x, y, 1.0, 1.0
    return pixel


@pytest.mark.parametrize(("radius", "most"), [(4.0, 0.0025), (8.0, 0.001), (15.0, 0.0005)])
def test_area_under_an_arc_is_that_of_its_circle(radius: float, most: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(40):
        angle, offset = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform(-0.5, 0.5))
        x, y = math.cos(angle) * (offset + radius), math.sin(angle) * (offset + radius)
        turn = angle + float(rng.uniform(-0.8, 0.8))
        row, col = np.rint(x - radius * math.cos(turn)), np.rint(y - radius * math.sin(turn))
        within = np.hypot(row + _GRID[:, np.newaxis] - x, col + _GRID - y) <= radius
        out = np.zeros(7)
        predict(ARC, angle, offset, 1.0 / radius, _pixel(row, col), out, np.zeros((3, 8, 2)))
        assert out[0] == pytest.approx(within.mean(), abs=most)


def test_other_side_of_a_circle_is_not_of_an_arcs_run() -> None:
    fit = np.zeros(11)
    fit[3] = 1.0 / 4.0  # curvature; the circle's other side is 8 pixels along the normal
    assert is_of_run(ARC, fit, 1.0, 0.0, _pixel(0.0, 0.0), 2.0, 2.0, EdgeSettings())
    assert not is_of_run(ARC, fit, 1.0, 0.0, _pixel(8.0, 0.0), 2.0, 2.0, EdgeSettings())
