import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.alike import MakeLayers

from tofmix.mapping.beams import beams_from_layers
from tofmix.mapping.grid import Pose, VoxelGrid, lattice_span, plan_grid
from tofmix.sensor import Sensor


@given(st.integers(-500, 500), st.integers(1, 300), st.sampled_from([0.1, 1.0, 37.5, 50.0]))
def test_ends_on_whole_cells_stay_there(first: int, count: int, cell: float) -> None:
    assert lattice_span((first * cell, (first + count) * cell), cell) == (first, first + count)


def test_ends_between_cells_are_rounded_outward() -> None:
    assert lattice_span((-120.0, 101.0), 50.0) == (-3, 3)
    for bad in ((1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.inf)):
        with pytest.raises(ValueError, match="first must be below"):
            lattice_span(bad, 50.0)


@pytest.mark.parametrize("pose", [Pose(), Pose(x_mm=1234.0, y_mm=-77.0, yaw_deg=130.0, pitch_deg=20.0)])
def test_grid_contains_all_ranges_of_the_beams(make_layers: MakeLayers, camera: Sensor, pose: Pose) -> None:
    beams = beams_from_layers(make_layers([1000.0], [0.5], no_return=0.5), camera)
    grid = plan_grid(beams, pose, cell_mm=50.0)
    rng = np.random.default_rng(3)
    az, el = rng.uniform(-1, 1, (2, 500)) * math.radians(4)
    ends = 5980 * np.stack([np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)])
    ends = (pose.rotation() @ ends).T + pose.position()
    assert (ends >= grid.origin_mm).all()
    assert (ends <= grid.origin_mm + np.array(grid.shape) * 50).all()
    for axis in range(3):
        assert grid.origin_mm[axis] <= pose.position()[axis] <= grid.centres_mm(axis)[-1] + 25


def test_band_of_heights_sets_the_height_of_the_grid(make_layers: MakeLayers, camera: Sensor) -> None:
    beams = beams_from_layers(make_layers([1000.0], [1.0]), camera)
    grid = plan_grid(beams, Pose(), cell_mm=50.0, height_mm=(-130.0, 100.0))
    assert (grid.first[2], grid.shape[2]) == (-3, 5)
    assert grid.levels((-100.0, 0.0)) == slice(1, 3)
    with pytest.raises(ValueError, match="not all within the grid"):
        grid.levels((-200.0, 0.0))
    higher = grid.with_levels((0.0, 300.0))
    assert (higher.first, higher.shape) == ((*grid.first[:2], -3), (*grid.shape[:2], 9))


def test_grid_refuses_invalid_cells_and_heights(make_layers: MakeLayers, camera: Sensor) -> None:
    beams = beams_from_layers(make_layers([1000.0], [0.5], no_return=0.5), camera)
    with pytest.raises(ValueError, match="take larger cells"):
        plan_grid(beams, Pose(), cell_mm=1.0)
    for bad in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="cell_mm"):
            plan_grid(beams, Pose(), cell_mm=bad)
        with pytest.raises(ValueError, match="cell_mm"):
            VoxelGrid(cell_mm=bad, first=(0, 0, 0), shape=(1, 1, 1))
    with pytest.raises(ValueError, match="holds no cell"):
        VoxelGrid(cell_mm=1.0, first=(0, 0, 0), shape=(1, 0, 1))
