"""Where pixels look: projections, the pinhole, closed forms, phase and range."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.constants import c
from support import lens
from support.naive import beam_directions, pixel_angles

from tofmix.circle import unambiguous_range_mm
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Distortion, Pinhole
from tofmix.optics.projection import (
    PROJECTIONS,
    Projection,
    beam_directions_of,
    cell_nodes,
    largest_angle_deg,
    make_projection,
    pixel_extent_rad,
    ray_over_depth,
    unit,
)
from tofmix.sensors import load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

SHAPE = (9, 11)
EQUIANGULAR = Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0)
PINHOLE = Pinhole(fx=13.0, fy=12.0, cx=5.3, cy=3.8, distortion=(-0.1, 0.01, 0.001, -0.002, 0.0))
ALL: list[Projection] = [EQUIANGULAR, PINHOLE]


def test_projections_have_names_and_keys_of_their_own() -> None:
    assert {name: kind.name for name, kind in PROJECTIONS.items()} == {name: name for name in PROJECTIONS}
    with pytest.raises(ValueError, match=r"^projection: 'fisheye' is not known; known: equiangular, pinhole$"):
        make_projection("fisheye", {})
    with pytest.raises(ValueError, match=r"^projection: pinhole needs fy, cy$"):
        make_projection("pinhole", {"fx": 1.0, "cx": 1.0})
    expected = beam_directions(*SHAPE, fov_horizontal_deg=47.0, fov_vertical_deg=39.0)
    np.testing.assert_array_equal(beam_directions_of(EQUIANGULAR, SHAPE), expected)


@pytest.mark.parametrize("projection", ALL)
def test_pixels_undo_rays(projection: Projection) -> None:
    row, col = np.meshgrid(np.linspace(-0.5, 8.5, 19), np.linspace(-0.5, 10.5, 23), indexing="ij")
    back = projection.pixels(3.0 * projection.rays(row, col, shape=SHAPE), shape=SHAPE)
    np.testing.assert_allclose(back, (row, col), atol=1e-9)


@pytest.mark.parametrize("projection", ALL)
def test_cells_of_neighbours_meet_and_hold_their_pixel(projection: Projection) -> None:
    directions = beam_directions_of(projection, SHAPE)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=1e-14)
    nodes = np.stack([cell_nodes(projection, row, SHAPE) for row in range(SHAPE[0])])
    np.testing.assert_allclose(unit(nodes[:, 1, 1::2]), directions, atol=1e-14)
    np.testing.assert_allclose(nodes[:-1, 2], nodes[1:, 0], atol=1e-12)


@pytest.mark.parametrize("projection", ALL)
def test_extent_is_the_larger_angle_across_a_pixel(projection: Projection) -> None:
    found = pixel_extent_rad(projection, SHAPE)
    for row, col in [(0, 0), (4, 5), (8, 10), (0, 7)]:
        across = unit(projection.rays(row, np.array([col - 0.5, col + 0.5]), shape=SHAPE))
        down = unit(projection.rays(np.array([row - 0.5, row + 0.5]), col, shape=SHAPE))
        angle = np.arccos([across[0] @ across[1], down[0] @ down[1]]).max()
        if projection is EQUIANGULAR:  # the angle of azimuth: up to cos(elevation) more than that on the sphere
            assert angle == pytest.approx(found[row, col], rel=0.06)
        else:
            assert angle == pytest.approx(found[row, col], rel=1e-6)


VIEW = {"fov_horizontal_deg": 47.0, "fov_vertical_deg": 39.0}


def test_directions_are_unit_vectors_to_the_points_of_a_board() -> None:
    directions = beam_directions(5, 8, **VIEW)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    azimuth = np.rad2deg(np.arctan2(directions[..., 0], directions[..., 2]))
    elevation = np.rad2deg(np.arcsin(directions[..., 1]))
    np.testing.assert_allclose(azimuth, np.tile((np.arange(8) - 3.5) * 47 / 8, (5, 1)))
    np.testing.assert_allclose(elevation, np.tile((np.arange(5) - 2.0) * 39 / 5, (8, 1)).T)
    np.testing.assert_allclose(pixel_angles(1, 60.0), 0.0)
    # The simulator casts its own beams; ranges times our directions must meet the board again.
    camera = load_profile("sr3000")
    model = Model(
        sensor=camera, surfaces=(Surface(name="board", center_mm=(0.0, 0.0, 3000.0), size_mm=(9000.0, 9000.0)),)
    )
    truth = cast_scene(model)
    directions = beam_directions(camera.rows, camera.cols, fov_horizontal_deg=47.0, fov_vertical_deg=39.0)
    depth = truth.range_true[..., 0] * directions[..., 2]
    np.testing.assert_allclose(depth, 3000.0, rtol=3e-5)  # a cell's mean range is not quite that of its middle
    over = ray_over_depth(directions)
    np.testing.assert_allclose(3000.0 * over, truth.range_true[..., 0], rtol=3e-5)


def test_depth_of_a_pinhole_follows_pythagoras_and_beams_across_have_none() -> None:
    over = ray_over_depth(beam_directions_of(Pinhole(fx=3.0, fy=5.0, cx=1.0, cy=2.0), (6, 4)))
    for row in range(6):
        for col in range(4):
            x, y = (col - 1.0) / 3.0, (row - 2.0) / 5.0
            assert over[row, col] == pytest.approx(np.sqrt(x * x + y * y + 1.0), rel=1e-15)
    with pytest.raises(ValueError, match="90 degrees"):
        ray_over_depth(beam_directions(2, 2, fov_horizontal_deg=360.0, fov_vertical_deg=10.0))


@pytest.mark.parametrize("view", [(0.0, 10.0), (10.0, -1.0), (361.0, 10.0), (10.0, 181.0), (np.nan, 1.0)])
def test_impossible_field_of_view_is_refused(view: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="fov_"):
        beam_directions(2, 2, fov_horizontal_deg=view[0], fov_vertical_deg=view[1])


def test_largest_angle_and_words_of_a_projection() -> None:
    # Far from 0, where the arccosine can be trusted.
    grid = beam_directions(4, 6, fov_horizontal_deg=90.0, fov_vertical_deg=60.0)
    pinhole = beam_directions_of(Pinhole(fx=3.0, fy=3.0, cx=2.5, cy=1.5), (4, 6))
    cosine = np.clip((grid * pinhole).sum(axis=-1), -1.0, 1.0)
    assert largest_angle_deg(grid, pinhole) == pytest.approx(float(np.rad2deg(np.arccos(cosine)).max()), rel=1e-9)
    assert largest_angle_deg(grid, grid) == 0.0
    focal = 88.0 / math.tan(math.radians(35.0)), 72.0 / math.tan(math.radians(27.5))
    camera = Pinhole(fx=focal[0], fy=focal[1], cx=87.5, cy=71.5)
    assert camera.words((144, 176)) == "70.0 x 55.0 degrees of a pinhole"
    assert unambiguous_range_mm(20e6) == pytest.approx(1000 * c / 40e6)


WIDE: dict[str, Any] = {"fx": 125.7, "fy": 138.3, "cx": 87.2, "cy": 70.9}
LENSES = [
    (),
    (-0.1, 0.0, 0.0, 0.0),
    (-0.28, 0.07, 0.001, -0.002, -0.01),
    (0.2, -0.05, -0.0015, 0.001, 0.02),
    (0.6, -2.9, -2.7e-4, 1.9e-4, 1.67, 0.48, -2.7, 1.59),  # the rational model, as of an Azure Kinect's kind
]


@pytest.mark.parametrize("distortion", LENSES)
def test_rays_agree_with_the_lens_by_brute_force(distortion: tuple[float, ...]) -> None:
    rng = np.random.default_rng(3)
    row, col = rng.uniform(-0.5, 143.5, 500), rng.uniform(-0.5, 175.5, 500)
    rays = Pinhole(**WIDE, distortion=distortion).rays(row, col, shape=(144, 176))
    expected, _ = lens.beams(row, col, **WIDE, distortion=distortion)
    np.testing.assert_allclose(rays / np.linalg.norm(rays, axis=1, keepdims=True), expected, atol=1e-12)


@pytest.mark.parametrize("distortion", LENSES)
def test_pixels_of_rays_are_where_the_rays_are_from(distortion: tuple[float, ...]) -> None:
    pinhole = Pinhole(**WIDE, distortion=distortion)
    row, col = np.meshgrid(np.linspace(-0.5, 143.5, 31), np.linspace(-0.5, 175.5, 31), indexing="ij")
    rays = pinhole.rays(row, col, shape=(144, 176))
    for length in (1.0, 2500.0):
        back = pinhole.pixels(length * rays, shape=(144, 176))
        np.testing.assert_allclose(back, (row, col), atol=1e-8)


coefficient = st.floats(-0.3, 0.3)
small = st.floats(-0.005, 0.005)


@given(
    k=st.tuples(coefficient, coefficient, small, small, coefficient, coefficient, coefficient, coefficient),
    radius=st.floats(0, 1.5),
    angle=st.floats(0, 7),
)
def test_undistorting_gives_a_place_that_is_imaged_there_or_none(
    k: tuple[float, ...], radius: float, angle: float
) -> None:
    """Whatever the lens: either NaN, or the formula leads back to the place, from this side of the fold."""
    distortion = Distortion(k)
    to = np.array([radius * math.cos(angle)]), np.array([radius * math.sin(angle)])
    x, y = distortion.undo(*to)
    if np.isfinite(x[0]):
        np.testing.assert_allclose(lens.distorted(x, y, k), to, atol=1e-9)
        assert math.hypot(x[0], y[0]) < distortion.fold_radius()


def test_fold_is_that_of_a_fine_scan_and_an_image_that_reaches_it_is_refused() -> None:
    rng = np.random.default_rng(5)
    r = np.linspace(0, 3, 100_001)
    for k in rng.uniform(-0.4, 0.4, (25, 8)) * [1, 1, 0, 0, 1, 1, 1, 1]:
        imaged = lens.distorted(r, np.zeros_like(r), tuple(k))[0]
        turns = np.flatnonzero(np.diff(imaged) <= 0)
        expected = r[turns[0]] if turns.size else math.inf
        assert min(Distortion(tuple(k)).fold_radius(), 3.0) == pytest.approx(min(expected, 3.0), abs=6e-5)
    folding = Pinhole(**(WIDE | {"fx": 60.0, "fy": 60.0}), distortion=(-0.25, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"^distortion: it folds.* 49\.1 degrees off the axis.* row -0\.5, column"):
        folding.check((144, 176))
    Pinhole(fx=60.0, fy=60.0, cx=19.5, cy=19.5, distortion=(-0.25, 0.0, 0.0, 0.0)).check((40, 40))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"fx": 0.0}, r"^fx: 0 is not a finite number above 0"),
        ({"fy": -2.0}, r"^fy: -2 is not"),
        ({"fy": math.inf}, r"^fy: inf is not"),
        ({"cx": math.nan}, r"^cx: nan is not a finite number$"),
        ({"distortion": (0.1,)}, r"^distortion: 1 numbers; expected OpenCV's k1 k2 p1 p2"),
        ({"distortion": (0.1,) * 14}, r"^distortion: 14 numbers"),
        ({"distortion": (0.1, math.nan, 0.0, 0.0)}, r"^distortion: .*nan.*: not all are finite"),
    ],
)
def test_numbers_that_no_camera_has_are_refused(change: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Pinhole(**(WIDE | change))


@pytest.mark.parametrize("focal", [1e-300, 1e-5])
def test_a_pinhole_of_180_degrees_is_refused(focal: float) -> None:
    with pytest.raises(ValueError, match=r"^fx, fy: a pinhole images up to 89\.94 degrees"):
        Pinhole(fx=focal, fy=focal, cx=1.0, cy=1.0).check((3, 3))


def test_directions_behind_the_camera_and_beyond_the_fold_have_no_pixel() -> None:
    pinhole = Pinhole(**WIDE, distortion=(-0.1, 0.0, 0.0, 0.0))
    directions = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [1.9, 0.0, 1.0], [1.8, 0.0, 1.0]])
    row, col = pinhole.pixels(directions, shape=(144, 176))
    np.testing.assert_array_equal(np.isnan(row), [True, True, True, False])
    np.testing.assert_array_equal(np.isnan(col), np.isnan(row))


@pytest.mark.parametrize("frequency", [0.0, -1.0, float("nan")])
def test_a_frequency_must_be_above_zero(frequency: float) -> None:
    with pytest.raises(ValueError, match="not above 0"):
        unambiguous_range_mm(frequency)
