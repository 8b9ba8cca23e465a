"""Samples between two surfaces: as many as predicted where the model is right, more where pixels fly."""

import numpy as np
import pytest
from support.recordings import MAKE, Record

from tofmix.reconciliation.comparison.compare import compare
from tofmix.reconciliation.comparison.panel import Curve
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model


def _curves(model: Model, record: Record, *hidden: Effect, seed: int = 5) -> list[Curve]:
    likelihood = joint_likelihood([(model, record(*hidden, seed=seed))])
    part = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    panel = compare(likelihood, likelihood.start(), part, seed=1)
    return [c for c in panel.curves if c.statistic == "bridging"]


@pytest.mark.parametrize("seed", range(5, 11))
def test_samples_between_surfaces_are_as_predicted_where_the_model_is_right(
    model: Model, record: Record, seed: int
) -> None:
    (curve,) = _curves(model, record, seed=seed)
    assert (np.abs(curve.value) < 3 * np.sqrt(curve.variance)).all()
    assert curve.z < 2


def test_flying_pixels_are_more_samples_between_surfaces(model: Model, record: Record) -> None:
    (curve,) = _curves(model, record, MAKE["flying_pixels"](probability=0.1))
    assert curve.value.max() > 0.03
    assert curve.z > 6
