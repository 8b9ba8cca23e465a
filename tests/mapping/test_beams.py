"""Beams of layers and averages, poses and grids."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.alike import MakeLayers

from tofmix.mapping.beams import CLEAR_STDERRS, MAX_INCIDENCE_DEG, beams_from_layers, beams_from_ranges, count_samples
from tofmix.mapping.grid import Pose, VoxelGrid, lattice_span, plan_grid
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor


def test_every_layer_is_a_hit_with_its_share(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0, 2000.0], [0.3, 0.6], no_return=0.1, samples=50, stderr=7.0)
    beams = beams_from_layers(layers, camera)
    np.testing.assert_allclose(beams.samples[3, 4], [15, 30, 0], rtol=1e-6)
    np.testing.assert_allclose(beams.samples_no_return, 5, rtol=1e-6)
    assert beams.free_to_mm == 6000 - 2 * 10
    half = 1000 * math.radians(1.0) / 2 * math.tan(math.radians(MAX_INCIDENCE_DEG))
    assert beams.near_mm[0, 0, 0] == pytest.approx(1000 - half)
    assert beams.far_mm[0, 0, 0] == pytest.approx(1000 + half)
    assert beams.clear_to_mm[0, 0, 0] == pytest.approx(1000 - half - CLEAR_STDERRS * 7)
    assert np.isnan(beams.near_mm[..., 2]).all()
    assert beams.reach_mm == beams.free_to_mm


def test_improbable_layers_and_ends_without_a_limit_are_no_hits(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0], [0.9], probability=0.8, no_return=0.1)
    assert beams_from_layers(layers, camera).samples.sum() == 0
    assert beams_from_layers(layers, camera, min_probability=0.8).samples.sum() > 0
    with pytest.raises(ValueError, match=r"min_probability: 1\.1"):
        beams_from_layers(layers, camera, min_probability=1.1)
    layers = make_layers([1000.0], [1.0], no_return=math.nan)
    beams = beams_from_layers(layers, replace(camera, range_max_mm=None))
    assert beams.samples_no_return.sum() == 0
    assert beams.reach_mm == beams.far_mm[0, 0, 0]


def test_a_mean_is_one_hit_or_no_return(camera: Sensor) -> None:
    beams = beams_from_ranges([[1500.0, 5985.0, math.nan]], [[25, 25, 0]], camera)
    np.testing.assert_array_equal(beams.samples[0, :, 0], [25, 0, 0])
    np.testing.assert_array_equal(beams.samples_no_return[0], [0, 25, 0])
    assert beams.near_mm[0, 0, 0] - beams.clear_to_mm[0, 0, 0] == pytest.approx(CLEAR_STDERRS * 10 / 5)


def test_beams_refuse_invalid_shapes_and_probabilities(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0], [1.0])
    with pytest.raises(ValueError, match="no field of view"):
        beams_from_layers(layers, replace(camera, fov_vertical_deg=None))
    with pytest.raises(ValueError, match="expected an image"):
        beams_from_layers(layers.reshaped((64,)), camera)
    with pytest.raises(ValueError, match="does not match range"):
        beams_from_ranges([[1.0, 2.0]], [[1.0]], camera)


def test_uncertain_range_lowers_the_probability_of_a_hit(make_layers: MakeLayers, camera: Sensor) -> None:
    layers = make_layers([1000.0, 2000.0], [0.5, 0.4], stderr=50.0)
    layers.range_stderr[..., 1] = 0.0
    beams = beams_from_layers(layers, camera)
    within = beams.probability_within(50.0)[2, 3]
    np.testing.assert_allclose(within, [0.682689, 1.0, 0.0], atol=1e-5)  # one standard error, none, no surface
    assert (beams.probability_within(5.0)[..., 0] < 0.1).all()


def test_valid_samples_are_counted_in_the_requested_frames() -> None:
    rng = np.random.default_rng(4)
    samples = np.where(rng.random((9, 3, 2)) < 0.3, np.nan, 1000.0)
    recording = ArrayRecording(samples, Sensor(name="x"))
    for block in (7, 1 << 21):
        counted = count_samples(recording, start=2, stop=8, block_samples=block)
        np.testing.assert_array_equal(counted, np.isfinite(samples[2:8]).sum(axis=0))
    with pytest.raises(ValueError, match="the recording has 9"):
        count_samples(recording, start=2, stop=10)


def test_ends_are_rounded_outward_and_heights_set_the_grid(make_layers: MakeLayers, camera: Sensor) -> None:
    assert lattice_span((-120.0, 101.0), 50.0) == (-3, 3)
    for bad in ((1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.inf)):
        with pytest.raises(ValueError, match="first must be below"):
            lattice_span(bad, 50.0)
    beams = beams_from_layers(make_layers([1000.0], [1.0]), camera)
    grid = plan_grid(beams, Pose(), cell_mm=50.0, height_mm=(-130.0, 100.0))
    assert (grid.first[2], grid.shape[2]) == (-3, 5)
    assert grid.levels((-100.0, 0.0)) == slice(1, 3)
    with pytest.raises(ValueError, match="not all within the grid"):
        grid.levels((-200.0, 0.0))
    higher = grid.with_levels((0.0, 300.0))
    assert (higher.first, higher.shape) == ((*grid.first[:2], -3), (*grid.shape[:2], 9))


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


@pytest.mark.parametrize("pitch", [-80.0, 0.0, 33.0])
@pytest.mark.parametrize("yaw", [-200.0, 0.0, 71.0])
def test_the_axes_are_right_handed_and_orthonormal(yaw: float, pitch: float) -> None:
    rotation = Pose(yaw_deg=yaw, pitch_deg=pitch).rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize(
    "bad", [{"x_mm": math.nan}, {"y_mm": 1e9}, {"yaw_deg": math.inf}, {"pitch_deg": 90.0}, {"pitch_deg": math.nan}]
)
def test_refusals_name_the_key(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        Pose(**bad)
