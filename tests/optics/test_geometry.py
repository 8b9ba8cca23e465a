"""Where pixels look: closed forms, symmetry, and the simulator's own beams."""

import numpy as np
import pytest
from support.naive import beam_directions, pixel_angles

from tofmix.optics.geometry import largest_angle_deg, ray_over_depth
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import beam_directions_of
from tofmix.sensors import load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

VIEW = {"fov_horizontal_deg": 47.0, "fov_vertical_deg": 39.0}


def test_directions_are_unit_vectors_of_equal_angles() -> None:
    directions = beam_directions(5, 8, **VIEW)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    azimuth = np.rad2deg(np.arctan2(directions[..., 0], directions[..., 2]))
    elevation = np.rad2deg(np.arcsin(directions[..., 1]))
    np.testing.assert_allclose(azimuth, np.tile((np.arange(8) - 3.5) * 47 / 8, (5, 1)))
    np.testing.assert_allclose(elevation, np.tile((np.arange(5) - 2.0) * 39 / 5, (8, 1)).T)
    np.testing.assert_allclose(pixel_angles(1, 60.0), 0.0)


def test_points_of_a_board_lie_on_the_board() -> None:
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


def test_depth_of_a_pinhole_follows_pythagoras() -> None:
    over = ray_over_depth(beam_directions_of(Pinhole(fx=3.0, fy=5.0, cx=1.0, cy=2.0), (6, 4)))
    for row in range(6):
        for col in range(4):
            x, y = (col - 1.0) / 3.0, (row - 2.0) / 5.0
            assert over[row, col] == pytest.approx(np.sqrt(x * x + y * y + 1.0), rel=1e-15)


@pytest.mark.parametrize("view", [(0.0, 10.0), (10.0, -1.0), (361.0, 10.0), (10.0, 181.0), (np.nan, 1.0)])
def test_impossible_field_of_view_is_refused(view: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="fov_"):
        beam_directions(2, 2, fov_horizontal_deg=view[0], fov_vertical_deg=view[1])


def test_beams_across_the_axis_have_no_depth_and_are_refused() -> None:
    with pytest.raises(ValueError, match="90 degrees"):
        ray_over_depth(beam_directions(2, 2, fov_horizontal_deg=360.0, fov_vertical_deg=10.0))


def test_the_largest_angle_is_that_of_the_arccosine() -> None:
    # Far from 0, where the arccosine can be trusted.
    grid = beam_directions(4, 6, fov_horizontal_deg=90.0, fov_vertical_deg=60.0)
    pinhole = beam_directions_of(Pinhole(fx=3.0, fy=3.0, cx=2.5, cy=1.5), (4, 6))
    cosine = np.clip((grid * pinhole).sum(axis=-1), -1.0, 1.0)
    assert largest_angle_deg(grid, pinhole) == pytest.approx(float(np.rad2deg(np.arccos(cosine)).max()), rel=1e-9)
    assert largest_angle_deg(grid, grid) == 0.0
