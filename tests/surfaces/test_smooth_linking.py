"""What bends and is smooth is one surface; creases and steps part surfaces; planes stay planes."""

from functools import cache

import numpy as np
import pytest
from support.round_things import CAMERA, Thing, cast, counted, cylinder, joined, rays_of, sphere, wall

from tofmix.surfaces.found import WindowSurfaces
from tofmix.surfaces.reconstruct import reconstruct

pytestmark = pytest.mark.compiled("it fits thousands of patches")

PARTS = 8
WALL = wall(2800)
BALL = sphere((40, -30, 1500), 180)


def found_in(things: list[Thing], *, stderr_mm: float = 2.0) -> WindowSurfaces:
    """Surfaces of the layers of some things."""
    return reconstruct(counted(things, stderr_mm=stderr_mm), CAMERA, factor=PARTS)


@cache
def before_wall(thing: Thing, stderr_mm: float) -> WindowSurfaces:
    """Surfaces of a thing and the wall behind it; several tests read them, and none changes them."""
    return found_in([WALL, thing], stderr_mm=stderr_mm)


def is_smooth(found: WindowSurfaces) -> list[bool]:
    """Whether each surface is smooth and no plane."""
    return [bool(smooth) for smooth in found.planes.is_smooth]


def true_parts(things: list[Thing]) -> tuple[np.ndarray, np.ndarray]:
    """Thing of each part of a pixel, and its range."""
    ranges = np.stack([thing(rays_of(PARTS)).range_mm for thing in things])
    return ranges.argmin(axis=0), ranges.min(axis=0)


@pytest.mark.parametrize("stderr_mm", [pytest.param(0.5, marks=pytest.mark.slow), 2.0, 8.0])
@pytest.mark.parametrize("thing", [BALL, cylinder(100, 2000, 250)], ids=["sphere", "cylinder"])
def test_round_thing_before_a_wall_is_one_smooth_surface(thing: Thing, stderr_mm: float) -> None:
    things = [WALL, thing]
    found = before_wall(thing, stderr_mm)
    assert is_smooth(found)[:2] == [False, True]
    assert np.isnan(found.planes.normal[1]).all()
    nearest = np.nanargmin(np.where(np.isnan(cast(things).range_mm), np.inf, cast(things).range_mm), axis=0)
    shown = found.surface[..., 0]
    assert (shown[nearest == 1] == 1).mean() > (0.98 if stderr_mm < 5.0 else 0.97)  # the limb is lost in the noise
    assert (shown[nearest == 0] == 0).mean() > 0.99
    assert found.planes.rms_mm[0] == pytest.approx(stderr_mm, rel=0.5)


def test_fine_ranges_lie_on_the_sphere_and_its_parts_are_its_own() -> None:
    things = [WALL, BALL]
    found = before_wall(BALL, 2.0)
    thing, range_mm = true_parts(things)
    inside = (found.surface_fine == 1) & (thing == 1)
    off = found.range_fine[inside] - range_mm[inside]
    assert np.median(np.abs(off)) < 1.0  # mm: half of a layer's error
    assert np.quantile(np.abs(off), 0.95) < 20.0  # at the limb the range changes by more than 50 mm within a pixel
    mixed = np.repeat(np.repeat((cast(things).share > 0.05).sum(axis=0) > 1, PARTS, axis=0), PARTS, axis=1)
    assert (found.surface_fine[mixed] != thing[mixed]).mean() < 0.03


def test_edge_of_a_sphere_is_a_closed_line_around_it() -> None:
    found = before_wall(BALL, 2.0)
    own = found.edges.near == 1
    assert own.sum() > 50
    assert (found.edges.far[own] == 0).all()
    # The cone of the limb: beams at the angle asin(R / distance) from that of the centre.
    centre = np.array([40.0, -30.0, 1500.0])
    assert CAMERA.optics is not None
    rays = CAMERA.optics.rays(found.edges.row[own].astype(float), found.edges.col[own].astype(float), shape=(48, 64))
    angle = np.arccos((rays @ centre) / np.linalg.norm(rays, axis=1) / np.linalg.norm(centre))
    off = (angle - np.arcsin(180.0 / np.linalg.norm(centre))) * 75.0  # pixels
    assert np.sqrt((off**2).mean()) < 0.1


@pytest.mark.parametrize("lean", [0.1, 0.3, 0.6])
def test_crease_between_two_boards_parts_two_planes(lean: float) -> None:
    for sign in (1.0, -1.0):
        boards = joined(wall(2500, (lean * sign, 0.0, 1.0)), wall(2500, (-lean * sign, 0.0, 1.0)))
        assert is_smooth(found_in([boards])) == [False, False]


def test_arm_close_before_a_body_is_a_surface_of_its_own() -> None:
    found = found_in([wall(4000), cylinder(100, 2200, 250), cylinder(60, 1910, 50)])
    assert is_smooth(found) == [False, True, True, True]  # the arm parts the body in the image
