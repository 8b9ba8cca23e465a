"""Candidates for the noise: a gain counts where most pixels have it, or a few have much of it."""

import numpy as np
import pytest

from tofmix.estimation.learnt.learning import NoiseCandidate, held_out_gain, mean_difference


def test_single_deviating_pixel_changes_no_mean_difference(rng: np.random.Generator) -> None:
    one = rng.normal(0.0, 1.0, 400)
    other = one - 0.2 + rng.normal(0.0, 0.1, 400)
    gain, error = mean_difference(one, other)
    assert gain == pytest.approx(0.2, abs=4 * error)
    assert error == pytest.approx(0.1 / np.sqrt(400), rel=0.15)
    other[0] = 1e6
    assert mean_difference(one, other)[0] == pytest.approx(0.2, abs=0.02)
    other[1] = np.nan
    assert mean_difference(one, other)[0] == pytest.approx(0.2, abs=0.02)
    assert mean_difference(one[:2], other[2:4]) == (0.0, np.inf)


def test_gain_of_most_pixels_counts_and_noise_does_not(rng: np.random.Generator) -> None:
    one, noise = rng.normal(0.0, 1.0, 400), rng.normal(0.0, 0.5, 400)
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), one - 0.3 + noise)) == pytest.approx(0.3, abs=0.1)
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), one + noise)) == 0.0
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), one - 0.05)) == 0.0  # less changes no count


def test_large_gain_of_a_few_pixels_counts_and_that_of_one_does_not() -> None:
    other = np.zeros(100)
    few = other.copy()
    few[:6] = 30.0
    assert held_out_gain(NoiseCandidate((), few), NoiseCandidate((), other)) == pytest.approx(150.0 / 99.0)
    one = other.copy()
    one[0] = 1000.0
    assert held_out_gain(NoiseCandidate((), one), NoiseCandidate((), other)) == 0.0
