"""Searches that are no smooth fit: lattices and stuck pixels, and what only looks like them."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record

from tofmix.reconcile.likelihood import Likelihood
from tofmix.reconcile.links import find_lattice, find_stuck
from tofmix.reconcile.mixture import Scene
from tofmix.simulation.model import Model


@pytest.mark.parametrize("step", [2.5, 7.3, 12.5, 29.2])
def test_a_lattice_is_found(model: Model, record: Record, step: float) -> None:
    evidence = record(MAKE["quantisation"](step_mm=step))
    state = Likelihood(evidence, Scene(model, evidence.time_s)).start()
    found = find_lattice(evidence, state)
    assert found is not None
    assert found.step_mm == pytest.approx(step, abs=0.5 * step**2 / 4000)  # the steps that round to the same values


def test_whole_millimetres_are_no_lattice(model: Model, record: Record) -> None:
    evidence = record()
    assert find_lattice(evidence, Likelihood(evidence, Scene(model, evidence.time_s)).start()) is None


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
