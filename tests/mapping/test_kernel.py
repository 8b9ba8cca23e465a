"""Light counted by the kernel: closed forms on the axis, a brute-force twin, and no double counting."""

import math

import numpy as np
import pytest
from support import naive
from support.alike import MakeLayers

from tofmix.mapping.beams import Beams, beams_from_layers
from tofmix.mapping.grid import Pose, VoxelGrid, plan_grid
from tofmix.mapping.occupancy import LightCounts, count_light
from tofmix.sensor import Sensor

PIXEL = math.radians(1.0)
COLUMN = VoxelGrid(cell_mm=20.0, first=(5, 0, 0), shape=(345, 1, 1))
"""Cells of 20 mm along the axis, one corner of each on it, from 100 to 7000 mm."""


def along_the_axis(beams: Beams) -> tuple[LightCounts, np.ndarray, np.ndarray]:
    """Light in the column, the range of each cell's middle, and the samples that cross a cell if all do."""
    light = count_light(beams, Pose(), COLUMN)
    middle = COLUMN.centres_mm(0)
    return light, middle, 100 * (np.arctan(20.0 / (middle - 10.0)) / PIXEL) ** 2  # what meets the nearer face


def test_one_surface_stops_and_passes_light_by_its_share(make_layers: MakeLayers, camera: Sensor) -> None:
    light, middle, full = along_the_axis(beams_from_layers(make_layers([3000.0], [1.0]), camera))
    stopped, passed = light.stopped.ravel(), light.passed.ravel()
    seen = full < 100 * 16  # nearer cells are larger than the quarter of the image that they lie in
    before, behind = (middle < 2940) & seen, middle > 3080
    np.testing.assert_allclose(passed[before], full[before], rtol=0.01)
    assert not stopped[before].any()
    assert not stopped[behind].any()
    assert not passed[behind].any()
    at = np.flatnonzero(np.abs(middle - 2990) < 5)[0]
    assert stopped[at] == pytest.approx(full[at], rel=0.01)
    assert passed[at] == 0
    assert light.probability.ravel()[at] == 1


def test_light_passes_a_partial_surface_by_its_share(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([2000.0, 4000.0], [0.3, 0.7])
    light, middle, full = along_the_axis(beams_from_layers(layers, camera))
    stopped, passed = light.stopped.ravel() / full, light.passed.ravel() / full
    at = {place: np.flatnonzero(np.abs(middle - place) < 5)[0] for place in (1490, 1990, 3010, 3990, 4510)}
    expected = {1490: (0, 1), 1990: (0.3, 0.7), 3010: (0, 0.7), 3990: (0.7, 0), 4510: (0, 0)}
    for place, (stops, passes) in expected.items():
        assert stopped[at[place]] == pytest.approx(stops, rel=0.01)
        assert passed[at[place]] == pytest.approx(passes, rel=0.01)


def test_no_return_frees_space_up_to_where_a_surface_would_be_taken_for_it(
    make_layers: MakeLayers, camera: Sensor
) -> None:
    light, middle, full = along_the_axis(beams_from_layers(make_layers([], [], no_return=1.0), camera))
    passed = light.passed.ravel()
    free = (middle > 700) & (middle < 5960)
    np.testing.assert_allclose(passed[free], full[free], rtol=0.01)
    assert not passed[middle > 5981].any()
    assert not light.stopped.any()


def test_uncertain_range_frees_no_space_before_the_surface(make_layers: MakeLayers, camera: Sensor) -> None:
    light, middle, _ = along_the_axis(beams_from_layers(make_layers([3000.0], [1.0], stderr=100.0), camera))
    silent = (middle > 2800) & (middle < 2950)
    assert not (light.passed + light.stopped).ravel()[silent].any()
    assert (light.passed.ravel()[(middle > 700) & (middle < 2700)] > 0).all()


@pytest.mark.parametrize("cell", [15.0, 60.0, 240.0])
def test_a_sample_counts_once_however_large_the_cells(make_layers: MakeLayers, camera: Sensor, cell: float) -> None:
    beams = beams_from_layers(make_layers([5000.0], [1.0]), camera)
    slab = VoxelGrid(
        cell_mm=cell,
        first=(round(2400 / cell), -round(480 / cell), -round(480 / cell)),
        shape=(1, 2 * round(480 / cell), 2 * round(480 / cell)),
    )
    total = count_light(beams, Pose(), slab).passed.sum()
    # Oblique rays cross more than one cell of the slab: a few per cent in a field of view of 8 degrees.
    assert total * 1.02 >= 100 * 64
    assert total <= 1.12 * 100 * 64


@pytest.mark.parametrize(
    "pose", [Pose(), Pose(x_mm=333.0, y_mm=-250.0, yaw_deg=35.0, pitch_deg=-20.0), Pose(yaw_deg=180.0, pitch_deg=65.0)]
)
def test_the_kernel_agrees_with_its_naive_twin(make_layers: MakeLayers, camera: Sensor, pose: Pose) -> None:
    rng = np.random.default_rng(11)
    layers = make_layers([900.0, 1300.0], [0.4, 0.4], no_return=0.2, size=3, stderr=10.0)
    layers.range[..., :2] += rng.uniform(-150, 150, (3, 3, 2))
    layers.weight[..., :2] *= rng.uniform(0, 1, (3, 3, 2))
    beams = beams_from_layers(layers, camera)
    ahead = np.floor((pose.position() + 1100 * pose.rotation()[:, 2]) / 40).astype(int) - 7
    first = int(ahead[0]), int(ahead[1]), int(ahead[2])
    grid = VoxelGrid(cell_mm=40.0, first=first, shape=(14, 14, 14))
    light = count_light(beams, pose, grid)
    stopped, passed = naive.light(beams, pose, grid, rays=12)
    scale = passed.max()
    assert stopped.max() > 0.1 * scale
    # Both sample the same cones, each with rays of its own: a cell's outline is met to about a sixteenth.
    assert np.abs(light.passed - passed).mean() < 0.02 * scale
    assert np.abs(light.stopped - stopped).mean() < 0.02 * scale
    assert np.abs(light.passed - passed).max() < 0.2 * scale
    assert light.passed.sum() == pytest.approx(passed.sum(), rel=0.08)
    assert light.stopped.sum() == pytest.approx(stopped.sum(), rel=0.08)


def test_threads_change_no_value(make_layers: MakeLayers, camera: Sensor) -> None:
    beams = beams_from_layers(make_layers([900.0], [0.8], no_return=0.2), camera)
    grid = plan_grid(beams, Pose(pitch_deg=3.0), cell_mm=60.0)
    done: list[int] = []
    one, three = (count_light(beams, Pose(pitch_deg=3.0), grid, workers=n, progress=done.append) for n in (1, 3))
    np.testing.assert_array_equal(one.stopped, three.stopped)
    np.testing.assert_array_equal(one.passed, three.passed)
    assert sum(done) == 2 * grid.size


def test_a_camera_that_looks_all_around_sees_all_around(make_layers: MakeLayers) -> None:
    camera = Sensor(name="round", range_max_mm=3000.0, fov_horizontal_deg=360.0, fov_vertical_deg=40.0)
    beams = beams_from_layers(make_layers([1000.0], [1.0], size=90), camera)
    grid = plan_grid(beams, Pose(), cell_mm=100.0, height_mm=(0.0, 100.0))
    light = count_light(beams, Pose(), grid)
    x, y = np.meshgrid(grid.centres_mm(0), grid.centres_mm(1), indexing="ij")
    around = np.hypot(x, y)
    ring, inside = np.abs(around - 1000) < 30, (around > 200) & (around < 850)
    assert (light.stopped[..., 0][ring] > 0).all()
    assert (light.passed[..., 0][inside] > 0).all()
    # The cells in which the camera stands tell nothing.
    assert not light.passed[..., 0][around < 80].any()
