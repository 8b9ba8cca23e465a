"""Maps from a pinhole's pixels: the kernel against thin rays, outlines that hold their cells, and an open room."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support import lens, naive
from support.alike import MakeLayers
from support.sizes import sized

from tofmix.arrays import FloatArray
from tofmix.mapping.beams import beams_from_layers
from tofmix.mapping.grid import Pose, VoxelGrid, cell_outlines, image_cone, image_nodes, plan_grid
from tofmix.mapping.occupancy import count_light
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import pixel_extent_rad
from tofmix.sensor import Sensor

LENS: dict[str, Any] = {"fx": 57.0, "fy": 55.0, "cx": 1.3, "cy": 0.8}
DISTORTION = (-0.2, 0.02, 0.004, -0.003, 0.0)
POSES = [Pose(), Pose(x_mm=333.0, y_mm=-250.0, yaw_deg=35.0, pitch_deg=-20.0), Pose(yaw_deg=180.0, pitch_deg=65.0)]


@pytest.fixture
def pinhole(camera: Sensor) -> Sensor:
    """The small camera with a lens: 3 x 3 pixels of about one degree."""
    return replace(camera, projection=Pinhole(**LENS, distortion=DISTORTION))


def _direction(down: float, right: float) -> FloatArray:
    """Unit vector of a place in the image, by the twin of the lens."""
    return lens.beams(np.array(down), np.array(right), **LENS, distortion=DISTORTION)[0]


@pytest.mark.slow
@pytest.mark.parametrize("pose", POSES)
def test_counted_light_agrees_with_thin_rays(make_layers: MakeLayers, pinhole: Sensor, pose: Pose) -> None:
    rng = np.random.default_rng(11)
    layers = make_layers([900.0, 1300.0], [0.4, 0.4], no_return=0.2, size=3, stderr=10.0)
    layers.range[..., :2] += rng.uniform(-150, 150, (3, 3, 2))
    layers.weight[..., :2] *= rng.uniform(0, 1, (3, 3, 2))
    beams = beams_from_layers(layers, pinhole)
    ahead = np.floor((pose.position() + 1100 * pose.rotation()[:, 2]) / 40).astype(int) - 7
    grid = VoxelGrid(cell_mm=40.0, first=(int(ahead[0]), int(ahead[1]), int(ahead[2])), shape=(14, 14, 14))
    light = count_light(beams, pose, grid, workers=2)
    stopped, passed = naive.light(beams, pose, grid, rays=sized(12, 6), direction=_direction)
    scale = passed.max()
    assert stopped.max() > 0.1 * scale
    assert np.abs(light.passed - passed).mean() < 0.02 * scale
    assert np.abs(light.stopped - stopped).mean() < 0.02 * scale
    assert np.abs(light.passed - passed).max() < 0.25 * scale
    assert light.passed.sum() == pytest.approx(passed.sum(), rel=0.08)
    assert light.stopped.sum() == pytest.approx(stopped.sum(), rel=0.08)


@pytest.mark.parametrize("pose", POSES)
def test_grid_contains_all_ranges_of_the_beams(make_layers: MakeLayers, pinhole: Sensor, pose: Pose) -> None:
    beams = beams_from_layers(make_layers([1000.0], [0.5], no_return=0.5, size=3), pinhole)
    grid = plan_grid(beams, pose, cell_mm=50.0)
    row, col = np.random.default_rng(3).uniform(-0.5, 2.5, (2, 300))
    ends = 5980 * lens.beams(row, col, **LENS, distortion=DISTORTION)[0]
    ends = ends @ pose.rotation().T + pose.position()
    assert (ends >= grid.origin_mm).all()
    assert (ends <= grid.origin_mm + np.array(grid.shape) * 50).all()


def test_outlines_hold_every_ray_that_meets_the_cell() -> None:
    """A wide lens of 110 degrees: rays through cells at random, near and far, lie in the cells' rectangles."""
    optics = Pinhole(fx=28.0, fy=28.0, cx=39.5, cy=29.5, distortion=(-0.08, 0.006, 0.0, 0.0))
    shape, rng = (60, 80), np.random.default_rng(7)
    pose = Pose(yaw_deg=20.0, pitch_deg=10.0)
    cone = image_cone(image_nodes(optics, shape))
    row, col = rng.uniform(-0.5, 59.5, 400), rng.uniform(-0.5, 79.5, 400)
    rays = optics.rays(row, col, shape=shape)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ pose.rotation().T
    cell = 60.0
    low = rays * rng.uniform(300, 5000, (400, 1)) - rng.uniform(0, cell, (400, 3))
    found = cell_outlines(optics, shape, low, cell, pose.rotation(), cone)
    slack = 0.02  # of a pixel: an edge bends less than that between its middle and its ends
    assert (found[:, 0] - slack <= col + 0.5).all()
    assert (found[:, 1] + slack >= col + 0.5).all()
    assert (found[:, 2] - slack <= row + 0.5).all()
    assert (found[:, 3] + slack >= row + 0.5).all()
    behind = cell_outlines(optics, shape, -low - cell, cell, pose.rotation(), cone)
    assert (behind[:, 0] > behind[:, 1]).all()
    assert (cell_outlines(optics, shape, np.full((1, 3), -30.0), cell, pose.rotation(), cone)[:, 0] == 1).all()


def test_pixels_of_a_pinhole_have_no_one_size(make_layers: MakeLayers, pinhole: Sensor) -> None:
    beams = beams_from_layers(make_layers([1000.0], [1.0], size=3), pinhole)
    with pytest.raises(TypeError, match="its pixels differ in size"):
        _ = beams.pixel_size_rad
    depth = (beams.far_mm - beams.near_mm)[..., 0]
    expected = 1000 * pixel_extent_rad(Pinhole(**LENS, distortion=DISTORTION), (3, 3)) * math.tan(math.radians(60))
    np.testing.assert_allclose(depth, expected, rtol=1e-12)
