"""Probabilities of a walk of all means, by the recording of a scene."""

import numpy as np
import pytest

from tofmix.arrays import FloatArray
from tofmix.reconciliation.likelihood.wander import probabilities
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
