"""The step of quantised samples, against the one that made them."""

import numpy as np
import pytest
from support.recordings import MAKE, Record

from tofmix.reconciliation.likelihood.hidden_fits import find_lattice
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.simulation.model import Model


@pytest.mark.parametrize(
    "step", [1.83, 12.5, *(pytest.param(step, marks=pytest.mark.slow) for step in (2.5, 7.3, 29.2))]
)
def test_step_of_quantised_samples_is_found(model: Model, record: Record, step: float) -> None:
    evidence = record(MAKE["quantisation"](step_mm=step))
    state = Likelihood(evidence, Scene(model, evidence.time_s)).start()
    found = find_lattice(evidence, state)
    assert found is not None
    assert found == pytest.approx(step, abs=0.5 * step**2 / 4000)  # the steps that round to the same values


@pytest.mark.parametrize("step", [30.227108, *(pytest.param(step, marks=pytest.mark.slow) for step in (7.3291, 17.03))])
def test_values_are_rounded_multiples_of_the_found_step(model: Model, record: Record, step: float) -> None:
    """Far multiples determine the last digits; a multiple that rounds otherwise leaves its samples unexplained."""
    evidence = record(MAKE["quantisation"](step_mm=step), MAKE["outliers"](probability=0.01))
    found = find_lattice(evidence, Likelihood(evidence, Scene(model, evidence.time_s)).start())
    assert found is not None
    values = np.unique(evidence.samples[evidence.samples > 0]).astype(np.float64)
    nearest = np.rint(np.rint(values / found) * found)
    true = np.rint(np.rint(values / step) * step)
    assert (nearest == values).sum() >= (true == values).sum() > 100


def test_whole_millimetres_are_no_lattice(model: Model, record: Record) -> None:
    evidence = record()
    assert find_lattice(evidence, Likelihood(evidence, Scene(model, evidence.time_s)).start()) is None
