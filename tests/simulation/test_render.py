"""Frames as they are drawn: events against equation (1), integration on board, the same in however many blocks."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from support.effect_bench import BOARDS as THREE_BOARDS

from tofmix.errors import BadInputError
from tofmix.simulation.averaging import exposure_times
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import EventSamples, EventTable, Truth, draw, event_table, frame_generator, stored_range
from tofmix.simulation.model import Model
from tofmix.simulation.render import FrameBlock, recording_sensor, render_blocks
from tofmix.simulation.surface import Surface

Floats = NDArray[np.float64]
MakeModel = Callable[..., Model]
BOARDS = (
    Surface(name="near", center_mm=(-500, 0, 2400), size_mm=(1000, 1000)),
    Surface(name="far", center_mm=(0, 0, 3000), size_mm=(3000, 3000)),
)


def frames(model: Model, n_frames: int, **options: int) -> tuple[NDArray[np.generic], ...]:
    """All frames of a rendering in one."""
    settings: dict[str, Any] = {"seed": 3} | options
    blocks = list(render_blocks(model, cast_scene(model), n_frames=n_frames, **settings))
    return tuple(np.concatenate([getattr(b, name) for b in blocks]) for name in ("range_mm", "amplitude", "time_s"))


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize("options", [{"block_frames": 1}, {"block_frames": 7}, {"block_frames": 1000}, {"threads": 3}])
def test_blocks_and_threads_do_not_matter(make_model: MakeModel, averaged: bool, options: dict[str, int]) -> None:
    model = make_model(*BOARDS)
    for one, other in zip(
        frames(model, 30, averaged=averaged), frames(model, 30, averaged=averaged, **options), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_frames_differ_and_do_not_depend_on_those_that_follow(make_model: MakeModel) -> None:
    model = make_model(*BOARDS)
    for few, many in zip(frames(model, 5), frames(model, 40), strict=True):
        np.testing.assert_array_equal(few, many[:5])
    model = make_model(*BOARDS)
    assert (frames(model, 5)[0] != frames(model, 5, seed=4)[0]).mean() > 0.9
    ranges = frames(make_model(*BOARDS), 50)[0]
    assert len({frame.tobytes() for frame in ranges}) == 50


def test_blocks_follow_each_other(make_model: MakeModel) -> None:
    model = make_model(*BOARDS)
    blocks = list(render_blocks(model, cast_scene(model), n_frames=25, seed=1, block_frames=10))
    assert [(block.start, block.stop) for block in blocks] == [(0, 10), (10, 20), (20, 25)]
    np.testing.assert_allclose(np.concatenate([block.time_s for block in blocks]), np.arange(25) / 25.0)
    for block in blocks:
        assert block.range_mm.shape == block.amplitude.shape == (block.stop - block.start, 9, 11)
        assert [str(a.dtype) for a in (block.range_mm, block.amplitude, block.time_s)] == [
            "uint16",
            "float32",
            "float64",
        ]


@pytest.mark.parametrize("option", ["n_frames", "block_frames", "threads", "seed"])
def test_numbers_below_their_least_are_refused_at_once(make_model: MakeModel, option: str) -> None:
    model = make_model(*BOARDS)
    options: dict[str, Any] = {"n_frames": 1, "seed": 1} | {option: -1}
    with pytest.raises(ValueError, match=f"^{option}: -1 is not at least"):
        render_blocks(model, cast_scene(model), **options)


def test_an_error_in_a_thread_is_raised(make_model: MakeModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise MemoryError

    model = make_model(*BOARDS)
    blocks = render_blocks(model, cast_scene(model), n_frames=4, seed=1, threads=2)
    monkeypatch.setattr("tofmix.simulation.render.stored_range", broken)
    with pytest.raises(MemoryError):
        next(blocks)


Drawn = tuple[Model, Truth, EventTable, list[EventSamples]]
FRAMES = 3000
ALPHA = 1e-3  # one false alarm in a thousand changes of the random stream; a fault is far beyond it


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    """3000 frames of 9 x 11 pixels with one to three surfaces, gaps, and one random value in 20 samples."""
    from tofmix.sensors import load_profile

    sensor = replace(
        load_profile("sr3000"),
        rows=9,
        cols=11,
        fov_vertical_deg=39.0 * 9 / 144,
        fov_horizontal_deg=47.0 * 11 / 176,
        integration_time_ms=1.2,
        outlier_probability=0.05,
    )
    model = Model(sensor=sensor, surfaces=THREE_BOARDS)
    truth = cast_scene(model)
    table = event_table(truth, sensor)
    sigma = table.sigma(sensor.noise_at(1.2))
    return model, truth, table, [draw(table, sigma_mm=sigma, rng=frame_generator(7, k)) for k in range(FRAMES)]


def _cdf(model: Model, truth: Truth, pixel: int, r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Equation (1), integrated by hand from the contract's words."""
    s = model.sensor
    noise = s.noise.scaled((10.0 / 1.2) ** 0.5)
    total = s.outlier_probability * stats.uniform.cdf(r, s.range_min_mm, s.range_max_mm - s.range_min_mm)
    total += truth.weight_no_return.flat[pixel] * stats.norm.cdf(r, s.range_max_mm, noise.sigma(s.range_max_mm))
    row, col = divmod(pixel, s.cols)
    for mu, weight in zip(truth.range_true[row, col], truth.weight_true[row, col], strict=True):
        if not np.isnan(mu):
            total = total + weight * stats.norm.cdf(r, mu, noise.sigma(float(mu)))
    return np.asarray(total)


def test_stored_samples_follow_equation_1_in_every_pixel(drawn: Drawn) -> None:
    """Kolmogorov-Smirnov p-values of all pixels are uniform; rounding to 1 mm is undone by a uniform +-0.5 mm."""
    model, truth, _, frames = drawn
    stored = np.stack([stored_range(frame.range_mm) for frame in frames])
    smooth = stored + np.random.default_rng(0).uniform(-0.5, 0.5, stored.shape)
    p = [stats.kstest(_cdf(model, truth, k, smooth[:, k]), "uniform").pvalue for k in range(stored.shape[1])]
    assert stats.kstest(p, "uniform").pvalue > ALPHA
    assert min(p) > ALPHA / len(p)


def test_events_come_with_their_shares(drawn: Drawn) -> None:
    model, truth, table, frames = drawn
    events = np.stack([frame.event for frame in frames])
    layers = truth.range_true.shape[2]
    shares = np.vstack(
        [
            np.nan_to_num(truth.weight_true).reshape(-1, layers).T,
            truth.weight_no_return.ravel(),
            np.full(events.shape[1], model.sensor.outlier_probability),
        ]
    )
    counts = np.stack([(events == k).sum(axis=0) for k in range(layers + 2)])
    assert not counts[shares == 0].any()
    expected = shares * FRAMES
    tested = expected > 5
    z = (counts - expected)[tested] / np.sqrt((expected * (1 - shares))[tested])
    assert abs(z).max() < 4.5
    assert np.std(z) == pytest.approx(1, abs=0.15)
    assert table.random_value == layers + 1


def test_random_values_are_uniform_over_the_working_range(drawn: Drawn) -> None:
    model, _, table, frames = drawn
    values = np.concatenate([frame.range_mm[frame.event == table.random_value] for frame in frames])
    low, high = model.sensor.range_min_mm, model.sensor.range_max_mm
    assert values.min() >= low
    assert values.max() <= high
    assert stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > ALPHA


def test_amplitude_is_that_of_the_surface_and_zero_without(drawn: Drawn) -> None:
    _, truth, _, frames = drawn
    layers = truth.range_true.shape[2]
    amplitude = truth.amplitude.reshape(-1, layers)
    for frame in frames[:20]:
        seen = frame.event < layers
        pixel = np.flatnonzero(seen)
        np.testing.assert_array_equal(frame.amplitude[seen], amplitude[pixel, frame.event[seen]])
        assert not frame.amplitude[~seen].any()
        assert frame.amplitude.dtype == np.float32


def test_frames_and_pixels_are_independent(drawn: Drawn) -> None:
    model, truth, _, frames = drawn
    stored = np.stack([frame.range_mm for frame in frames])
    z = stats.norm.ppf(np.stack([_cdf(model, truth, k, stored[:, k]) for k in range(stored.shape[1])], axis=1))
    n = z[1:].size
    assert abs((z[1:] * z[:-1]).sum()) / np.sqrt(n) < 4
    assert abs((z[:, 1:] * z[:, :-1]).sum()) / np.sqrt(n) < 4


def test_truth_of_another_camera_is_refused(drawn: Drawn, make_model: MakeModel) -> None:
    _, truth, _, _ = drawn
    with pytest.raises(ValueError, match=r"truth: expected an image of \(3, 11\), got \(9, 11\)"):
        event_table(truth, make_model(rows=3).sensor)


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


def test_amplitude_and_written_sensor_are_those_of_the_time(make_model: MakeModel) -> None:
    model = make_model(BOARD)
    sensor = recording_sensor(model, averaged=True)
    assert sensor.integration_time_ms == 10.0
    assert sensor.noise is not None
    np.testing.assert_allclose(sensor.noise.sigma_mm, model.sensor.noise_at(10.0).sigma_mm)
    assert recording_sensor(model).integration_time_ms == 1.2
    model = make_model(BOARD, outlier_probability=0.0)
    ratio = average(model).amplitude.mean(axis=0) / cast_scene(model).amplitude[..., 0]
    # phase noise of sigma shortens the sum by exp(-sigma^2 / 2), here 0.2 %
    np.testing.assert_allclose(ratio, 10 / 1.2, rtol=0.006)


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
