"""Recordings in memory, windows, cells, the circle of ranges, and filters over time."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.filtered import averaged_up_to

from tofmix.circle import circular_noise, cut_between, fold, has_no_return, open_at
from tofmix.grid import plan_grid, plan_windows
from tofmix.io.sensor_group import read_sensor, write_sensor
from tofmix.recording import ArrayRecording, FrameSpan, independent_samples
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.temporal_filter import (
    ApartMedians,
    AveragedMedians,
    ExponentialAverage,
    RunningMean,
    RunningMedian,
    TemporalFilter,
    make_filter,
)


def test_array_recording_copies_samples_and_stores_invalid_as_nan(sensor: Sensor) -> None:
    samples = np.array([[[1.0, np.inf]], [[-np.inf, np.nan]]])
    recording = ArrayRecording(samples, sensor)
    samples[:] = 5
    assert recording.shape == (2, 1, 2)
    assert recording.sensor is sensor
    np.testing.assert_array_equal(recording.read_range(slice(None), slice(None)), [[[1, np.nan]], [[np.nan, np.nan]]])
    np.testing.assert_array_equal(recording.read_range(slice(1, 2), slice(0, 1)), [[[np.nan, np.nan]]])


@pytest.mark.parametrize("shape", [(3, 4), (0, 2, 2), (1, 2, 3, 4)])
def test_other_shapes_are_refused(shape: tuple[int, ...], sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="range: expected"):
        ArrayRecording(np.zeros(shape), sensor)


def test_a_span_of_frames_is_a_recording_of_its_own() -> None:
    samples = np.arange(10 * 2 * 3, dtype=np.float32).reshape(10, 2, 3)
    span = FrameSpan(ArrayRecording(samples, Sensor(name="x")), 4, 9)
    assert span.shape == (5, 2, 3)
    assert span.row_step == 1
    assert span.sensor.name == "x"
    for frames in (slice(None), slice(1, 3), slice(0, 99)):
        np.testing.assert_array_equal(span.read_range(frames, slice(1, 2)), samples[4:9][frames, 1:2])
    for start, stop in ((-1, 3), (3, 3), (0, 11)):
        with pytest.raises(ValueError, match="the recording has 10"):
            FrameSpan(ArrayRecording(samples, Sensor(name="x")), start, stop)


@given(n=st.integers(1, 60), window=st.integers(1, 60), stride=st.integers(1, 70))
def test_windows_equal_brute_force(n: int, window: int, stride: int) -> None:
    starts = [s for s in range(0, n, stride) if s + window <= n]
    if not starts:
        with pytest.raises(ValueError, match="longer than"):
            plan_windows(n, window=window, stride=stride)
        return
    plan = plan_windows(n, window=window, stride=stride)
    assert [plan.start(k) for k in range(plan.count)] == starts
    assert plan.frames_left_out == n - (starts[-1] + window)
    assert plan.stop(0) == window


def test_cells_hold_the_frames_of_their_windows_and_stay_small() -> None:
    plan = plan_windows(17)
    assert (plan.count, plan.length, plan.frames_left_out) == (1, 17, 0)
    assert plan_windows(17, window=5).stride == 5
    # Samples, not pixels, take the memory.
    grid = plan_grid(plan_windows(20_000), (144, 176), row_step=8)
    assert grid.step == (1, 1)
    assert plan_grid(plan_windows(10**6, window=10**5), (1, 1)).step[0] == 10
    grid = plan_grid(plan_windows(60, window=20, stride=7), (4, 4))
    assert grid.frames(slice(1, 3)) == slice(7, 34)


@pytest.mark.parametrize(("window", "stride"), [(0, 1), (1, 0), (-3, None)])
def test_windows_below_one_frame_are_refused(window: int, stride: int | None) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        plan_windows(10, window=window, stride=stride)


@given(
    count=st.integers(1, 40),
    stride=st.integers(1, 20),
    length=st.integers(1, 20),
    rows=st.integers(1, 300),
    cols=st.integers(1, 300),
    row_step=st.integers(1, 60),
)
def test_cells_cover_each_window_and_row_once(
    count: int, stride: int, length: int, rows: int, cols: int, row_step: int
) -> None:
    windows = plan_windows((count - 1) * stride + length, window=length, stride=stride)
    grid = plan_grid(windows, (rows, cols), row_step=row_step)
    seen = np.zeros((windows.count, rows), dtype=int)
    for index, cell in enumerate(grid.cells()):
        assert cell.index == index
        seen[cell.windows, cell.rows] += 1
        assert grid.pixels(cell) == cols * np.ones_like(seen)[cell.windows, cell.rows].sum()
    assert np.all(seen == 1)
    assert index + 1 == grid.count == grid.groups * grid.bands


def test_cells_fit_the_image_and_its_chunks() -> None:
    def step(n: int, window: int, image: tuple[int, int], row_step: int = 1) -> tuple[int, int]:
        return plan_grid(plan_windows(n, window=window), image, row_step=row_step).step

    assert step(100, 100, (144, 176)) == (1, 23)
    assert step(100, 100, (144, 176), 8) == (1, 16)
    assert step(100, 100, (144, 176), 144) == (1, 23)
    assert step(500, 100, (1, 3)) == (5, 1)
    assert step(10_000, 1, (1, 1)) == (4096, 1)
    assert step(300, 100, (10, 5000)) == (1, 1)


LENGTH = 7495.0


@given(value=st.floats(-1e6, 1e6), turns=st.integers(-3, 3))
def test_folding_takes_out_whole_turns(*, value: float, turns: int) -> None:
    folded = float(fold(value + turns * LENGTH, LENGTH))
    assert 0 <= folded < LENGTH
    away = abs(folded - float(fold(value, LENGTH)))
    assert min(away, LENGTH - away) < 1e-6


def test_fold_keeps_invalid_values_and_unknown_surfaces_its_cut() -> None:
    np.testing.assert_array_equal(
        fold([np.nan, np.inf, -np.inf, 0.0, -1e-20, LENGTH], LENGTH), [np.nan] * 3 + [0.0] * 3
    )
    assert cut_between([np.nan, 30.0], [20.0, np.nan], 5000.0) == 0.0
    assert cut_between([], [], 5000.0) == 0.0


def test_sigma_is_the_files_outside_the_zone_after_the_fold(sensor: Sensor) -> None:
    assert sensor.noise is not None
    circle = circular_noise(sensor, 5000.0)
    top = float(sensor.noise.sigma(5000.0))
    zone = 4 * top
    at = np.linspace(zone, 5000.0, 50)
    for turn in range(-1, 3):
        np.testing.assert_allclose(circle.sigma(at + turn * 5000.0), sensor.noise.sigma(at), rtol=1e-12)
        # The same on both sides of the fold, over half of what the camera does not see; then linear to the zone's end.
        np.testing.assert_allclose(circle.sigma(turn * 5000.0 + np.array([0.0, 100.0, 200.0])), top)
        middle = float(circle.sigma(turn * 5000.0 + (200.0 + zone) / 2))
        assert middle == pytest.approx((top + float(sensor.noise.sigma(zone))) / 2)


@pytest.mark.parametrize(("range_min", "first", "zone"), [(900.0, 400.0, 900.0), (None, 1100.0, 1100.0)])
def test_the_zone_reaches_to_where_the_camera_begins_to_see(range_min: float | None, first: float, zone: float) -> None:
    noise = NoiseCurve(np.array([first, 5000.0]), np.array([5.0, 50.0]))
    circle = circular_noise(Sensor(name="x", range_min_mm=range_min, noise=noise), 5000.0)
    assert circle.sigma(zone) == pytest.approx(float(noise.sigma(zone)))
    assert circle.sigma(0.9 * zone) > circle.sigma(zone)


def test_a_circle_too_short_for_the_noise_is_refused(sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="shorter than 10 sigma"):
        circular_noise(sensor, 100.0)
    with pytest.raises(ValueError, match="no noise curve"):
        circular_noise(replace(sensor, noise=None), 5000.0)


@pytest.mark.parametrize(("length", "told"), [(6401.0, True), (6399.0, False), (5900.0, False)])
def test_no_return_is_separate_if_two_sigma_of_it_lie_before_the_fold(
    length: float, told: bool, sensor: Sensor
) -> None:
    assert has_no_return(sensor, length) is told  # range_max 6000, sigma 200 there
    assert not has_no_return(replace(sensor, range_max_mm=None), length)


@given(
    st.lists(st.floats(0.0, 4999.0), min_size=1, max_size=5, unique=True).map(sorted),
    st.floats(1.0, 200.0),
    st.floats(0.0, 4999.0),
)
def test_cut_keeps_surfaces_across_the_fold_in_one_piece(places: list[float], sigma: float, turn: float) -> None:
    range_mm = np.sort((np.array(places) + turn) % 5000.0)
    cut = cut_between(range_mm, np.full(len(places), sigma), 5000.0)
    opened = open_at(range_mm, cut, 5000.0)
    assert np.all((opened >= cut) & (opened < cut + 5000.0))
    np.testing.assert_allclose(opened % 5000.0, range_mm, atol=1e-9)
    past, before = range_mm < 4 * sigma, range_mm > 5000.0 - 4 * sigma
    if not np.any(past | before):
        assert cut == 0.0
    elif not np.all(past):  # surfaces past the fold follow all others, and half a gap lies behind the last
        assert opened[past].min(initial=np.inf) > opened[~past].max()
        last = opened[past].max(initial=opened[~past].max())
        first = opened[opened < last].min(initial=last)
        assert cut + 5000.0 - last == pytest.approx(first - cut, abs=1e-6)


def _medians(window: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Running medians (frame, 4) of two surfaces 100 sigma apart, the nearer one with a share; and what is seen."""
    rng = np.random.default_rng(window)
    place = np.where(rng.random((20_000, 4)) < share, 0.0, 100.0)
    samples = (place + rng.standard_normal(place.shape)).astype(np.float32)
    medians = np.median(np.lib.stride_tricks.sliding_window_view(samples, window, axis=0), axis=-1)
    return medians, RunningMedian(float(window)).independent(medians, 0)


@pytest.mark.parametrize("share", [0.4, 0.1])
def test_inverse_of_an_average_gives_the_samples(share: float) -> None:
    samples = np.random.default_rng(1).normal(2000.0, 300.0, (50, 7))
    stored = samples.copy()
    for frame in range(1, 50):
        stored[frame] = share * samples[frame] + (1.0 - share) * stored[frame - 1]
    found = ExponentialAverage(share).independent(stored.astype(np.float32), 0)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], samples[1:], atol=0.01)


def test_inverse_of_an_average_that_takes_jumps_at_once_gives_the_samples() -> None:
    samples = np.random.default_rng(1).normal(2000.0, 300.0, (200, 7))
    stored = averaged_up_to(samples, 0.4, 150.0)
    found = ExponentialAverage(0.4, 150.0).independent(stored.astype(np.float32), 0)
    np.testing.assert_allclose(found[1:], samples[1:], atol=0.01)
    assert 0.2 < (stored == samples)[1:].mean() < 0.9


@pytest.mark.parametrize("window", [3, 5])
def test_shares_and_moments_of_medians_that_are_apart_lead_back_to_the_samples(window: int) -> None:
    median, (medians, _) = ApartMedians(float(window)), _medians(window, 0.3)
    near = medians[::window][medians[::window] < 50.0]
    share = near.size / medians[::window].size
    assert share < 0.25
    assert median.shares_of_samples(np.array([[share, 1.0 - share]]))[0][0, 0] == pytest.approx(0.3, abs=0.01)
    mean, sd = median.moments(0.0, 0.3)
    assert near.mean() == pytest.approx(mean, abs=0.05)
    assert near.std() == pytest.approx(sd, rel=0.05)


@pytest.mark.parametrize(
    "found",
    [
        ExponentialAverage(0.3, 40.0),
        AveragedMedians(ExponentialAverage(0.3, 40.0), 3),
        AveragedMedians(RunningMean(4.0), 5),
    ],
)
def test_composed_filters_are_kept_in_files(found: TemporalFilter, tmp_path: Path) -> None:
    sensor = Sensor(name="camera", temporal_filter=found)
    with h5py.File(tmp_path / "sensor.h5", "w") as file:
        write_sensor(file, sensor, image=(1, 1))
        assert read_sensor(file, tmp_path).temporal_filter == found


def test_rounding_of_stored_values_is_that_of_their_inverse() -> None:
    rounding = np.random.default_rng(3).uniform(-0.5, 0.5, (20_000, 3)).astype(np.float32)
    found = ExponentialAverage(0.1).independent(rounding, 0)
    assert np.nanstd(found) == pytest.approx(ExponentialAverage(0.1).rounding_mm(1.0), rel=0.02)


@pytest.mark.parametrize("sep_mm", [0.0, 300.0])
@pytest.mark.parametrize(("window", "sigma_mm"), [(2, 1.5), (3, 3.0), (8, 4.0)])
def test_samples_of_rounded_means_have_the_noise_of_samples(window: int, sigma_mm: float, sep_mm: float) -> None:
    rng = np.random.default_rng(8)
    place = np.where(rng.random((99 + window, 200)) < 0.4, sep_mm, 0.0) + np.linspace(2000.0, 2001.0, 200)
    means = np.rint(_means(place + rng.normal(0.0, sigma_mm, place.shape), window)).astype(np.float32)
    found = RunningMean(float(window)).likeliest(means)
    noise = found - place[window - 1 :]
    noise = noise[:, np.abs(noise).max(axis=0) < 8.0 * sigma_mm]  # no sample is of another surface
    assert noise.shape[1] > 190
    noise -= noise.mean(axis=0)
    assert np.median(noise.std(axis=0)) == pytest.approx(sigma_mm, rel=0.08)
    assert (noise**4).mean() / (noise**2).mean() ** 2 == pytest.approx(3.0, abs=0.4)
    assert abs((noise[1:] * noise[:-1]).mean() / noise.var()) < 0.08
    chain = found[::window, 0]
    assert len(np.unique(np.round(np.diff(np.sort(chain)), 3))) > 0.7 * (len(chain) - 1)  # on no step


@pytest.mark.parametrize(("window", "sigma_mm"), [(2, 2.0), (3, 3.0), (5, 3.0), (8, 6.0)])
def test_scatter_of_samples_of_rounded_means_differs_between_pixels_as_that_of_samples(
    window: int, sigma_mm: float
) -> None:
    """Where the rounded means told each pixel's own noise, some scattered as much as if they saw two surfaces."""
    samples = 2000.0 + np.random.default_rng(11).normal(0.0, sigma_mm, (99 + window, 2000))
    means = np.rint(_means(samples, window))[:, np.newaxis]
    noise = NoiseCurve(np.array([1000.0]), np.array([sigma_mm]))
    sensor = Sensor(name="camera", noise=noise, temporal_filter=RunningMean(float(window)))
    found = independent_samples(ArrayRecording(means, sensor)).read_range(slice(None), slice(None))
    scatter = found.std(axis=0)
    assert scatter.mean() == pytest.approx(sigma_mm, rel=0.05)
    assert scatter.std() / scatter.mean() == pytest.approx(1.0 / np.sqrt(2.0 * len(found)), rel=0.1)


def test_mean_of_medians_has_the_noise_of_medians() -> None:
    noise = NoiseCurve(np.array([1000.0, 3000.0]), np.array([2.0, 6.0]))
    found = AveragedMedians(RunningMean(3.0), 5).with_noise(noise).average
    assert isinstance(found, RunningMean)
    assert found.noise is not None
    np.testing.assert_allclose(found.noise.sigma(np.array([2000.0])), 4.0 * ApartMedians(5.0).sd())


@pytest.mark.parametrize("window", [3, 5, 7])
def test_seen_samples_and_repeats_of_a_median_have_the_computed_probabilities(window: int) -> None:
    median, (medians, seen) = RunningMedian(float(window)), _medians(window, 0.0)
    assert np.isfinite(seen).mean() == pytest.approx(median.worth(100_000) / 100_000, abs=0.006)
    assert np.nanstd(seen) == pytest.approx(median.moments(0.0, 1.0)[1], rel=0.02)
    for lag in range(1, window + 2):
        assert (medians[lag:] == medians[:-lag]).mean() == pytest.approx(median.tie(lag), abs=0.01)


@pytest.mark.parametrize("window", [3, 5])
def test_shares_and_moments_of_seen_samples_lead_back_to_the_samples(window: int) -> None:
    median, (_, seen) = RunningMedian(float(window)), _medians(window, 0.3)
    near = seen[seen < 50.0]
    share = near.size / np.isfinite(seen).sum()
    assert share < 0.25
    assert median.shares_of_samples(np.array([[share, 1.0 - share]]))[0][0, 0] == pytest.approx(0.3, abs=0.01)
    mean, sd = median.moments(0.0, 0.3)
    assert near.mean() == pytest.approx(mean, abs=0.05)
    assert near.std() == pytest.approx(sd, rel=0.05)


def _means(samples: np.ndarray, window: int) -> np.ndarray:
    """Running means (frame, ...) of samples, without the first window - 1."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(samples, window, axis=0).mean(axis=-1))


def _two_surfaces(frames: int, share: float) -> np.ndarray:
    """Samples (frame, 40) of two surfaces 100 sigma apart, the nearer one with a share."""
    rng = np.random.default_rng(5)
    return 2000.0 + np.where(rng.random((frames, 40)) < share, 0.0, 900.0) + rng.normal(0.0, 9.0, (frames, 40))


@pytest.mark.parametrize("share", [0.0, 0.4])
@pytest.mark.parametrize("window", [2, 3, 8])
def test_samples_of_means_are_the_samples_but_for_small_offsets_of_chains(window: int, share: float) -> None:
    samples = _two_surfaces(100 + window - 1, share)
    means = _means(samples, window)
    found = RunningMean(float(window)).independent(means.astype(np.float32), 0)
    off = found - samples[window - 1 :]
    for chain in range(window):
        own = off[chain::window]
        np.testing.assert_allclose(own, np.broadcast_to(own[0], own.shape), atol=0.1)
        assert np.abs(own[0]).max() < 9.0 * 4.5 / np.sqrt(100 / window)
    np.testing.assert_allclose(_means(found, window), means[window - 1 :], atol=0.1)


def test_samples_of_means_are_restored() -> None:
    np.testing.assert_array_equal(RunningMean(4.0).independent(np.full((30, 2), 5.0, np.float32), 0), 5.0)
    samples = _two_surfaces(100, 0.4)
    means = np.stack([samples[max(0, t - 2) : t + 1].mean(axis=0) for t in range(100)])
    found = RunningMean(3.0).independent(means.astype(np.float32), 0)
    assert np.abs(found - samples).max() < 9.0


def test_runs_between_lost_means_are_solved_one_by_one() -> None:
    means = _means(_two_surfaces(102, 0.0), 3).astype(np.float32)
    means[40] = np.nan
    means[44] = np.nan
    found = RunningMean(3.0).independent(means, 0)
    assert np.isnan(found[40:45]).all()
    for run in (slice(0, 40), slice(45, 100)):
        np.testing.assert_array_equal(found[run], RunningMean(3.0).independent(means[run], 0))
        assert np.isfinite(found[run]).all()


def test_samples_of_several_surfaces_are_unknown_in_runs_of_few_windows() -> None:
    for share, known in ((0.0, True), (0.5, False)):
        means = _means(_two_surfaces(31, share), 8).astype(np.float32)
        solved = np.isfinite(RunningMean(8.0).independent(means, 0)).any(axis=0)
        assert solved.mean() == pytest.approx(float(known), abs=0.1)
        assert np.isfinite(RunningMean(8.0).likeliest(means)).all()


def test_recording_is_the_same_read_in_blocks() -> None:
    samples = np.random.default_rng(2).normal(2000.0, 9.0, (240, 6, 5)).astype(np.float32)
    apart = AveragedMedians(ExponentialAverage(0.3, 40.0), 3)
    for kind in (ExponentialAverage(0.3), RunningMedian(3.0), RunningMean(4.0), apart):
        source = independent_samples(ArrayRecording(samples, Sensor(name="camera", temporal_filter=kind)))
        whole = source.read_range(slice(0, 240), slice(0, 6))
        parts = [source.read_range(slice(k, k + 7), slice(2, 4)) for k in range(0, 240, 7)]
        np.testing.assert_array_equal(np.concatenate(parts), whole[:, 2:4])
        assert np.isfinite(whole).any()


def test_recording_without_a_filter_is_the_recording() -> None:
    source = ArrayRecording(np.ones((3, 2, 2)), Sensor(name="camera"))
    assert independent_samples(source) is source


@pytest.mark.parametrize(
    ("kind", "parameter"),
    [("exponential_average", 1.0), ("running_median", 4.0), ("running_mean", 1.0), ("wiener", 3.0)],
)
def test_filters_that_cannot_be_are_refused(kind: str, parameter: float) -> None:
    with pytest.raises(ValueError, match="temporal filter"):
        make_filter(kind, parameter)


@pytest.mark.parametrize(
    ("kind", "extra"),
    [
        ("running_mean", {"threshold_mm": 40.0}),
        ("exponential_average", {"threshold_mm": -1.0}),
        ("held_values", {"median": 3.0}),
        ("exponential_average", {"median": 4.0}),
        ("exponential_average", {"median": 3.5}),
    ],
)
def test_composed_filters_that_cannot_be_are_refused(kind: str, extra: dict[str, float]) -> None:
    parameter = 3.0 if kind == "running_mean" else 0.5
    with pytest.raises(ValueError, match="temporal filter"):
        make_filter(kind, parameter, **extra)
