"""Searches that are no smooth fit: stuck pixels, and what only looks like them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record
from scipy.optimize import minimize_scalar

from tofmix.reconcile.bursts import forward
from tofmix.reconcile.evidence import Evidence
from tofmix.reconcile.likelihood import Likelihood
from tofmix.reconcile.links import find_stuck, fit_interference
from tofmix.reconcile.memory import fit_memory
from tofmix.reconcile.mixture import Scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model


def test_stuck_pixels_are_found_with_their_values(model: Model, record: Record) -> None:
    evidence = record()
    samples = evidence.samples.copy()
    samples[:, [5, 77]] = 1234, 2345
    evidence = replace(evidence, samples=samples)
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    state = find_stuck(likelihood, likelihood.scene.mixture(), likelihood.start())
    assert state is not None
    assert np.flatnonzero(~state.working).tolist() == [5, 77]
    assert state.stuck_mm[[5, 77]].tolist() == [1234.0, 2345.0]


def test_without_stuck_pixels_none_is_found(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    assert find_stuck(likelihood, likelihood.scene.mixture(), likelihood.start()) is None


def test_bursts_that_are_quieter_than_empty_pixels_have_their_own_sigma(
    in_the_open: Callable[[Effect], tuple[Model, Evidence]],
) -> None:
    """Pixels without a return have the sigma of the range's end, 52 mm: it must not bound the search."""
    model, evidence = in_the_open(MAKE["interference"](probability=0.3, sigma_mm=4.0, burst_frames=4.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    everything = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    found = fit_interference(likelihood, likelihood.scene.mixture(()), likelihood.start(), everything)
    assert found is not None
    assert found.sigma_mm == pytest.approx(4.0, rel=0.05)


def test_no_pair_of_samples_is_no_memory(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    z = np.zeros(evidence.shape, dtype=np.float32)
    everything = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    assert fit_memory(likelihood, z, likelihood.scene.mixture(()), everything) is None


def test_the_noise_of_bursts_is_at_the_top_of_its_likelihood(model: Model, record: Record) -> None:
    """To a third of a standard error: a twentieth of a nat."""
    evidence = record(MAKE["interference"](probability=0.25, sigma_mm=23.0, burst_frames=5.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    mixture, state = likelihood.scene.mixture(), likelihood.start()
    part = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    found = fit_interference(likelihood, mixture, state, part)
    assert found is not None

    def value(sigma: float) -> float:
        pair = likelihood.frame_pair(mixture, state, part, sigma)
        return forward(*pair, evidence.frame_number, replace(found, sigma_mm=sigma))[0]

    at = found.sigma_mm
    best = minimize_scalar(lambda size: -value(size), bounds=(0.9 * at, 1.1 * at), method="bounded")
    assert value(at) > -float(best.fun) - 0.05


def test_a_memory_in_few_frames_has_no_bias(model: Model, record: Record) -> None:
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
            effect = fit_memory(likelihood, scores, mixture, part)
            assert effect is not None
            found.append(effect.coefficient)
    assert abs(np.mean(found) - 0.5) < 0.012
