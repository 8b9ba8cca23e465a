"""Equation (1): samples against its distribution, events against their shares, streams against each other."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import EventSamples, EventTable, draw, event_table, frame_generator, stored_range
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface
from tofmix.simulation.truth import Truth

MakeModel = Callable[..., Model]
Drawn = tuple[Model, Truth, EventTable, list[EventSamples]]
FRAMES = 3000
ALPHA = 1e-3  # one false alarm in a thousand changes of the random stream; a fault is far beyond it
SURFACES = (
    Surface(name="near", center_mm=(-490, 0, 2400), size_mm=(1000, 80), pitch_deg=10),
    Surface(name="middle", center_mm=(512, 0, 3600), size_mm=(1000, 100), reflectivity=0.5),
    Surface(name="far", center_mm=(0, -250, 4800), size_mm=(900, 500)),
)


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
    model = Model(sensor=sensor, surfaces=SURFACES)
    truth = cast_scene(model)
    table = event_table(truth, sensor)
    sigma = table.sigma(sensor.noise_at(1.2))
    return model, truth, table, [draw(table, sigma_mm=sigma, rng=frame_generator(7, k)) for k in range(FRAMES)]


def test_the_scene_of_this_module_has_pixels_of_all_kinds(drawn: Drawn) -> None:
    _, truth, _, _ = drawn
    assert set(np.unique(truth.n_modes)) == {0, 1, 2, 3}
    assert ((truth.weight_no_return > 0.05) & (truth.n_modes > 0)).any()


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


def test_a_pixel_without_a_gap_never_lacks_a_return(three_boards: tuple[Model, Truth]) -> None:
    """Shares are float32; what rounding leaves must not become a no-return."""
    model, truth = three_boards
    threshold = event_table(truth, model.sensor).threshold
    full = (truth.weight_no_return == 0).ravel()
    np.testing.assert_array_equal(threshold[-2, full], threshold[-1, full])
    assert (np.diff(threshold, axis=0) >= 0).all()


def test_streams_of_frames_and_seeds_differ() -> None:
    draws = {frame_generator(seed, frame).random() for seed in range(20) for frame in range(20)}
    assert len(draws) == 400
    assert frame_generator(3, 4).random() == frame_generator(3, 4).random()


def test_stored_range_is_the_nearest_whole_mm_within_its_bounds() -> None:
    stored = stored_range(np.array([-50.0, 0.2, 1.4, 1.6, 2400.5001, 65_533.6, 1e9]))
    np.testing.assert_array_equal(stored, [1, 1, 1, 2, 2401, 65_534, 65_534])
    assert stored.dtype == np.uint16


def test_truth_of_another_camera_is_refused(drawn: Drawn, make_model: MakeModel) -> None:
    _, truth, _, _ = drawn
    with pytest.raises(ValueError, match=r"truth: expected an image of \(3, 11\), got \(9, 11\)"):
        event_table(truth, make_model(rows=3).sensor)
