"""The memory of the noise: what it does to means, and what is none."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, Record, recorded

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.memory import (
    attenuation,
    cell_share,
    fit_memory,
    inflation,
    memory_error,
    memory_gain_at_own_widths,
)
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.model import Model


def test_scores_of_zero_have_no_memory(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    z = np.zeros(evidence.shape, dtype=np.float32)
    everything = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    assert fit_memory(likelihood, z, likelihood.scene.mixture(()), everything) is None


def test_memory_fitted_to_few_frames_has_no_bias(model: Model, record: Record) -> None:
    """Of 0.5 in 30 frames, means taken out lose 0.05 (Nickell 1981); 12 parts of 0.007 each leave 0.002."""
    found = []
    for seed in (5, 6, 7):
        whole = record(MAKE["temporal_correlation"](coefficient=0.5), seed=seed)
        for k in range(0, 120, 30):
            own = slice(k, k + 30)
            evidence = replace(
                whole, samples=whole.samples[own], time_s=whole.time_s[own], fit_frames=whole.fit_frames[own]
            )
            likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
            mixture, part = likelihood.scene.mixture(), (np.arange(30), np.arange(evidence.shape[1]))
            scores = likelihood.scores(likelihood.start(), part, 1, mixture)
            coefficient = fit_memory(likelihood, scores, mixture, part)
            assert coefficient is not None
            found.append(coefficient)
    assert abs(np.mean(found) - 0.5) < 0.012


@pytest.mark.parametrize("alike", [1, 8])
@pytest.mark.parametrize("coefficient", [0.3, 0.8])
def test_error_of_a_memory_is_that_of_a_correlation_of_pixels_that_differ(
    model: Model, record: Record, coefficient: float, alike: int
) -> None:
    """(1 - rho^2) / n of n pairs (Bartlett 1946), where so many pixels share their noise of n / 8."""
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    frames, pixels = evidence.shape
    mixture = replace(likelihood.scene.mixture(), outlier=np.zeros(pixels), step=0.01)
    own = np.random.default_rng(4).normal(size=(frames, pixels // alike + 1))
    for k in range(1, frames):
        own[k] = coefficient * own[k - 1] + np.sqrt(1 - coefficient**2) * own[k]
    z = np.repeat(own, alike, axis=1)[:, :pixels].astype(np.float32)
    found = memory_error(likelihood, z, mixture, (np.arange(frames), np.arange(pixels)), coefficient)
    alone = int((mixture.of_main(mixture.weight) > 0.9995 * mixture.weight[0].sum(axis=0)).sum())
    assert found == pytest.approx(np.sqrt((1 - coefficient**2) * alike / alone / (frames - 1)), rel=0.2)


@pytest.mark.parametrize("coefficient", [-0.4, 0.0, 0.5, 0.9])
def test_inflation_of_a_mean_is_the_sum_over_all_pairs_of_frames(
    model: Model, record: Record, coefficient: float
) -> None:
    """Frames in blocks, as fits see them; the closed form by brute force."""
    evidence = record()
    effects = (MAKE["temporal_correlation"](coefficient=coefficient),) if coefficient else ()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    mixture, state = likelihood.scene.mixture(), replace(likelihood.start(), effects=effects)
    frames = np.flatnonzero(evidence.fit_frames)
    found = inflation(likelihood, mixture, state, (frames, np.arange(evidence.shape[1])))
    wanted = (coefficient ** np.abs(frames[:, None] - frames)).mean() * frames.size
    alone = mixture.weight[0].max(axis=0) > 0.999
    assert alone.sum() > 200
    share = cell_share(mixture).mean(axis=0)[alone]  # whole mm have no memory
    assert found[alone] == pytest.approx(1 + (wanted - 1) * share, rel=2e-3)


@pytest.mark.parametrize("step_mm", [5.0, 15.0, 30.0])
def test_memory_of_stored_values_is_attenuated_by_the_cells(model: Model, record: Record, step_mm: float) -> None:
    """Scores correlate by the memory times the attenuation, but for its cube, and the fit finds that of the noise."""
    effects = MAKE["quantisation"](step_mm=step_mm), MAKE["temporal_correlation"](coefficient=0.3)
    found = []
    for seed in (5, 6, 7):
        evidence = record(*effects, seed=seed)
        likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
        state = replace(likelihood.start(), effects=effects)
        mixture, part = likelihood.mixture(state), (np.arange(evidence.shape[0]), np.arange(evidence.shape[1]))
        z = likelihood.scores(state, part, 1, mixture)
        alone = (mixture.weight[0].max(axis=0) > 0.999) & (attenuation(mixture) > 0)
        near = np.where(np.abs(z[:, alone]) < 5, z[:, alone], 0.0)
        pairs = (near[1:] * near[:-1]).mean(axis=0)
        assert pairs.mean() == pytest.approx(0.3 * attenuation(mixture)[alone].mean(), abs=0.025)
        coefficient = fit_memory(likelihood, z, mixture, part)
        assert coefficient is not None
        found.append(coefficient)
    assert np.mean(found) == pytest.approx(0.3, abs=0.02)


def test_gain_at_own_widths_is_that_of_the_most_likely_widths_and_depends_on_no_prediction(
    model: Model, record: Record
) -> None:
    """Against the densities of AR(1) and of independent samples, each at its most likely width, of dense matrices."""
    evidence = record(MAKE["temporal_correlation"](coefficient=0.8))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    part = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    mixture = replace(likelihood.scene.mixture(), outlier=np.zeros(evidence.shape[1]))
    z = likelihood.scores(likelihood.start(), part, 1, mixture)
    found = memory_gain_at_own_widths(likelihood, z, mixture, part, 0.8)
    uneven = (z * np.linspace(0.9, 1.1, z.shape[1])).astype(np.float32)  # as if widths were predicted otherwise
    assert memory_gain_at_own_widths(likelihood, uneven, mixture, part, 0.8) == pytest.approx(found, rel=2e-3)

    alone = mixture.of_main(mixture.weight) > 0.9995 * mixture.weight[0].sum(axis=0)
    u = z[:, alone] - z[:, alone].mean(axis=0)
    u = u - u.mean(axis=1, keepdims=True)
    n, gap = len(u), np.abs(np.arange(len(u))[:, None] - np.arange(len(u)))
    wanted = 0.0
    for own, camera in zip(u.T, attenuation(mixture)[alone], strict=True):
        matrix = camera * 0.8**gap + (1 - camera) * np.eye(n)
        wanted += 0.5 * (n * np.log(own @ own / (own @ np.linalg.solve(matrix, own))) - np.linalg.slogdet(matrix)[1])
    assert wanted / 1.25 < found < 1.02 * wanted  # pixels are alike by chance to 1 +- 0.13; the first frame is given


def averaged(evidence: Evidence, frames: int) -> Evidence:
    """Each pixel's deviations from its median averaged over so many frames, as wide as before."""
    x = evidence.samples.astype(np.float64)
    middle = np.median(x, axis=0)
    steps = x - middle
    mean = sum(np.roll(steps, k, axis=0) for k in range(frames)) / np.sqrt(frames)
    quiet = (np.abs(steps).max(axis=0) < 200) & (middle > 0)
    return replace(evidence, samples=np.where(quiet, np.rint(middle + mean), x).astype(np.uint16))


@pytest.mark.parametrize(
    "frames", [pytest.param(2, marks=pytest.mark.slow), 4, pytest.param(8, marks=pytest.mark.slow)]
)
def test_noise_averaged_over_frames_is_an_unexplained_memory(small: Model, frames: int) -> None:
    result = reconcile(
        small, averaged(recorded(small), frames), Settings(kinds=("temporal_correlation", "range_offset"))
    )
    assert result.verified.verdict == "unexplained"
    assert result.where[0].statistic == "memory"
