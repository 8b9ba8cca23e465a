"""Samples between two surfaces: as many as predicted where the model is right, more where pixels fly."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import MAKE, Record
from scipy.stats import norm

from tofmix.reconciliation.compare import compare
from tofmix.reconciliation.joint import joint_likelihood
from tofmix.reconciliation.panel import Curve, panel_axes
from tofmix.reconciliation.panel_between import bridging
from tofmix.reconciliation.way import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model


def _curves(model: Model, record: Record, *hidden: Effect, seed: int = 5) -> list[Curve]:
    likelihood = joint_likelihood([(model, record(*hidden, seed=seed))])
    part = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    panel = compare(likelihood, likelihood.start(), part, seed=1)
    return [c for c in panel.curves if c.statistic == "bridging"]


@pytest.mark.parametrize("seed", range(5, 11))
def test_none_where_the_model_is_right(model: Model, record: Record, seed: int) -> None:
    (curve,) = _curves(model, record, seed=seed)
    assert (np.abs(curve.value) < 3 * np.sqrt(curve.variance)).all()
    assert curve.z < 2


def test_they_show_flying_pixels(model: Model, record: Record) -> None:
    (curve,) = _curves(model, record, MAKE["flying_pixels"](probability=0.1))
    assert curve.value.max() > 0.03
    assert curve.z > 6


def test_outliers_between_are_expected_where_the_model_has_them(model: Model, record: Record) -> None:
    """The share of random values that falls between, against a count by hand."""
    likelihood = joint_likelihood([(model, record(MAKE["outliers"](probability=0.2)))])
    part = np.arange(likelihood.evidence.shape[0]), np.arange(likelihood.evidence.shape[1])
    state = likelihood.start()
    mixture = likelihood.scene.mixture((MAKE["outliers"](probability=0.2),))
    axes = list(panel_axes(likelihood.evidence, mixture, part))
    (with_them,) = bridging(likelihood.evidence, mixture, state, axes, part)
    (without,) = bridging(likelihood.evidence, likelihood.scene.mixture(), state, axes, part)
    assert without.z > 6
    assert (np.abs(with_them.value) < 3 * np.sqrt(with_them.variance)).all()


def test_a_lattice_moves_samples_between_the_surfaces(model: Model, record: Record) -> None:
    coarse = MAKE["quantisation"](step_mm=80.0)
    has = replace(model, effects=(coarse,))
    (curve,) = _curves(has, record, coarse)
    assert curve.z < 3


def test_flying_pixels_are_found_where_scores_cancel(model: Model, record: Record) -> None:
    """Of few mixed pixels, in some of which the nearer surface prevails and in some the farther one."""
    hidden = MAKE["flying_pixels"](probability=0.15)
    result = reconcile(model, record(hidden), Settings(kinds=("flying_pixels", "outliers", "excess_noise")))
    assert [n.effect.kind for n in result.named] == ["flying_pixels"]
    assert any(c.statistic == "bridging" and c.z > norm.isf(1e-4) for c in result.verified.before.curves)
    assert any(c.statistic == "bridging" and c.z < 3 for c in result.verified.after.curves)
