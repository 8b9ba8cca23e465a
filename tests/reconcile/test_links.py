"""Searches that are no smooth fit: stuck pixels, and what only looks like them."""

from dataclasses import replace

import numpy as np
from recordings import Record

from tofmix.reconcile.likelihood import Likelihood
from tofmix.reconcile.links import find_stuck
from tofmix.reconcile.mixture import Scene
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
