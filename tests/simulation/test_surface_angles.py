"""Angles of a rectangle from its axes: the inverse of `Surface.rotation`."""

from itertools import product

import numpy as np
import pytest

from tofmix.simulation.surface import Surface, angles_of, surface_along


def _surface(yaw: float, pitch: float, roll: float) -> Surface:
    return Surface(name="a", center_mm=(1.0, 2.0, 3.0), size_mm=(5.0, 7.0), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)


def test_angles_give_back_any_rotation(rng: np.random.Generator) -> None:
    for yaw, pitch, roll in rng.uniform(-180.0, 180.0, (50, 3)):
        rotation = _surface(yaw, pitch, roll).rotation()
        assert _surface(*angles_of(rotation)).rotation() == pytest.approx(rotation, abs=1e-12)


@pytest.mark.parametrize(("yaw", "pitch"), list(product([0.0, 90.0, -35.0], [90.0, -90.0])))
def test_angles_where_yaw_and_roll_are_one_have_no_roll(yaw: float, pitch: float) -> None:
    rotation = _surface(yaw, pitch, 20.0).rotation()
    found = angles_of(rotation)
    assert found[2] == 0.0
    assert _surface(*found).rotation() == pytest.approx(rotation, abs=1e-9)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, -90.0, 0.0), (20.0, -8.0, 3.0)])
def test_a_quarter_turn_of_the_axes_gives_the_same_surface(angles: tuple[float, float, float]) -> None:
    wanted = _surface(*angles)
    u, v, normal = wanted.rotation().T
    quarters = [(u, v, (5.0, 7.0)), (v, -u, (7.0, 5.0)), (-u, -v, (5.0, 7.0)), (-v, u, (7.0, 5.0))]
    for first, second, size in quarters:
        axes = np.stack([first, second, normal], axis=1)
        found = surface_along("a", center_mm=np.array([1.0, 2.0, 3.0]), size_mm=np.array(size), axes=axes)
        assert found.size_mm == wanted.size_mm
        assert found.rotation() == pytest.approx(wanted.rotation(), abs=1e-12)
