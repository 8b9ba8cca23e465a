"""Edges too short for a run of their own: ends of slats and bottoms of notches."""

import math

import numpy as np
import pytest
from support.edges import by_parts, camera, counted, wrong_parts
from support.plates import SMALL, Plate, facing, rays, scene, wall

from tofmix.arrays import FloatArray
from tofmix.surfaces.edge_shape import covered_by_three
from tofmix.surfaces.reconstruct import reconstruct
from tofmix.surfaces.short_edges import (
    PLACE_DOWN,
    PLACE_RIGHT,
    PLACES,
    SHORT_ANGLE,
    SHORT_NUMBERS,
    SHORT_OFFSET,
    SHORT_SCRATCH,
    SHORT_VAR_ANGLE,
    SHORT_VAR_OFFSET,
    fit_short_edge,
)

_FRAMES = 4000
"""Frames of nearly exact shares."""


def _grid() -> FloatArray:
    """Rays (5, 5, 3, 3) of a plane grid about its middle: x, y and 1; x to the next row and y to the next column."""
    out = np.zeros((5, 5, 3, 3))
    for row in range(5):
        for col in range(5):
            out[row, col] = (row - 2, col - 2, 1), (1, 0, 0), (0, 1, 0)
    return out


def _line(angle: float, offset: float) -> FloatArray:
    """An edge (PLACES, 3) in each place of the window."""
    down, right = math.cos(angle), math.sin(angle)
    return np.array([(down, right, down * PLACE_DOWN[k] + right * PLACE_RIGHT[k] - offset) for k in range(PLACES)])


def _fitted(side: float, one: FloatArray, other: FloatArray, share: FloatArray, samples: float) -> FloatArray:
    told = np.stack([share, np.full(PLACES, samples), np.zeros(PLACES)], axis=1)
    fit, work, scratch = np.empty(SHORT_NUMBERS), np.empty((3, 8, 2)), np.empty((SHORT_SCRATCH, PLACES))
    fit_short_edge(side, one, other, np.eye(3), _grid(), 2, 2, told, work, scratch, fit)
    return fit


def _areas(side: float, one: FloatArray, other: FloatArray, third: FloatArray) -> FloatArray:
    work = np.empty((3, 8, 2))
    area = np.array([covered_by_three(side, one[k], other[k], third[k], work) for k in range(PLACES)])
    return area if side > 0 else 1.0 - area


def _strip(turn: float, wide: float, side: float) -> tuple[FloatArray, FloatArray]:
    """The sides of a strip (side 1), or of a gap (-1), that many pixels wide."""
    if side > 0:
        return _line(turn, -0.5 * wide), _line(turn + math.pi, -0.5 * wide)
    return _line(turn, 0.5 * wide), _line(turn + math.pi, 0.5 * wide)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("wide", [1.2, 2.0, 3.0])
@pytest.mark.parametrize("turn", [0.0, 0.4, 1.7, 3.0])
def test_end_of_a_strip_or_notch_is_that_of_exact_shares(turn: float, wide: float, side: float) -> None:
    one, other = _strip(turn, wide, side)
    angle, offset = turn + math.pi / 2 + 0.15, 0.2
    fit = _fitted(side, one, other, _areas(side, one, other, _line(angle, offset)), 1.0e5)
    assert math.cos(fit[SHORT_ANGLE] - angle) > math.cos(2e-3)
    assert fit[SHORT_OFFSET] == pytest.approx(offset, abs=2e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_short_edge_beside_a_single_long_one_is_that_of_exact_shares(side: float) -> None:
    one, angle, offset = _line(0.1, -0.3), 0.1 + math.pi / 2 - 0.1, 0.1
    fit = _fitted(side, one, one, _areas(side, one, one, _line(angle, offset)), 1.0e5)
    assert math.cos(fit[SHORT_ANGLE] - angle) > math.cos(2e-3)
    assert fit[SHORT_OFFSET] == pytest.approx(offset, abs=2e-3)


def test_errors_of_a_short_edge_are_those_that_counts_scatter_by(rng: np.random.Generator) -> None:
    one, other = _strip(0.3, 2.4, 1.0)
    angle, offset = 0.3 + math.pi / 2, 0.1
    area, samples = _areas(1.0, one, other, _line(angle, offset)), 400
    z = []
    for _ in range(200):
        fit = _fitted(1.0, one, other, rng.binomial(samples, area) / samples, samples)
        turn = (fit[SHORT_ANGLE] - angle + math.pi) % (2 * math.pi) - math.pi
        z.append(
            (turn / math.sqrt(fit[SHORT_VAR_ANGLE]), (fit[SHORT_OFFSET] - offset) / math.sqrt(fit[SHORT_VAR_OFFSET]))
        )
    spread = np.sqrt(np.mean(np.square(z), axis=0))
    # 200 draws: 5 % of chance; the first guess, a right angle, is the truth here and narrows the angle a little.
    assert (spread > 0.8).all()
    assert (spread < 1.2).all()


def _at_ends(plate: Plate, wrong: FloatArray) -> FloatArray:
    """The pixels (n,) of `wrong` within a pixel of the plate's ends: its axis v."""
    row, col = np.meshgrid(*(np.arange(n, dtype=float) for n in wrong.shape), indexing="ij")
    _, _, along = plate.met(rays(SMALL, row, col))
    near = np.abs(np.abs(along) - plate.half_mm[1]) < SMALL.cell_rad[0] * plate.center_mm[2]
    return np.asarray(wrong[near & np.isfinite(wrong)])


@pytest.mark.parametrize("roll_deg", [0.0, 12.0, 90.0])
@pytest.mark.parametrize("wide", [2.0, 2.5, 3.0, 3.6])
def test_ends_of_slats_are_painted_to_a_hundredth_of_their_area(wide: float, roll_deg: float) -> None:
    slat = facing(SMALL, 23.2, 29.4, 1800.0, size_pixels=(wide, 21.3), roll_deg=roll_deg)
    one = scene([slat, wall(3000.0)], SMALL)
    found = reconstruct(counted(one, _FRAMES, 1), camera(SMALL))
    wrong = _at_ends(slat, wrong_parts(one, found.range_fine, _FRAMES))
    assert len(wrong) >= 6
    assert wrong.mean() < 0.01


@pytest.mark.parametrize("wide", [2.0, 2.7])
def test_gap_that_ends_in_a_board_is_painted_to_a_hundredth_of_its_area(wide: float) -> None:
    pixel_mm = SMALL.cell_rad[0] * 1800.0
    pieces = [
        Plate(center_mm=(0.0, -7.0 * pixel_mm, 1800.0), half_mm=(14.0 * pixel_mm, 5.3 * pixel_mm)),
        *(
            Plate(
                center_mm=((side * (0.5 * wide + 6.0) + 0.3) * pixel_mm, 8.0 * pixel_mm, 1800.0),
                half_mm=(6.0 * pixel_mm, 10.0 * pixel_mm),
            )
            for side in (-1, 1)
        ),
    ]
    one = scene([*pieces, wall(3000.0)], SMALL)
    found = reconstruct(counted(one, _FRAMES, 1), camera(SMALL))
    # The gap's end is 1.7 pixels above the image's middle: the rows about it, between the other pieces.
    end, middle = round((SMALL.rows - 1) / 2 - 1.7), (SMALL.cols - 1) / 2 + 0.3
    there = np.zeros((SMALL.rows, SMALL.cols), bool)
    there[end - 1 : end + 2, int(middle - 0.5 * wide) : int(middle + 0.5 * wide) + 2] = True
    is_wall = by_parts(one.truth.part_surface, there) == len(pieces)
    painted = by_parts(found.range_fine, there) > 2400.0
    assert 0.2 < is_wall.mean() < 0.8
    assert (painted != is_wall).mean() < 0.01


def test_points_at_the_ends_of_slats_are_right_within_their_errors() -> None:
    z = []
    for seed in range(8):
        slat = facing(SMALL, 23.0 + 0.1 * seed, 29.4, 1800.0, size_pixels=(2.2 + 0.2 * seed, 20.5), roll_deg=3.0 * seed)
        one = scene([slat, wall(3000.0)], SMALL)
        edges = reconstruct(counted(one, 100, seed), camera(SMALL)).edges
        _, u, v = slat.met(rays(SMALL, edges.row, edges.col))
        pixel_mm = SMALL.cell_rad[0] * 1800.0
        across, along = (np.abs(u) - slat.half_mm[0]) / pixel_mm, (np.abs(v) - slat.half_mm[1]) / pixel_mm
        at_end = (across < -0.3) & (np.abs(along) < 0.6)
        z.append(along[at_end] / edges.stderr[at_end])
    both = np.concatenate(z)
    assert len(both) > 30
    # The points of an end have most of their error in common: 16 ends.
    assert 0.6 < np.sqrt(np.mean(both**2)) < 1.5
