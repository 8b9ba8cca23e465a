"""Quantised samples by their distinct values, against the pass over samples and numerical derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from support.recordings import MAKE, recorded

from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.one.steps_kernel import DistinctValues, by_values, is_static
from tofmix.simulation.model import Model

STEP = MAKE["quantisation"](step_mm=40.0)


def test_values_and_derivatives_are_those_of_all_samples(small: Model) -> None:
    like = joint_likelihood([(small, recorded(small, STEP, MAKE["dropout"](probability=0.05)))])
    state = replace(like.start(), effects=(STEP,))
    mixture = like.mixture(state)
    assert is_static(mixture)
    part = tuple(np.arange(n) for n in like.evidence.shape)
    bias = np.random.default_rng(1).normal(0, 5, part[1].size)
    values = DistinctValues.of(like.evidence.samples)
    found = by_values(values, mixture, bias)
    whole = like.sums(mixture, state, (part[0], part[1]), bias=bias).by_pixel[:, 0]
    assert found[:, 0] == pytest.approx(whole, rel=1e-6)
    up, here, down = (by_values(values, mixture, bias + d)[:, 0] for d in (0.05, 0.0, -0.05))
    assert found[:, 1] == pytest.approx((up - down) / 0.1, rel=1e-3, abs=1e-3)
    assert found[:, 2] == pytest.approx((2 * here - up - down) / 0.05**2, rel=1e-2, abs=1e-3)


def test_a_mixture_that_changes_in_time_or_has_no_step_is_not_static(small: Model) -> None:
    like = joint_likelihood([(small, recorded(small))])
    assert not is_static(like.mixture(like.start()))
    drift = MAKE["temperature_drift"](amplitude_mm=10.0, time_constant_s=1.0)
    assert not is_static(like.mixture(replace(like.start(), effects=(STEP, drift))))
