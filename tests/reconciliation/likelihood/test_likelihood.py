"""The compiled likelihood against the registry's own prediction, and the integrals over latent states."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm
from support.recordings import MAKE, Record

from tofmix.reconciliation.likelihood.likelihood import Likelihood, forward
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.likelihood.pixel_pattern import PixelBiases, marginal_pattern
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.hidden import FrameChain
from tofmix.simulation.exposure import predict
from tofmix.simulation.model import Model

ACTING = (
    MAKE["range_offset"](offset_mm=7.0),
    MAKE["wiggling"](amplitude_mm=12.0, phase_rad=1.0),
    MAKE["scattering"](share=0.02),
    MAKE["flying_pixels"](probability=0.3),
    MAKE["dropout"](probability=0.1),
    MAKE["outliers"](probability=0.01),
    MAKE["quantisation"](step_mm=7.0),
)


@pytest.mark.parametrize("effect", ACTING, ids=lambda effect: effect.kind)
def test_likelihood_with_an_effect_is_that_of_the_registrys_prediction(
    model: Model, record: Record, effect: Effect
) -> None:
    evidence = record(effect)
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    found = likelihood.value(replace(likelihood.start(), effects=(effect,)), whole)
    real = replace(model, effects=(effect,))
    wanted = np.log(np.maximum(predict(real, cast_scene(real)).probability(evidence.samples), 1e-12)).sum()
    assert found == pytest.approx(wanted, rel=1e-4)  # the density stands for narrow cells


def test_scores_are_standard_normal_where_the_model_is_right(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    whole = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    z = likelihood.scores(likelihood.start(), whole, seed=3)
    n = z.size
    assert abs(z.mean()) < 4 / np.sqrt(n)
    assert abs(z.var() - 1) < 4 * np.sqrt(2 / n)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("outside", [-1, 0])
def test_frames_and_pixels_that_the_recording_does_not_have_are_refused(
    model: Model, record: Record, which: int, outside: int
) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    part = [np.arange(count) for count in evidence.shape]
    part[which] = np.append(part[which], -1 if outside else evidence.shape[which])
    start, name = likelihood.start(), ("frame", "pixel")[which]
    for ask in (
        lambda: likelihood.scores(start, (part[0], part[1]), seed=3),
        lambda: likelihood.sums(likelihood.scene.mixture(()), start, (part[0], part[1])),
    ):
        with pytest.raises(
            ValueError, match=rf"{name}s -?\d+ to \d+ asked for, the recording has {part[which].size - 1}"
        ):
            ask()


def test_integral_over_a_pattern_is_the_gaussian_one(rng: np.random.Generator) -> None:
    rows, cols = 4, 5
    bias, information = rng.normal(size=rows * cols) * 3, rng.uniform(0.5, 2.0, rows * cols)
    gain = 0.5 * information * bias**2  # of a quadratic log-likelihood
    found = PixelBiases(bias=bias, information=information, gain=gain)
    got, pattern = marginal_pattern(found, (rows, cols), (2.0, 1.0, 0.7))
    row, col = np.divmod(np.arange(rows * cols), cols)
    prior = 4.0 * np.eye(rows * cols) + 1.0 * (col[:, None] == col) + 0.49 * (row[:, None] == row)
    noise = np.diag(1 / information)
    zero = np.zeros(rows * cols)
    wanted = multivariate_normal.logpdf(bias, zero, prior + noise) - multivariate_normal.logpdf(bias, zero, noise)
    assert got == pytest.approx(wanted, rel=1e-9)
    np.testing.assert_allclose(pattern, prior @ np.linalg.solve(prior + noise, bias), rtol=1e-9)


def test_sum_over_bursts_is_that_over_all_states(rng: np.random.Generator) -> None:
    chain = FrameChain(probability=0.3, sigma_mm=10.0, burst_frames=2.0)
    quiet, loud = rng.normal(size=8), rng.normal(size=8)
    frames = np.array([0, 1, 2, 5, 6, 7, 8, 12])
    got, posterior = forward(quiet, loud, frames, chain)
    stop, start = 0.5, 0.5 * 0.3 / 0.7
    step = np.array([[1 - start, start], [stop, 1 - stop]])
    total, disturbed = 0.0, np.zeros(8)
    for code in range(2**8):
        states = np.array([code >> k & 1 for k in range(8)])
        p = (0.7, 0.3)[states[0]]
        for k in range(1, 8):
            p *= np.linalg.matrix_power(step, int(frames[k] - frames[k - 1]))[states[k - 1], states[k]]
        p *= np.exp(np.where(states, loud, quiet).sum())
        total += p
        disturbed += p * states
    assert got == pytest.approx(np.log(total), abs=1e-9)
    np.testing.assert_allclose(posterior, disturbed / total, atol=1e-9)


def test_drift_is_a_bias_of_each_frame(model: Model, record: Record) -> None:
    evidence = record()
    scene = Scene(model, evidence.time_s)
    drift = MAKE["temperature_drift"](amplitude_mm=20.0, time_constant_s=4.0)
    bias = scene.mixture((drift,)).frame_bias
    np.testing.assert_allclose(bias, 20.0 * (1 - np.exp(-evidence.time_s / 4.0)))
    assert norm.cdf(0) == 0.5
