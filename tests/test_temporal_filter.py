"""Filters over time, as functions of samples."""

import numpy as np
import pytest

from tofmix.independent_samples import independent_samples
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor
from tofmix.temporal_filter import ExponentialAverage, RunningMean, RunningMedian, make_filter


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


def test_rounding_of_stored_ranges_is_that_of_the_inverse() -> None:
    rounding = np.random.default_rng(3).uniform(-0.5, 0.5, (20_000, 3)).astype(np.float32)
    found = ExponentialAverage(0.1).independent(rounding, 0)
    assert np.nanstd(found) == pytest.approx(ExponentialAverage(0.1).rounding_mm(1.0), rel=0.02)


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


def test_samples_of_means_that_began_with_the_recording_are_the_samples() -> None:
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


def test_rounding_of_stored_means_is_that_of_their_samples() -> None:
    samples = _two_surfaces(103, 0.0)
    means = _means(samples, 4)
    exact, rounded = (RunningMean(4.0).independent(m.astype(np.float32), 0) for m in (means, np.rint(means)))
    assert (rounded - exact).std() == pytest.approx(RunningMean(4.0).rounding_mm(1.0), rel=0.3)


def test_constant_means_are_constant_samples() -> None:
    np.testing.assert_array_equal(RunningMean(4.0).independent(np.full((30, 2), 5.0, np.float32), 0), 5.0)


def test_recording_is_the_same_read_in_blocks() -> None:
    samples = np.random.default_rng(2).normal(2000.0, 9.0, (240, 6, 5)).astype(np.float32)
    for kind in (ExponentialAverage(0.3), RunningMedian(3.0), RunningMean(4.0)):
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
