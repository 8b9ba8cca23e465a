"""Light counted by the kernel, occupancy, and maps from a pinhole's pixels."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import beta
from support import lens, naive
from support.alike import MakeLayers
from support.sizes import sized

from tofmix.arrays import FloatArray
from tofmix.layers import Layers
from tofmix.mapping.beams import Beams, beams_from_layers
from tofmix.mapping.grid import Pose, VoxelGrid, plan_grid
from tofmix.mapping.occupancy import (
    MAX_LOG_ODDS,
    LightCounts,
    State,
    VoxelMap,
    count_light,
    log_odds,
    map_beams,
    project,
)
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import pixel_extent_rad
from tofmix.sensor import Sensor


@given(st.floats(0, 40), st.floats(0, 40), st.floats(0.01, 0.3))
def test_log_odds_are_the_ratio_of_the_two_marginal_likelihoods(stopped: float, passed: float, share: float) -> None:
    def likelihood(low: float, high: float) -> float:
        area, _ = quad(lambda s: s**stopped * (1 - s) ** passed, low, high, epsabs=0, epsrel=1e-10)
        return float(area) / (high - low)

    expected = math.log(likelihood(share, 1.0) / likelihood(0.0, share))
    expected = min(max(expected, -MAX_LOG_ODDS), MAX_LOG_ODDS)
    assert log_odds(stopped, passed, 1.0, min_share=share) == pytest.approx(expected, abs=1e-5)


def test_log_odds_of_hits_and_passes_have_closed_forms() -> None:
    assert log_odds(0.0, 0.0, 0.0) == pytest.approx(0.0, abs=1e-12)
    # All of f samples pass: I = 1 - (1 - m)^(f + 1).
    m, f = 0.05, 20.0
    rest = (1 - m) ** (f + 1)
    assert log_odds(0.0, f, 0.0) == pytest.approx(math.log(rest / (1 - m)) - math.log((1 - rest) / m))
    # As a posterior of the share with even odds.
    odds = float(log_odds(3.0, 30.0, 1.0))
    tail = beta(4.0, 31.0).sf(m)
    assert odds == pytest.approx(math.log(tail / (1 - tail)) - math.log((1 - m) / m))


def test_log_odds_are_bounded_and_lost_light_makes_cells_less_free() -> None:
    assert log_odds(1e5, 0.0, 0.9) == pytest.approx(math.log(9))
    assert log_odds(1e5, 0.0, 1.0) == pytest.approx(MAX_LOG_ODDS)
    assert log_odds(0.0, 1e7, 0.0) == pytest.approx(-MAX_LOG_ODDS)
    assert log_odds(1e5, 0.0, 0.3) == 0  # what is probably not there does not make space free
    with pytest.raises(ValueError, match="min_share: 0"):
        log_odds(0.0, 0.0, 0.0, min_share=0.0)
    free, occupied = float(log_odds(0.0, 100.0, 0.0)), float(log_odds(100.0, 0.0, 1.0))
    assert float(log_odds(0.0, 100.0, 0.0, 0.0)) == free
    p = 1.0 / (1.0 + math.exp(-free))
    half = 0.5 * p + 0.25
    assert float(log_odds(0.0, 100.0, 0.0, 100.0)) == pytest.approx(math.log(half / (1 - half)))
    assert float(log_odds(0.0, 5.0, 0.0, 95.0)) > math.log(0.196 / 0.804)  # unknown
    assert float(log_odds(100.0, 0.0, 1.0, 100.0)) == occupied


def test_wall_behind_a_partial_one_is_occupied_with_free_space_between(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([2000.0, 4000.0], [0.3, 0.5], no_return=0.2, size=40)
    beams = beams_from_layers(layers, camera)
    grid = plan_grid(beams, Pose(), cell_mm=50.0, height_mm=(0.0, 50.0))
    row = project(map_beams(beams, Pose(), grid), (0.0, 50.0)).cells[:, -grid.first[1]]
    states = dict(zip((grid.centres_mm(0) - 25).astype(int), row, strict=True))
    for place, state in (
        (1000, State.FREE),
        (2000, State.OCCUPIED),
        (3000, State.FREE),
        (4000, State.OCCUPIED),
        (5000, State.FREE),
        (6000, State.UNKNOWN),
    ):
        assert states[place] == state, place


def test_column_has_the_worst_state_of_its_voxels() -> None:
    odds = np.array([[[0, 0, 0], [-5, 0, 0], [-5, 5, -5], [0, 0.1, 0]]], dtype=np.float32)
    voxels = VoxelMap(grid=VoxelGrid(cell_mm=100.0, first=(3, -2, 0), shape=(1, 4, 3)), log_odds=odds)
    flat = project(voxels, (0.0, 300.0))
    assert flat.cells.tolist() == [[State.UNKNOWN, State.FREE, State.OCCUPIED, State.UNKNOWN]]
    assert project(voxels, (0.0, 50.0)).cells.tolist() == [[State.UNKNOWN, State.FREE, State.FREE, State.UNKNOWN]]
    assert flat.origin_mm == (300.0, -200.0)
    assert flat.centres_mm(1).tolist() == [-150, -50, 50, 150]
    assert voxels.probability()[0, 0, 0] == 0.5


@pytest.mark.parametrize(("lost", "state"), [(0.0, State.FREE), (0.95, State.UNKNOWN), (1.0, State.UNKNOWN)])
def test_space_before_a_wall_is_free_only_if_its_light_came_back(
    make_layers: MakeLayers, camera: Sensor, lost: float, state: State
) -> None:
    size, dark = 40, (slice(10, 30), slice(10, 30))
    layers = make_layers([4000.0], [1.0], size=size)
    shares = np.zeros((size, size), np.float32)
    shares[dark] = lost
    layers.n_samples[dark] = round(100 * (1 - lost))
    layers = replace(layers, invalid_share=shares)
    beams = beams_from_layers(layers, camera)
    assert beams.samples_lost[20, 20] == pytest.approx(100 * lost)
    assert beams.samples_lost[0, 0] == 0
    grid = plan_grid(beams, Pose(), cell_mm=50.0, height_mm=(0.0, 50.0))
    row = project(map_beams(beams, Pose(), grid), (0.0, 50.0)).cells[:, -grid.first[1]]
    states = dict(zip((grid.centres_mm(0) - 25).astype(int), row, strict=True))
    assert states[2000] == states[3000] == state


PIXEL = math.radians(1.0)
COLUMN = VoxelGrid(cell_mm=20.0, first=(5, 0, 0), shape=(345, 1, 1))
"""Cells of 20 mm along the axis, one corner of each on it, from 100 to 7000 mm."""


def along_the_axis(beams: Beams) -> tuple[LightCounts, np.ndarray, np.ndarray]:
    """Light in the column, the range of each cell's middle, and the samples that cross a cell if all do."""
    light = count_light(beams, Pose(), COLUMN)
    middle = COLUMN.centres_mm(0)
    return light, middle, 100 * (np.arctan(20.0 / (middle - 10.0)) / PIXEL) ** 2  # what meets the nearer face


def test_one_surface_stops_and_a_partial_one_passes_light_by_its_share(make_layers: MakeLayers, camera: Sensor) -> None:
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
    layers = make_layers([2000.0, 4000.0], [0.3, 0.7])
    light, middle, full = along_the_axis(beams_from_layers(layers, camera))
    stopped, passed = light.stopped.ravel() / full, light.passed.ravel() / full
    at = {place: np.flatnonzero(np.abs(middle - place) < 5)[0] for place in (1490, 1990, 3010, 3990, 4510)}
    expected = {1490: (0, 1), 1990: (0.3, 0.7), 3010: (0, 0.7), 3990: (0.7, 0), 4510: (0, 0)}
    for place, (stops, passes) in expected.items():
        assert stopped[at[place]] == pytest.approx(stops, rel=0.01)
        assert passed[at[place]] == pytest.approx(passes, rel=0.01)


def test_free_space_ends_where_a_surface_may_be(make_layers: MakeLayers, camera: Sensor) -> None:
    light, middle, full = along_the_axis(beams_from_layers(make_layers([], [], no_return=1.0), camera))
    passed = light.passed.ravel()
    free = (middle > 700) & (middle < 5960)
    np.testing.assert_allclose(passed[free], full[free], rtol=0.01)
    assert not passed[middle > 5981].any()
    assert not light.stopped.any()
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


POSES = [Pose(), Pose(x_mm=333.0, y_mm=-250.0, yaw_deg=35.0, pitch_deg=-20.0), Pose(yaw_deg=180.0, pitch_deg=65.0)]


def _assert_agrees(layers: Layers, camera: Sensor, pose: Pose, *, most: float, **rays: Any) -> None:  # noqa: ANN401  of the twin
    """Hold the counted light of two boards, somewhat moved, against that of the twin's thin rays."""
    rng = np.random.default_rng(11)
    layers.range[..., :2] += rng.uniform(-150, 150, (3, 3, 2))
    layers.weight[..., :2] *= rng.uniform(0, 1, (3, 3, 2))
    beams = beams_from_layers(layers, camera)
    ahead = np.floor((pose.position() + 1100 * pose.rotation()[:, 2]) / 40).astype(int) - 7
    grid = VoxelGrid(cell_mm=40.0, first=(int(ahead[0]), int(ahead[1]), int(ahead[2])), shape=(14, 14, 14))
    light = count_light(beams, pose, grid, workers=2)
    stopped, passed = naive.light(beams, pose, grid, **rays)
    scale = passed.max()
    assert stopped.max() > 0.1 * scale
    # Both sample the same cones, each with rays of its own: a cell's outline is met to about a sixteenth.
    assert np.abs(light.passed - passed).mean() < 0.02 * scale
    assert np.abs(light.stopped - stopped).mean() < 0.02 * scale
    assert np.abs(light.passed - passed).max() < most * scale
    assert light.passed.sum() == pytest.approx(passed.sum(), rel=0.08)
    assert light.stopped.sum() == pytest.approx(stopped.sum(), rel=0.08)


@pytest.mark.parametrize("pose", POSES)
def test_the_kernel_agrees_with_its_naive_twin(make_layers: MakeLayers, camera: Sensor, pose: Pose) -> None:
    layers = make_layers([900.0, 1300.0], [0.4, 0.4], no_return=0.2, size=3, stderr=10.0)
    _assert_agrees(layers, camera, pose, most=0.2, rays=12)


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


LENS: dict[str, Any] = {"fx": 57.0, "fy": 55.0, "cx": 1.3, "cy": 0.8}
DISTORTION = (-0.2, 0.02, 0.004, -0.003, 0.0)


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
    layers = make_layers([900.0, 1300.0], [0.4, 0.4], no_return=0.2, size=3, stderr=10.0)
    _assert_agrees(layers, pinhole, pose, most=0.25, rays=sized(12, 6), direction=_direction)


@pytest.mark.parametrize("pose", POSES)
def test_grid_contains_all_ranges_of_the_beams(make_layers: MakeLayers, pinhole: Sensor, pose: Pose) -> None:
    beams = beams_from_layers(make_layers([1000.0], [0.5], no_return=0.5, size=3), pinhole)
    grid = plan_grid(beams, pose, cell_mm=50.0)
    row, col = np.random.default_rng(3).uniform(-0.5, 2.5, (2, 300))
    ends = 5980 * lens.beams(row, col, **LENS, distortion=DISTORTION)[0]
    ends = ends @ pose.rotation().T + pose.position()
    assert (ends >= grid.origin_mm).all()
    assert (ends <= grid.origin_mm + np.array(grid.shape) * 50).all()


def test_pixels_of_a_pinhole_have_no_one_size(make_layers: MakeLayers, pinhole: Sensor) -> None:
    beams = beams_from_layers(make_layers([1000.0], [1.0], size=3), pinhole)
    with pytest.raises(TypeError, match="its pixels differ in size"):
        _ = beams.pixel_size_rad
    depth = (beams.far_mm - beams.near_mm)[..., 0]
    expected = 1000 * pixel_extent_rad(Pinhole(**LENS, distortion=DISTORTION), (3, 3)) * math.tan(math.radians(60))
    np.testing.assert_allclose(depth, expected, rtol=1e-12)
