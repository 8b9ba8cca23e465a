"""Edges below a pixel and the fine range image against truth by fine casting, short edges among them."""

import math

import numpy as np
import pytest
from support.edges import between, by_parts, camera, counted, judge_parts, judge_places, wrong_parts
from support.plates import (
    SMALL,
    Plate,
    Scene,
    bars,
    disks,
    facing,
    half_plane,
    lattice,
    rays,
    scene,
    tilted_rectangles,
    wall,
)

from tofmix.arrays import FloatArray
from tofmix.flags import Mixing
from tofmix.layers import Layers
from tofmix.sensor import Sensor
from tofmix.surfaces.edge_shape import covered_by_three
from tofmix.surfaces.found import NO_SURFACE, WindowSurfaces, plane_ranges
from tofmix.surfaces.reconstruct import reconstruct
from tofmix.surfaces.settings import LinkSettings, SurfaceSettings
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


def _found(one: Scene, frames: int = 100, seed: int = 1) -> tuple[Layers, WindowSurfaces]:
    layers = counted(one, frames, seed)
    return layers, reconstruct(layers, camera(SMALL))


def test_points_of_a_half_planes_edge_are_right_within_their_errors() -> None:
    total = None
    for seed in range(1, 7):
        one = scene(half_plane(np.random.default_rng(seed), SMALL), SMALL)
        layers, found = _found(one, seed=seed)
        edges = found.edges
        ours = between(one, layers, found.surface, edges.near, edges.far)
        places = judge_places(one, 100, edges.row[ours], edges.col[ours], edges.stderr[ours])
        total = places if total is None else total + places
    assert total is not None
    assert total.points > 300
    assert total.covered > 0.99
    assert total.rms < 0.025  # pixels; one pixel by itself tells 0.041
    assert 0.6 < total.z_rms < 1.5  # points of an edge are not independent


@pytest.mark.parametrize(
    ("plates", "surfaces", "most"),
    [(tilted_rectangles, 2, 0.025), (disks, 2, 0.03), (bars(0.8), 2, 0.03), (lattice, 3, 0.06)],
)
def test_parts_of_mixed_pixels_have_the_right_surface(plates: object, surfaces: int, most: float) -> None:
    one = scene(plates(np.random.default_rng(2), SMALL), SMALL)  # type: ignore[operator]
    _, found = _found(one)
    wrong = judge_parts(one, found.range_fine, 100, surfaces=surfaces)
    assert wrong.pixels > 20
    assert wrong.mean < most


def test_disks_of_nearly_exact_shares_are_painted_to_half_a_percent() -> None:
    one = scene(disks(np.random.default_rng(2), SMALL), SMALL)
    _, found = _found(one, frames=200_000)
    wrong = judge_parts(one, found.range_fine, 200_000)
    assert wrong.pixels > 30
    assert wrong.mean < 0.005


def test_line_of_a_board_follows_its_outline_with_its_corners() -> None:
    board = facing(SMALL, 23.0, 29.0, 1800.0, size_pixels=(24.0, 18.0), roll_deg=25.0)
    _, found = _found(scene([board, wall(3000.0)], SMALL), frames=400)
    lines = [line for line in found.edges.lines() if line.stop - line.start > 8]
    assert len(lines) == 1
    line = lines[0]
    row, col = found.edges.row[line], found.edges.col[line]
    # A ring: twice the enclosed area by the shoelace formula, the board to the left as rows run downward.
    area = 0.5 * float(np.sum(col * np.roll(row, -1) - np.roll(col, -1) * row))
    assert -area == pytest.approx(24.0 * 18.0, rel=0.02)
    assert (found.edges.near[line] == 1).all()
    assert (found.edges.far[line] == 0).all()


def test_board_before_open_space_ends_at_no_return() -> None:
    board = facing(SMALL, 23.0, 29.0, 1800.0, size_pixels=(24.0, 18.0), roll_deg=10.0)
    _, found = _found(scene([board], SMALL))
    assert len(found.edges) > 60
    assert (found.edges.far == NO_SURFACE).all()
    shown = np.isfinite(found.range_fine).mean() * 48 * 60
    assert shown == pytest.approx(24.0 * 18.0, rel=0.02)


def test_board_in_the_middle_of_the_grid_has_an_edge_at_the_borders_of_pixels() -> None:
    one = scene([facing(SMALL, 23.5, 29.5, 1800.0, size_pixels=(20.0, 16.0)), wall(3000.0)], SMALL)
    _, found = _found(one)
    down, across = np.abs(found.edges.row - 23.5), np.abs(found.edges.col - 29.5)
    assert len(found.edges) > 50
    assert np.maximum(down - 8.0, across - 10.0) == pytest.approx(0.0, abs=0.2)


def test_fine_ranges_lie_on_the_planes_of_their_surfaces() -> None:
    one = scene(tilted_rectangles(np.random.default_rng(3), SMALL), SMALL)
    _, found = _found(one)
    shown = found.surface_fine >= 0
    assert np.isfinite(found.range_fine[shown]).all()
    row, col = ((np.arange(n * 8) + 0.5) / 8 - 0.5 for n in (48, 60))
    optics = camera(SMALL).optics
    assert optics is not None
    rays = optics.rays(row[:, np.newaxis], col, shape=(48, 60))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    expected = plane_ranges(found.planes, found.surface_fine, rays)
    near = np.abs(found.range_fine - expected)[shown] < 0.1 * expected[shown]
    assert near.all()


def _with_false_layer(layers: Layers, row: int, col: int, share: float) -> Layers:
    """Layers whose pixel (row, col) has a second layer behind the first, as noise makes one in a thousand."""
    changed = {spec.name: getattr(layers, spec.name).copy() for spec in layers.fields}
    for name, values in changed.items():
        if values.ndim == 3:
            changed[name] = np.concatenate([values, np.full_like(values[..., :1], np.nan)], axis=-1)
            changed[name][row, col, 1] = values[row, col, 0]
    changed["n_modes"][row, col] = 2
    changed["range"][row, col, 1] *= 1.02
    changed["weight"][row, col, :2] *= (1.0 - share, share)
    changed["weight_stderr"][row, col, :2] = np.sqrt(share * (1.0 - share) / layers.n_samples[row, col])
    return Layers(**changed)


@pytest.mark.parametrize("share", [0.1, 0.2, 0.5, 0.65])
def test_false_layer_of_one_pixel_of_a_wall_is_no_edge(share: float) -> None:
    layers = counted(scene([wall(3000.0)], SMALL), 25, 1)
    found = reconstruct(_with_false_layer(layers, 20, 30, share), camera(SMALL))
    assert (found.surface[20, 30, :2] == (0, NO_SURFACE)).all()  # not of the wall
    assert len(found.edges) == 0


def test_false_layer_far_from_a_boards_edge_leaves_its_line_as_it_is() -> None:
    layers = counted(scene([facing(SMALL, 23.0, 29.0, 1800.0, size_pixels=(24.0, 18.0)), wall(3000.0)], SMALL), 100, 1)
    before = reconstruct(layers, camera(SMALL)).edges
    after = reconstruct(_with_false_layer(layers, 3, 5, 0.2), camera(SMALL)).edges
    assert len(before) > 50
    assert np.array_equal(before.row, after.row)
    assert np.array_equal(before.stderr, after.stderr, equal_nan=True)


def test_undecided_pixels_get_the_surfaces_of_their_neighbours() -> None:
    one = scene([facing(SMALL, 23.0, 20.0, 1800.0, size_pixels=(20.3, 200.0)), wall(3000.0)], SMALL)
    layers = counted(one, 100, 5)
    mixed = layers.n_modes > 1
    mixing = np.where(mixed, int(Mixing.UNDECIDED), int(Mixing.ONE_SURFACE)).astype(np.uint8)
    undecided = Layers(**{s.name: getattr(layers, s.name) for s in layers.fields}, mixing=mixing)
    found = reconstruct(undecided, camera(SMALL))
    parts = np.kron(mixed, np.ones((8, 8), bool)).astype(bool)
    assert np.isfinite(found.range_fine[parts]).all()
    assert set(np.unique(found.surface_fine[parts])) == {0, 1}


def test_points_of_a_straight_edge_lie_on_one_plane_through_the_camera() -> None:
    plate = Plate(center_mm=(50.0, 0.0, 1800.0), outline="half-plane", roll_deg=30.0)
    layers = counted(scene([plate, wall(3000.0)], SMALL), 400, 1)
    found = reconstruct(layers, camera(SMALL))
    optics = camera(SMALL).optics
    assert optics is not None
    long = max(found.edges.lines(), key=lambda line: line.stop - line.start)
    rays = optics.rays(found.edges.row[long].astype(float), found.edges.col[long].astype(float), shape=(48, 60))
    spread = np.linalg.svd(rays, compute_uv=False)
    assert spread[2] / np.sqrt(len(rays)) < 0.02 * np.deg2rad(SMALL.fov_horizontal_deg / 60)


def test_layers_without_optics_are_refused_and_settings_bound_a_surface() -> None:
    with pytest.raises(ValueError, match="sensor: no field of view"):
        reconstruct(Layers.empty((4, 4), 2), Sensor(name="blind"))
    one = scene(half_plane(np.random.default_rng(1), SMALL), SMALL)
    layers = counted(one, 100, 1)
    link = LinkSettings(least_layers=layers.range.size + 1)
    found = reconstruct(layers, camera(SMALL), settings=SurfaceSettings(link=link))
    assert len(found.planes) == len(found.edges) == 0
    assert (found.surface == NO_SURFACE).all()


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
