"""The registry of projections, and what holds of each of them alike."""

import numpy as np
import pytest
from support.naive import beam_directions

from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import (
    PROJECTIONS,
    Projection,
    beam_directions_of,
    cell_nodes,
    list_keys,
    make_projection,
    number_keys,
    pixel_extent_rad,
    projection_values,
    unit,
)

SHAPE = (9, 11)
EQUIANGULAR = Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0)
PINHOLE = Pinhole(fx=13.0, fy=12.0, cx=5.3, cy=3.8, distortion=(-0.1, 0.01, 0.001, -0.002, 0.0))
ALL: list[Projection] = [EQUIANGULAR, PINHOLE]


def test_equal_angle_directions_follow_the_formula() -> None:
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


@pytest.mark.parametrize("projection", ALL)
def test_a_projection_is_made_again_of_its_own_values(projection: Projection) -> None:
    assert make_projection(projection.name, projection_values(projection)) == projection
    assert set(projection_values(projection)) <= {*number_keys(projection.name), *list_keys(projection.name)}


def test_every_projection_has_its_own_name() -> None:
    assert {name: kind.name for name, kind in PROJECTIONS.items()} == {name: name for name in PROJECTIONS}


def test_missing_or_unknown_projection_keys_are_named() -> None:
    with pytest.raises(ValueError, match=r"^projection: 'fisheye' is not known; known: equiangular, pinhole$"):
        make_projection("fisheye", {})
    with pytest.raises(ValueError, match=r"^projection: pinhole needs fy, cy$"):
        make_projection("pinhole", {"fx": 1.0, "cx": 1.0})
