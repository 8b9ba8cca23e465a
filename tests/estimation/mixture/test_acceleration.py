"""Accelerated EM ends where EM ends, sooner."""

import numpy as np
import pytest
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.beam import beam_of
from tofmix.estimation.mixture.components import MEAN, new_components, new_scratch
from tofmix.estimation.mixture.em import (
    em_step,
    expectation_maximisation,
    log_likelihood,
    maximise_likelihood,
    start_at,
)
from tofmix.estimation.samples import readings_of
from tofmix.estimation.settings import MODE_FREE, MODE_PRIOR, MODE_TIED
from tofmix.sensor import Sensor


@pytest.mark.slow
@pytest.mark.parametrize("mode", [MODE_TIED, MODE_PRIOR, MODE_FREE])
def test_acceleration_converges_to_the_likelihood_of_em(mode: int, rng: np.random.Generator, sensor: Sensor) -> None:
    beam = beam_of(sensor)
    block = draw(rng, sensor, ranges_mm=[1500, 1560, 3500], shares=[0.4, 0.3, 0.2], n=150, pixels=sized(40, 4))
    sooner = []
    scratch = new_scratch(3, len(block))
    for column in block.T:
        samples = readings_of(column)
        fast, slow = new_components(3), new_components(3)
        for fit in (fast, slow):
            start_at(np.array([1480.0, 1580.0, 3500.0]), np.ones(3), 3, 0.1, fit, beam)
        n_fast = maximise_likelihood(samples, 3, fast, beam, mode, 2000, 1e-6, scratch)
        n_slow = expectation_maximisation(samples, 3, slow, beam, mode, 20000, 1e-9, scratch)
        assert n_fast > 0
        if mode != MODE_PRIOR:  # there EM climbs likelihood and prior together
            assert (
                log_likelihood(samples, 3, fast, beam, scratch) > log_likelihood(samples, 3, slow, beam, scratch) - 1e-3
            )
        before = fast[MEAN].copy()
        em_step(samples, 3, fast, beam, mode, scratch)
        np.testing.assert_allclose(fast[MEAN], before, atol=1e-3)
        sooner.append(n_fast < abs(n_slow))
    assert np.mean(sooner) > sized(0.9, 0.7)


@pytest.mark.slow
def test_acceleration_returns_negative_iterations_without_convergence(rng: np.random.Generator, sensor: Sensor) -> None:
    samples = readings_of(draw(rng, sensor, ranges_mm=[1500, 1540], shares=[0.5, 0.5], n=100, pixels=1))
    fit = new_components(2)
    start_at(np.array([1400.0, 1700.0]), np.ones(2), 2, 0.0, fit, beam_of(sensor))
    assert maximise_likelihood(samples, 2, fit, beam_of(sensor), MODE_TIED, 4, 1e-12, new_scratch(2, 100)) < 0
