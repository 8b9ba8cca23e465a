"""Held-out likelihood: the true model has the highest, by the Kullback-Leibler distance of the others."""

import math

import numpy as np
import pytest
from scipy import integrate, stats
from support.learnt_pixels import KNOWN, LOW_MM, TOP_MM, camera_with, pixel_noise, surfaces

from tofmix.arrays import FloatArray
from tofmix.estimation.beam import beam_of
from tofmix.estimation.learnt.folds import SURPRISES, flat_thresholds, held_out_scores
from tofmix.estimation.learnt.model import PixelNoise


def _scores(samples: FloatArray, noise: PixelNoise) -> tuple[FloatArray, FloatArray]:
    block = np.ascontiguousarray(samples.T, dtype=np.float32)
    return held_out_scores(block, noise.laws(), beam_of(camera_with(noise)), flat_thresholds(), 4)


@pytest.mark.parametrize("factor", [0.9, 1.25])  # with a smaller one, two surfaces stand for one
def test_wrong_sigma_loses_the_kullback_leibler_distance(factor: float, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (200, 300), (2000.0,))
    right, _ = _scores(samples, pixel_noise())
    wrong, _ = _scores(samples, pixel_noise(sigma_mm=20.0 * factor))
    floor = SURPRISES / (TOP_MM - LOW_MM)

    def mixed(x: float, sigma: float) -> float:
        return float((1.0 - SURPRISES) * stats.norm.pdf(x, 0.0, sigma) + floor)

    def lost(x: float) -> float:
        return float(stats.norm.pdf(x, 0.0, 20.0)) * float(np.log(mixed(x, 20.0) / mixed(x, 20.0 * factor)))

    # The mean is fitted to a half of the samples: that loses half a nat a half on top, more where sigma is small.
    expected = 200 * integrate.quad(lost, -200.0, 200.0, limit=200)[0] + 1.0 * (1.0 / factor**2 - 1.0)
    assert float(np.mean(right - wrong)) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOWN)
def test_true_shape_predicts_best(name: str, rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 200), (2000.0,), errors=KNOWN[name].draw)
    score = {other: float(_scores(samples, pixel_noise(other))[0].mean()) for other in KNOWN}
    assert max(score, key=lambda other: score[other]) == name


def test_surfaces_are_counted_in_each_half(rng: np.random.Generator) -> None:
    samples = surfaces(rng, (100, 60), (1500.0, 2500.0), (0.5, 0.5))
    _, found = _scores(samples, pixel_noise())
    assert found.mean() == pytest.approx(2.0, abs=0.05)


def test_pixels_with_too_few_samples_have_no_score() -> None:
    samples = np.full((20, 2), np.nan)
    samples[:3, 0] = 2000.0, 2010.0, 1990.0
    scores, found = _scores(samples, pixel_noise())
    assert np.isnan(scores).all()
    np.testing.assert_array_equal(found, 0.0)


def test_alternating_surfaces_fall_in_both_halves(rng: np.random.Generator) -> None:
    # Two targets of a frame take turns: halves by odd and even frames would each see one of them alone.
    place = np.where(np.arange(120) % 2 == 0, 1500.0, 2500.0)[:, np.newaxis]
    scores, found = _scores(place + 20.0 * rng.standard_normal((120, 40)), pixel_noise())
    np.testing.assert_array_equal(found, 2.0)
    entropy = 0.5 * np.log(2.0 * np.pi * math.e * 20.0**2) + np.log(2.0)
    assert scores.mean() / 120 == pytest.approx(-entropy, abs=0.06)
