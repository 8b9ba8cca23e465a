"""Probabilities of a walk of all means, by the recording of a scene; and straight ways that are no walk."""

import numpy as np
import pytest

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.wander import probabilities, straight_courses, straight_way
from tofmix.simulation.measured_scene import UNKNOWN_WALK, WALKS

FRAMES, PIXELS = 400, 16


def _noise(seed: int) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((FRAMES, PIXELS))


def test_still_means_have_no_walk_that_the_recording_would_show() -> None:
    """Their standard error in a tenth is 0.04 sigma."""
    found = np.mean([probabilities(_noise(seed), frame_noise=0.0, repeats=1.0) for seed in range(20)], axis=0)
    assert found.sum() == pytest.approx(1.0)
    assert found[0] > UNKNOWN_WALK[0]
    assert found[WALKS.index(0.4) :].sum() < 0.01


def test_walking_means_have_a_walk_of_their_size() -> None:
    """A drift and a bend, which are no walk here, take a part of it."""
    found = []
    for seed in range(20):
        steps = np.random.default_rng([7, seed]).standard_normal(FRAMES) * 0.4 / np.sqrt(FRAMES)
        found.append(probabilities(_noise(seed) + np.cumsum(steps)[:, None], frame_noise=0.0, repeats=1.0))
    mean = np.mean(found, axis=0)
    assert mean[WALKS.index(0.2) :].sum() > 0.7
    assert mean.argmax() == WALKS.index(0.4)


def test_a_steady_drift_is_no_walk() -> None:
    """It is a change that has a name."""
    drift = np.linspace(0.0, 3.0, FRAMES)[:, None] ** 1.5
    assert probabilities(_noise(1) + drift - drift.mean(), frame_noise=0.0, repeats=1.0)[0] > UNKNOWN_WALK[0]


def test_what_a_frame_has_in_common_is_no_walk() -> None:
    jitter = 0.5 * np.random.default_rng(2).standard_normal((FRAMES, 1))
    assert probabilities(_noise(3) + jitter, frame_noise=0.5, repeats=1.0)[0] > UNKNOWN_WALK[0]


def test_a_recording_of_few_frames_tells_nothing() -> None:
    assert probabilities(_noise(1)[:3], frame_noise=0.0, repeats=1.0) == pytest.approx(UNKNOWN_WALK)


def _moving(frames: int, seed: int = 3) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Samples of sigma 10 mm, of which two thirds of the pixels move at their own speeds; times; and the speeds."""
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.uniform(0.0, 2.0, frames))
    speeds = np.where(np.arange(PIXELS) % 3 == 0, 0.0, rng.uniform(80.0, 120.0, PIXELS))
    return 1000.0 + 10.0 * rng.standard_normal((frames, PIXELS)) + time_s[:, None] * speeds, time_s, speeds


@pytest.mark.parametrize("frames", [12, 60])
def test_straight_ways_are_those_of_the_pixels_that_move_and_zero_in_the_middle(frames: int) -> None:
    samples, time_s, speeds = _moving(frames)
    samples[np.random.default_rng(4).random(samples.shape) < 0.1] = np.nan
    far_mm, ways = straight_way(samples, time_s, 0.01), straight_courses(samples, time_s)
    middle = 0.5 * (time_s[0] + time_s[-1])
    assert far_mm == pytest.approx(100.0 * (time_s[-1] - time_s[0]), rel=0.15)
    np.testing.assert_array_equal(ways[:, speeds == 0.0], 0.0)
    error = 10.0 * np.sqrt(np.pi / 2) * np.sqrt(2.0 / (frames / 3 * 0.7))  # of two medians
    np.testing.assert_allclose(ways, (time_s - middle)[:, None] * speeds, atol=4 * error)


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_still_pixels_have_no_straight_ways_under_a_memory_either(memory: float) -> None:
    """The way of 16 pixels is compared with the noise of one."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal((20, PIXELS))
        for k in range(1, len(noise)):
            noise[k] = memory * noise[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
        assert straight_way(1000.0 + 10.0 * noise, np.arange(20.0), 0.01) is None


@pytest.mark.parametrize(("pixels", "told"), [(2, False), (4, True)])
def test_a_part_of_the_pixels_that_goes_one_way_together_is_told_from_three_of_them_on(pixels: int, told: bool) -> None:
    """They are few, so that the image as a whole stands still: a wall behind the floor before a drone."""
    rng, time_s = np.random.default_rng(7), np.arange(12.0)
    samples = 1000.0 + 10.0 * rng.standard_normal((12, PIXELS))
    samples[:, :pixels] -= 30.0 * time_s[:, None]
    way = straight_way(samples, time_s, 0.01)
    assert (way is not None) is told
    assert way is None or abs(way + 330.0) < 30.0


def test_a_small_way_or_no_time_is_no_straight_way() -> None:
    samples, time_s, _ = _moving(60)
    still = 10.0 * np.random.default_rng(5).standard_normal((60, PIXELS))
    assert straight_way(still + 10.0 * time_s[:, None], time_s, 0.01) is None  # 2 sigma
    assert straight_way(samples, np.zeros(60), 0.01) is None
    assert straight_way(np.full((60, PIXELS), np.nan), time_s, 0.01) is None


def test_a_way_within_a_coarse_step_of_the_values_is_no_straight_way() -> None:
    """All pixels step from one value to the next, and what is left of that about a line is less than a step's error."""
    samples = np.repeat([1000.0, 1025.0, 1025.0], 20)[:, None] + np.zeros((60, PIXELS))
    assert straight_way(samples, np.arange(60.0), 0.01) is None
