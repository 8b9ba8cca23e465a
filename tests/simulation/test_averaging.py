"""On-board integration: its time, its noise, and where it puts pixels that see several surfaces."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.simulation.averaging import exposure_times
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.render import FrameBlock, recording_sensor, render_blocks
from tofmix.simulation.surface import Surface

MakeModel = Callable[..., Model]
BOARD = Surface(name="board", center_mm=(0, 0, 3000), size_mm=(3000, 3000), reflectivity=0.8)


def average(model: Model, n_frames: int = 400) -> FrameBlock:
    return next(
        render_blocks(model, cast_scene(model), n_frames=n_frames, seed=5, averaged=True, block_frames=n_frames)
    )


@pytest.mark.parametrize(
    ("tau", "times"), [(1.2, [1.2] * 8 + [0.4]), (2.0, [2.0] * 5), (0.2, [0.2] * 50), (0.1, [0.1] * 100), (9.0, [9, 1])]
)
def test_whole_samples_and_a_rest_fill_the_default_time(make_model: MakeModel, tau: float, times: list[float]) -> None:
    assert exposure_times(make_model(integration_time_ms=tau).sensor) == pytest.approx(times)


@pytest.mark.parametrize("tau", [10.0, 12.0])
def test_integration_times_below_the_averaged_ones_are_refused(make_model: MakeModel, tau: float) -> None:
    model = make_model(BOARD, integration_time_ms=tau)
    with pytest.raises(BadInputError, match=f"integration_time_ms: {tau:g} ms is not below the 10 ms .* --averaged"):
        recording_sensor(model, averaged=True)
    with pytest.raises(BadInputError, match="--averaged"):
        render_blocks(model, cast_scene(model), n_frames=1, seed=1, averaged=True)


def test_a_camera_without_phase_is_refused(make_model: MakeModel) -> None:
    model = make_model(BOARD, modulation_frequency_hz=None)
    assert recording_sensor(model).modulation_frequency_hz is None
    for make in (
        recording_sensor,
        lambda m, averaged: render_blocks(m, cast_scene(m), n_frames=1, seed=1, averaged=averaged),
    ):
        with pytest.raises(BadInputError, match="modulation_frequency_hz: SR-3000 has none, and --averaged acts on"):
            make(model, averaged=True)


def test_a_mean_of_too_many_samples_is_refused(make_model: MakeModel) -> None:
    with pytest.raises(BadInputError, match="more than 1000 times"):
        exposure_times(make_model(integration_time_ms=1e-9).sensor)


def test_the_sensor_written_is_that_of_the_default_time(make_model: MakeModel) -> None:
    model = make_model(BOARD)
    sensor = recording_sensor(model, averaged=True)
    assert sensor.integration_time_ms == 10.0
    assert sensor.noise is not None
    np.testing.assert_allclose(sensor.noise.sigma_mm, model.sensor.noise_at(10.0).sigma_mm)
    assert recording_sensor(model).integration_time_ms == 1.2


@pytest.mark.parametrize(("z", "reflectivity"), [(1000, 0.8), (3000, 0.8), (3000, 0.0), (5000, 0.3)])
def test_a_flat_board_has_the_noise_of_the_default_time(make_model: MakeModel, z: float, reflectivity: float) -> None:
    """Reflectivity 0 is the time-weighted mean of ranges, the others the mean of phasors."""
    board = replace(BOARD, center_mm=(0, 0, z), reflectivity=reflectivity)
    model = make_model(board, outlier_probability=0.0)
    truth = cast_scene(model).range_true[..., 0]
    error = average(model).range_mm - truth
    sigma = model.sensor.noise_at(10.0).sigma(truth.astype(np.float64))
    z_score = error / np.hypot(sigma, 12**-0.5)  # with the rounding to 1 mm
    n = z_score.size
    assert abs(z_score.mean()) < 4 / n**0.5
    assert z_score.var() == pytest.approx(1, abs=4 * (2 / n) ** 0.5)


def test_amplitude_is_in_proportion_to_the_time(make_model: MakeModel) -> None:
    model = make_model(BOARD, outlier_probability=0.0)
    ratio = average(model).amplitude.mean(axis=0) / cast_scene(model).amplitude[..., 0]
    # phase noise of sigma shortens the sum by exp(-sigma^2 / 2), here 0.2 %
    np.testing.assert_allclose(ratio, 10 / 1.2, rtol=0.006)


def test_a_mixed_pixel_lies_between_its_boards(make_model: MakeModel) -> None:
    """The comet tail: with two boards in the beam the mean is at the amplitude-weighted range, where nothing is."""
    near = Surface(name="near", center_mm=(-500, 0, 2400), size_mm=(1000, 1000), reflectivity=0.4)
    model = make_model(near, BOARD, outlier_probability=0.0)
    truth = cast_scene(model)
    mixed = average(model).range_mm[:, :, 5]
    edges = truth.range_true[:, 5]
    assert truth.n_modes[4, 5] == 2
    between = (mixed > edges[:, 0] + 60) & (mixed < edges[:, 1] - 60)
    assert between.mean() > 0.9
    weight = truth.weight_true[:, 5] * truth.amplitude[:, 5]
    expected = (weight * edges).sum(axis=1) / weight.sum(axis=1)
    np.testing.assert_allclose(mixed.mean(axis=0), expected, atol=30)


def test_the_turn_is_that_of_the_mean_range(make_model: MakeModel) -> None:
    """At 7480 mm of a 7495 mm turn half the phases have wrapped; the ranges have not."""
    far = replace(BOARD, center_mm=(0, 0, 7480), size_mm=(9000, 9000))
    ranges = average(make_model(far, range_max_mm=9000.0, outlier_probability=0.0), 100).range_mm
    assert abs(ranges.astype(float) - 7480).max() < 6 * 150
    beyond = replace(far, center_mm=(0, 0, 12_000))
    ranges = average(make_model(beyond, range_max_mm=15_000.0, outlier_probability=0.0), 100).range_mm
    assert ranges.mean() == pytest.approx(12_000, abs=20)


def test_no_return_and_random_values_take_no_part_where_there_is_light(make_model: MakeModel) -> None:
    half = Surface(name="half", center_mm=(-500, 0, 3000), size_mm=(1000, 1000))
    model = make_model(half, outlier_probability=0.05)
    truth = cast_scene(model)
    assert truth.weight_no_return[4, 5] > 0.4
    block = average(model)
    lit = block.amplitude[:, 4, 5] > 0
    assert block.range_mm[lit, 4, 5].mean() == pytest.approx(3000, abs=20)
    assert block.range_mm[:, 4, 10].mean() == pytest.approx(7500 * 0.95 + 4075 * 0.05, abs=60)
    assert not block.amplitude[:, 4, 10].any()
