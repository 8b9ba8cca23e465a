"""Searches that are no smooth fit: stuck pixels, and what only looks like them."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from support.recordings import MAKE, Record

from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.hidden_fits import find_stuck, fit_bursts
from tofmix.reconciliation.likelihood.likelihood import Likelihood, forward
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.simulation.model import Model


def test_stuck_pixels_are_found_with_their_values(model: Model, record: Record) -> None:
    evidence = record()
    samples = evidence.samples.copy()
    samples[:, [5, 77]] = 1234, 2345
    evidence = replace(evidence, samples=samples)
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    stuck_mm = find_stuck(likelihood, likelihood.scene.mixture())
    assert stuck_mm is not None
    assert np.flatnonzero(np.isfinite(stuck_mm)).tolist() == [5, 77]
    assert stuck_mm[[5, 77]].tolist() == [1234.0, 2345.0]


def test_no_stuck_pixel_is_found_where_there_is_none(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    assert find_stuck(likelihood, likelihood.scene.mixture()) is None


def test_sigma_of_bursts_is_at_the_top_of_its_likelihood(model: Model, record: Record) -> None:
    """To a third of a standard error: a twentieth of a nat."""
    evidence = record(MAKE["interference"](probability=0.25, sigma_mm=23.0, burst_frames=5.0))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    mixture, state = likelihood.scene.mixture(), likelihood.start()
    part = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    found = fit_bursts(likelihood, mixture, state, part)
    assert found is not None

    def value(sigma: float) -> float:
        pair = likelihood.frame_pair(mixture, state, part, sigma)
        return forward(*pair, evidence.frame_number, found._replace(sigma_mm=sigma))[0]

    at = found.sigma_mm
    best = minimize_scalar(lambda size: -value(size), bounds=(0.9 * at, 1.1 * at), method="bounded")
    assert value(at) > -float(best.fun) - 0.05


def _noisier(evidence: Evidence, sigma_mm: NDArray[Any]) -> Evidence:
    """The recording with more noise, of so many mm by frame."""
    more = np.random.default_rng(3).standard_normal(evidence.samples.shape) * sigma_mm[:, None]
    return replace(
        evidence, samples=np.where(evidence.samples > 0, np.rint(evidence.samples + more), 0).astype(np.uint16)
    )


def test_noise_of_all_frames_is_no_burst_and_that_of_some_is(model: Model, record: Record) -> None:
    """Noise that differs a little between frames at random, or that increases after a third of the recording."""
    evidence = record()
    frames = np.arange(evidence.shape[0])
    everywhere = np.random.default_rng(4).uniform(0.3, 1.7, frames.size)
    for sigma_mm, bursts in ((5.0 * everywhere, False), (8.0 * (frames > 40), False), (8.0 * (frames % 9 < 3), True)):
        likelihood = Likelihood(_noisier(evidence, sigma_mm), Scene(model, evidence.time_s))
        part = frames, np.arange(evidence.shape[1])
        found = fit_bursts(likelihood, likelihood.scene.mixture(), likelihood.start(), part)
        assert (found is not None) == bursts


def test_search_for_bursts_stays_within_its_bound_under_noise_of_metres(model: Model, record: Record) -> None:
    """The trial sizes are multiples of sigma, up to 8."""
    noise = replace(model.sensor.noise, sigma_mm=np.full_like(model.sensor.noise.sigma_mm, 2500.0))
    wide = replace(model, sensor=replace(model.sensor, noise=noise))
    evidence = record()
    likelihood = Likelihood(evidence, Scene(wide, evidence.time_s))
    everything = np.arange(evidence.shape[0]), np.arange(evidence.shape[1])
    found = fit_bursts(likelihood, likelihood.scene.mixture(()), likelihood.start(), everything)
    assert found is None or found.sigma_mm <= 10_000.0
