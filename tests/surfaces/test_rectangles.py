"""The least rectangle about the outline of a plane."""

from dataclasses import replace

import numpy as np
import pytest
from support.planes_found import BOARD_MM, BOTTOM, COLS, FACTOR, LEFT, RIGHT, ROWS, SENSOR, TOP, WALL_MM, board_and_wall

from tofmix.arrays import FloatArray
from tofmix.optics.projection import Projection
from tofmix.surfaces.found import WindowSurfaces
from tofmix.surfaces.rectangles import Rectangle, least_rectangle, outline_rectangle

REACH_MM = 7500.0
PART = 0.5 / FACTOR  # the fine image has edges to half a part


def _optics() -> Projection:
    optics = SENSOR.optics
    assert optics is not None
    return optics


def _found(found: WindowSurfaces, surface: int) -> Rectangle:
    rectangle = outline_rectangle(found, surface, _optics(), reach_mm=REACH_MM)
    assert rectangle is not None
    return rectangle


def test_rectangle_of_a_board_has_its_place_and_extent() -> None:
    board = _found(board_and_wall(), 0)
    pitch_mm = np.radians(2.0) * BOARD_MM
    left, right = ((edge - (COLS - 1) / 2) * pitch_mm for edge in (LEFT, RIGHT))
    top, bottom = ((edge - (ROWS - 1) / 2) * pitch_mm for edge in (TOP, BOTTOM))
    centre = [(left + right) / 2, (top + bottom) / 2, BOARD_MM]
    assert board.center_mm == pytest.approx(centre, abs=0.1 * pitch_mm)
    sides = sorted(board.size_mm)
    assert sides == pytest.approx(sorted([right - left, bottom - top]), abs=2 * PART * pitch_mm)


def test_rectangle_of_a_wall_goes_on_behind_the_board() -> None:
    wall = _found(board_and_wall(), 1)
    width = np.tan(np.radians(8.0)) + np.tan(np.radians(6.0))  # the last column of pixels has no return
    height = 2.0 * np.tan(np.radians(6.0)) / np.cos(np.radians(8.0))  # rows of equal angles spread at the sides
    assert wall.size_mm.max() == pytest.approx(width * WALL_MM, rel=0.01)
    assert wall.size_mm.min() == pytest.approx(height * WALL_MM, rel=0.01)


def test_both_parts_of_a_wall_behind_a_pillar_are_in_its_rectangle() -> None:
    found = board_and_wall()
    fine, ranges = found.surface_fine.copy(), found.range_fine.copy()
    fine[:, 12:16], ranges[:, 12:16] = 0, BOARD_MM
    whole = _found(found, 1)
    cut = _found(replace(found, surface_fine=fine, range_fine=ranges), 1)
    assert cut.size_mm == pytest.approx(whole.size_mm)


def test_a_surface_without_a_part_of_a_pixel_has_no_rectangle() -> None:
    found = board_and_wall()
    fine = np.where(found.surface_fine == 0, 1, found.surface_fine)
    assert outline_rectangle(replace(found, surface_fine=fine), 0, _optics(), reach_mm=REACH_MM) is None


def test_a_plane_at_grazing_incidence_ends_where_the_reach_does() -> None:
    found = board_and_wall()
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]], dtype=np.float32)
    floor = replace(found.planes, normal=normal, offset_mm=np.array([BOARD_MM, 200.0], dtype=np.float32))
    whole = np.ones_like(found.surface_fine)
    corners = _corners(_found(replace(found, planes=floor, surface_fine=whole), 1))
    assert corners[:, 1] == pytest.approx(200.0)
    assert 0.9 * REACH_MM < np.linalg.norm(corners, axis=1).max() < 1.1 * REACH_MM


def _corners(rectangle: Rectangle) -> FloatArray:
    half = rectangle.size_mm / 2.0
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(rectangle.center_mm + (signs * half) @ rectangle.axes[:, :2].T)


def test_least_rectangle_about_the_corners_of_a_turned_one_is_that_one(rng: np.random.Generator) -> None:
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    axes *= np.sign(np.linalg.det(axes))
    wanted = Rectangle(center_mm=np.array([3.0, -4.0, 50.0]), size_mm=np.array([20.0, 8.0]), axes=axes)
    inside = wanted.center_mm + (rng.uniform(-0.5, 0.5, (40, 2)) * wanted.size_mm) @ axes[:, :2].T
    found = least_rectangle(np.concatenate([_corners(wanted), inside]), axes[:, 2])
    assert found is not None
    assert sorted(found.size_mm) == pytest.approx([8.0, 20.0])
    assert found.center_mm == pytest.approx(wanted.center_mm)
    assert found.contains(inside).all()
    assert not found.contains(wanted.center_mm + 10.1 * axes[:, :1].T).any()
