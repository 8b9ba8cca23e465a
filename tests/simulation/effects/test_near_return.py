"""Samples of a cover glass: their share, range and noise; all other samples stay as they are."""

import numpy as np
import pytest
from scipy import stats
from support.effect_bench import Bench, effect

SHARE, RANGE_MM, SIGMA_MM = 0.06, 25.0, 5.0
NEAR = effect("near_return", share=SHARE, range_mm=RANGE_MM, sigma_mm=SIGMA_MM)


def test_near_samples_have_share_range_and_noise_of_the_glass_and_others_stay(bench: Bench) -> None:
    plain, other = bench.boards(frames=400), bench.boards(NEAR, frames=400)
    near = other.stored < 100
    assert not (plain.stored < 100).any()
    assert stats.binomtest(int(near.sum()), near.size, SHARE).pvalue > 1e-4
    seen = other.range_mm[near]
    rounded = np.hypot(SIGMA_MM, 12**-0.5)  # whole mm
    assert seen.mean() == pytest.approx(RANGE_MM, abs=4 * rounded / np.sqrt(seen.size))
    assert seen.std() == pytest.approx(rounded, rel=4 / np.sqrt(2 * seen.size))
    assert (other.amplitude[near] == 0).all()
    np.testing.assert_array_equal(other.stored[~near], plain.stored[~near])


def test_biases_and_noise_leave_near_samples(bench: Bench) -> None:
    """Whatever the order of the file."""
    alone = bench.boards(NEAR, frames=100)
    near = alone.stored < 100
    for others in ((NEAR, *_OTHERS), (*_OTHERS, NEAR)):
        with_others = bench.boards(*others, frames=100)
        np.testing.assert_array_equal(with_others.stored[near], alone.stored[near])


_OTHERS = effect("range_offset", offset_mm=40.0), effect("excess_noise", factor=3.0), effect("scattering", share=0.1)


def test_random_values_stay_random(bench: Bench) -> None:
    wild = effect("outliers", probability=0.3)
    one, both = bench.boards(wild, frames=100), bench.boards(wild, NEAR, frames=100)
    scene = effect("near_return", share=0.99, range_mm=RANGE_MM, sigma_mm=SIGMA_MM)
    others = bench.boards(wild, scene, frames=100).stored >= 100  # random values, and one in a hundred of the scene
    assert 0.25 < others.mean() < 0.35
    random = others & (one.amplitude == 0)
    np.testing.assert_array_equal(both.stored[random], one.stored[random])
