"""Measured scenes: layers keep their shares, surfaces move their ranges, and errors are those of the samples."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.cameras import camera_of

from tofmix.layers import Layers, layer_fields
from tofmix.optics.projection import beam_directions_of
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.one.coordinates import Unnamed
from tofmix.simulation.casting.cast import by_neighbours, cast_scene
from tofmix.simulation.effects.motion import Motion
from tofmix.simulation.exposure import equation_1
from tofmix.simulation.measured_scene import OWN_ERROR, measured_scene
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.render import render_blocks

ROWS, COLS, FRAMES = 6, 8, 50
SENSOR = camera_of(
    [1000.0], [4.0], reach_mm=(0.0, 4000.0), fov_deg=(40.0, 30.0), integration_time_ms=1.0, outlier_probability=0.0
)


def _layers() -> tuple[Layers, np.ndarray]:
    """A wall that is 1000 mm ahead, before it an object in the left columns with a share of 0.4; and their numbers."""
    layers = Layers.empty((ROWS, COLS), 2, layer_fields(SENSOR))
    assert SENSOR.optics is not None
    beams = beam_directions_of(SENSOR.optics, (ROWS, COLS))
    wall = 1000.0 / beams[..., 2]
    numbers = np.full((ROWS, COLS, 2), -1)
    near = np.arange(COLS) < 3
    layers.n_modes[:] = 1 + near
    layers.range[..., 0] = np.where(near, 600.0 / beams[..., 2], wall)
    layers.range[..., 1] = np.where(near, wall, np.nan)
    layers.weight[..., 0] = np.where(near, 0.4, 1.0)
    layers.weight[..., 1] = np.where(near, 0.6, np.nan)
    layers.sigma[..., 0] = 8.0
    layers.sigma[..., 1] = np.where(near, 4.0, np.nan)
    layers.weight_no_return[:] = 0.0
    layers.weight_outlier[:] = 0.0
    layers.n_samples[:] = FRAMES
    if layers.invalid_share is not None:
        layers.invalid_share[:] = 0.0
    numbers[..., 0] = np.where(near, 1, 0)
    numbers[..., 1] = np.where(near, 0, -1)
    return layers, numbers


def _model() -> Model:
    layers, numbers = _layers()
    camera, scene = measured_scene(layers, SENSOR, numbers, frames=FRAMES)
    return Model(sensor=camera, surfaces=scene.surfaces, recording=RecordingSettings(frames=400, seed=3), scene=scene)


def test_cast_is_what_was_measured() -> None:
    truth = cast_scene(_model())
    layers, numbers = _layers()
    np.testing.assert_allclose(truth.range_true, layers.range, rtol=1e-6)
    np.testing.assert_allclose(truth.weight_true, layers.weight, rtol=1e-6)
    assert np.array_equal(truth.surface, numbers)


def test_planes_are_those_of_the_layers() -> None:
    wall, box = _model().surfaces
    assert (wall.name, box.name) == ("surface 0", "surface 1")
    for surface, distance_mm in ((wall, 1000.0), (box, 600.0)):
        normal = surface.rotation()[:, 2]
        assert abs(normal[2]) == pytest.approx(1.0, abs=1e-6)
        assert float(normal @ surface.center_mm) == pytest.approx(distance_mm, rel=1e-5)


def test_motion_moves_ranges_along_the_beams_and_keeps_shares() -> None:
    model = replace(_model(), effects=(Motion(surface="surface 0", velocity_mm_s=50.0),))
    before, after = cast_scene(model, time_s=0.0), cast_scene(model, time_s=2.0)
    beams = beam_directions_of(model.sensor.optics, (ROWS, COLS))
    moved = np.nan_to_num(after.range_true - before.range_true)
    expected = np.where(before.surface == 0, (100.0 / beams[..., 2])[..., None], 0.0)
    np.testing.assert_allclose(moved, expected, atol=1e-3)
    np.testing.assert_array_equal(after.weight_true, before.weight_true)


def test_samples_have_the_shares_means_and_widths_that_were_measured() -> None:
    model = _model()
    truth = cast_scene(model)
    (block,) = render_blocks(model, truth, n_frames=400, seed=3, block_frames=400)
    x = block.range_mm.astype(np.float64)
    near = x[:, :, :3] < 800.0
    assert near.mean() == pytest.approx(0.4, abs=4 * math.sqrt(0.24 / near.size))
    wall = x[:, :, 3:] - truth.range_true[:, 3:, 0]
    assert wall.std() == pytest.approx(8.0, rel=0.05)
    assert wall.mean() == pytest.approx(0.0, abs=0.3)


def test_prediction_has_the_widths_of_layers() -> None:
    model = _model()
    sigma = equation_1(cast_scene(model), model).sigma_mm.reshape(3, ROWS, COLS)
    np.testing.assert_allclose(sigma[0], 8.0, rtol=1e-6)
    np.testing.assert_allclose(sigma[1, :, :3], 4.0, rtol=1e-6)


def test_lost_samples_are_simulated_by_their_share() -> None:
    layers, numbers = _layers()
    layers = replace(layers, invalid_share=np.full((ROWS, COLS), 0.3, np.float32))
    camera, scene = measured_scene(layers, SENSOR, numbers, frames=FRAMES)
    model = Model(sensor=camera, surfaces=scene.surfaces, scene=scene)
    (block,) = render_blocks(model, cast_scene(model), n_frames=200, seed=1, block_frames=200)
    assert (block.range_mm == 0).mean() == pytest.approx(0.3, abs=0.02)


def test_all_pixels_have_one_share_of_lost_samples_unless_counts_contradict_it() -> None:
    layers, numbers = _layers()
    never = np.zeros((ROWS, COLS), np.float32)
    _, scene = measured_scene(replace(layers, invalid_share=never), SENSOR, numbers, frames=FRAMES)
    assert (scene.lost == 0).all()
    assert scene.lost_worth > FRAMES * ROWS * COLS
    often = never.copy()
    often[0] = 0.5
    _, scene = measured_scene(replace(layers, invalid_share=often), SENSOR, numbers, frames=FRAMES)
    assert scene.lost[0].min() > 0.4
    assert scene.lost[1:].max() < 0.05


def test_a_share_of_lost_samples_is_that_of_all_samples_random_values_too() -> None:
    """A pixel that is left out returns nothing, however many random values its camera returns."""
    model = _model()
    assert model.scene is not None
    lost = np.full((ROWS, COLS), 0.25)
    lost[0, 0] = 1.0
    noisy = replace(model.sensor, noise=replace(model.sensor.noise, background=np.array(0.2)))
    lossy = replace(model, sensor=noisy, scene=replace(model.scene, lost=lost))
    predicted = equation_1(cast_scene(lossy), lossy)
    np.testing.assert_allclose(predicted.invalid, lost.ravel())
    np.testing.assert_allclose(predicted.weight.sum(axis=0) + predicted.invalid + predicted.outlier, 1.0)
    (block,) = render_blocks(lossy, cast_scene(lossy), n_frames=200, seed=1, block_frames=200)
    samples = block.range_mm
    assert (samples[:, 0, 0] == 0).all()
    count = samples[:, 1:].size
    assert abs((samples[:, 1:] == 0).mean() - 0.25) < 4 * math.sqrt(0.25 * 0.75 / count)


def test_errors_of_means_follow_samples_and_memory() -> None:
    scene = _model().scene
    assert scene is not None
    np.testing.assert_allclose(scene.mean_variance(), 1.0 / FRAMES + OWN_ERROR**2)
    remembering = replace(scene, memory=0.5)
    np.testing.assert_allclose(remembering.mean_variance(), 3.0 / FRAMES + OWN_ERROR**2)
    assert replace(scene, frame_noise=0.5).frame_variance() == pytest.approx(0.25 / FRAMES)


def test_pixels_of_few_samples_are_not_known() -> None:
    layers, numbers = _layers()
    layers.n_samples[0, 0] = 5
    _, scene = measured_scene(layers, SENSOR, numbers, frames=FRAMES)
    assert not scene.known[0, 0]
    assert scene.known.sum() == ROWS * COLS - 1
    assert scene.lost[0, 0] == 1.0


def test_pixels_beside_a_surface_that_they_do_not_see_are_not_compared() -> None:
    scene = _model().scene
    assert scene is not None
    beside = np.zeros((ROWS, COLS), dtype=np.bool_)
    beside[:, 3] = True  # the first column without the box
    np.testing.assert_array_equal(scene.beside_others, beside)
    np.testing.assert_array_equal(scene.compared().lost, np.where(beside, 1.0, scene.lost))
    np.testing.assert_array_equal(scene.compared().share, scene.share)


def test_range_of_neighbours_has_no_error_of_the_pixel_itself() -> None:
    model = _model()
    assert model.scene is not None
    rng = np.random.default_rng(4)
    error = np.where(np.isfinite(model.scene.range_mm), rng.normal(0, 3.0, model.scene.range_mm.shape), np.nan)
    noisy = replace(model.scene, range_mm=model.scene.range_mm + error)
    smooth, apart = by_neighbours(model, noisy)
    measured = smooth.range_mm[..., 0] + apart[0].reshape(ROWS, COLS)
    right = np.s_[:, 3:]  # sees the wall alone
    np.testing.assert_allclose(measured[right], noisy.range_mm[..., 0][right])
    one = replace(noisy, range_mm=noisy.range_mm.copy())
    one.range_mm[2, 5, 0] += 50.0
    again, _ = by_neighbours(model, one)
    assert again.range_mm[2, 5, 0] == pytest.approx(smooth.range_mm[2, 5, 0])
    assert again.range_mm[2, 6, 0] != pytest.approx(smooth.range_mm[2, 6, 0])


def test_law_of_range_moves_with_no_error_of_a_measured_range() -> None:
    """The slope of an offset that goes by range, on a wall whose ranges have errors as large as their spread."""
    model = _model()
    assert model.scene is not None
    rng = np.random.default_rng(5)
    noisy = model.scene.range_mm + np.where(np.isfinite(model.scene.range_mm), rng.normal(0, 20.0, (ROWS, COLS, 2)), 0)
    model = replace(model, scene=replace(model.scene, range_mm=noisy))
    assert model.scene is not None
    scene = Scene(model, np.arange(5.0))
    m = scene.mixture((Unnamed(over_range=1.0, c1_mm=100.0),))
    plain = scene.mixture()
    at = np.arange(ROWS * COLS)
    single = np.flatnonzero((model.scene.surface[..., 1] < 0).ravel())
    np.testing.assert_allclose(plain.mean[0, 0, single], noisy[..., 0].ravel()[single], rtol=1e-6)
    moved = (m.mean - plain.mean)[0, 0, single]
    error = (noisy[..., 0].ravel() - scene.mixture().true_range[0, 0])[single]
    assert at.size > single.size
    assert moved == pytest.approx(0.1 * (m.true_range[0, 0, single] - 2500.0))
    assert error.std() > 10.0


@pytest.mark.parametrize("frames", [20, 40])
def test_widths_of_pixels_have_no_bias_of_their_few_samples(frames: int) -> None:
    """The most likely widths of 20 samples, with their prior, are 3.5 % too small."""
    rng, shape, spread = np.random.default_rng(3), (60, 80), 0.25
    true = rng.normal(0.0, spread, shape)
    samples = rng.standard_normal((frames, *shape)) * np.exp(true)
    square = ((samples - samples.mean(axis=0)) ** 2).sum(axis=0)
    likely = np.zeros(shape)
    for _ in range(30):  # Newton's steps to the top of -n w - S exp(-2 w) / 2 - w^2 / 2 spread^2
        part = square * np.exp(-2 * likely)
        likely += (part - frames - likely / spread**2) / (2 * part + spread**-2)
    layers = Layers.empty(shape, 1, layer_fields(SENSOR))
    layers.n_modes[:], layers.range[:], layers.weight[:] = 1, 1000.0, 1.0
    layers.sigma[..., 0], layers.weight_no_return[:], layers.weight_outlier[:] = 4.0 * np.exp(likely), 0.0, 0.0
    layers.n_samples[:] = frames
    if layers.invalid_share is not None:
        layers.invalid_share[:] = 0.0
    assert SENSOR.noise is not None
    sensor = replace(SENSOR, noise=replace(SENSOR.noise, width_spread=spread))
    scene = measured_scene(layers, sensor, np.zeros((*shape, 1), dtype=np.int64), frames=frames)[1]
    off = np.log(scene.width[..., 0]) - true
    assert abs(off.mean()) < 0.007
    assert off.std() == pytest.approx(np.median(scene.width_error()), rel=0.1)


def test_width_at_rest_has_no_way_of_the_reference() -> None:
    """A surface with sigma 8 mm that went 24 mm along its normal: the variance of the way is 24^2 / 12 on the axis."""
    model = _model()
    times = 0.6 + np.arange(10) / 10  # the reference lasted 1.2 s
    moving = Motion(surface="surface 1", velocity_mm_s=20.0)
    scene = Scene(model, times)
    m, plain = scene.mixture((moving,)), scene.mixture()
    near = plain.surface[0] == 1
    assert plain.sigma[0][near] == pytest.approx(8.0, rel=1e-3)
    way_mm = 24.0 / scene.beams[np.nonzero(near)[1], 2]
    assert m.sigma[0][m.surface[0] == 1] == pytest.approx(np.sqrt(64.0 - way_mm**2 / 12.0), rel=0.01)
    assert m.sigma[0][m.surface[0] == 0] == pytest.approx(plain.sigma[0][plain.surface[0] == 0])
    rest = scene.measured_at_rest((moving,))
    assert rest is not None
    assert model.scene is not None
    own = model.scene.surface == 1
    assert (rest.width / model.scene.width)[own] == pytest.approx(m.sigma[0][m.surface[0] == 1] / 8.0, rel=0.01)
    assert (rest.width / model.scene.width)[model.scene.surface == 0] == pytest.approx(1.0)
