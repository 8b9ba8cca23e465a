"""Curves of the panel whose null is worked out here: means of polynomials, waves over whole mm, lines of few frames."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.recordings import Record, recorded

from tofmix.reconciliation.comparison.compare import compare
from tofmix.reconciliation.comparison.panel import Curve, bend, further_moves, of_neighbours
from tofmix.reconciliation.comparison.panel_parts import lines
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.error_shape import hermite
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model


def _waves(model: Model, evidence: Evidence) -> Curve:
    likelihood = joint_likelihood([(model, evidence)])
    part = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    panel = compare(likelihood, likelihood.start(), part, seed=1)
    (curve,) = [c for c in panel.curves if c.name == ("discreteness", "all", 0)]
    return curve


def _without(evidence: Evidence, each: int) -> Evidence:
    """Every so many-th code missing: its samples go to the next."""
    samples = evidence.samples
    return replace(evidence, samples=np.where((samples > 0) & (samples % each == 0), samples + 1, samples))


def test_waves_over_whole_mm_are_noise_alone_if_the_model_is_right(model: Model, record: Record) -> None:
    z = [_waves(model, record(seed=seed)).z for seed in range(5, 12)]
    assert max(np.abs(z)) < 3.5
    assert abs(np.mean(z)) < 4 / np.sqrt(len(z))


@pytest.mark.parametrize("each", [2, 7, 15])
def test_waves_show_missing_codes(model: Model, record: Record, each: int) -> None:
    """Each wave's power against a sum over the samples one by one."""
    evidence = _without(record(), each)
    curve = _waves(model, evidence)
    assert curve.z > 6
    assert (np.diff(curve.lower) >= 0).all()  # a place is an interval of it
    own = np.isclose(curve.lower, each)
    assert np.abs(curve.value[own]).max() > 4 * np.sqrt(curve.variance[own]).max()


def test_wave_equals_the_mean_phasor_of_the_samples(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = joint_likelihood([(model, evidence)])
    sigma = likelihood.scene.mixture()
    narrowest = np.where(sigma.weight[0] > 0, sigma.sigma[0], np.inf).min(axis=0)
    x = evidence.samples[:, narrowest > 0.8 * 5].astype(np.float64)
    x = x[x > 0]
    curve = _waves(model, evidence)
    cosine, sine = curve.value[np.isclose(curve.lower, 5)]
    assert cosine == pytest.approx(np.cos(2 * np.pi * x / 5).mean() * 2, abs=1e-9)
    assert sine == pytest.approx(-np.sin(2 * np.pi * x / 5).mean() * 2, abs=1e-9)


def test_missing_codes_are_unexplained_discreteness(small: Model) -> None:
    kinds = ("quantisation", "excess_noise", "range_offset", "outliers")
    result = reconcile(small, _without(recorded(small), 6), Settings(kinds=kinds))
    assert result.verified.verdict == "unexplained"
    assert result.where[0].statistic == "discreteness"


def test_value_of_neighbours_is_the_mean_of_those_two_pixels_away_on_the_same_surface() -> None:
    rng = np.random.default_rng(5)
    rows, cols = 5, 7
    values, surface = rng.normal(size=rows * cols), rng.integers(-1, 2, rows * cols)
    found = of_neighbours(values, surface, (rows, cols))
    for pixel in range(rows * cols):
        row, col = divmod(pixel, cols)
        around = [
            (r, c)
            for r in range(rows)
            for c in range(cols)
            if max(abs(r - row), abs(c - col)) == 2 and surface[r * cols + c] == surface[pixel]
        ]
        expected = np.mean([values[r * cols + c] for r, c in around]) if around else values[pixel]
        assert found[pixel] == pytest.approx(expected)


@pytest.mark.parametrize("variance", [0.05, 0.125])
def test_polynomials_of_pixels_with_unknown_biases_have_these_means_and_variances(variance: float) -> None:
    """Against draws; a skew of 20 frames beside a reference of 20 varies by a sixth more than by its frames alone."""
    rng, frames, pixels = np.random.default_rng(4), 20, 100_000
    bias = rng.normal(0.0, np.sqrt(variance), pixels)
    z = (rng.standard_normal((frames, pixels)) + bias).astype(np.float32)
    first = (variance, 0.0, 0.0, 0.0)
    for order, (power, more) in enumerate(zip(hermite(z), further_moves(np.array([variance])), strict=True)):
        means = power.mean(axis=0, dtype=np.float64)
        expected = first[order] + more.variance[0] + (1.0 + more.scatter[0]) / frames
        assert means.var() == pytest.approx(expected, rel=0.04)
        assert means.mean() == pytest.approx(more.mean[0], abs=5 * np.sqrt(expected / pixels))


def test_bend_of_a_pixel_is_that_of_its_normal_density() -> None:
    sigma = np.array([2.2, 3.0, 8.0])
    values = np.add.outer(np.arange(-6, 7), np.full(3, 700)).astype(np.uint16)
    away = values.astype(np.float64) - 700
    density = [np.exp(-0.5 * ((away + step) / sigma) ** 2) for step in (-1, 0, 1)]
    np.testing.assert_allclose(bend(values, sigma), np.abs((density[0] + density[2]) / (2 * density[1]) - 1))


@pytest.mark.parametrize("frames", [4, 8, 30])
def test_lines_of_few_frames_stand_out_no_more_often_than_chance_lets_them(frames: int) -> None:
    """One of a hundred at 2.33, of 400 curves at most nine; of chi-squares of 3 taken as normal one of ten did."""
    rng, image = np.random.default_rng(1), (12, 12)
    evidence: Evidence = SimpleNamespace(image=image)  # type: ignore[assignment]
    part = np.arange(frames), np.arange(image[0] * image[1])
    found = [
        curve.z
        for _ in range(200)
        for curve in lines(rng.standard_normal((frames, part[1].size)).astype(np.float32), evidence, part)
    ]
    assert len(found) == 400
    assert sum(z > 2.33 for z in found) <= 9
    assert np.std(found) > 0.8  # and not for want of scatter
