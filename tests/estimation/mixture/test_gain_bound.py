"""The quick look: what it turns away would not have gained enough; what it cannot tell, it lets pass."""

import math

import numpy as np
import pytest
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.mixture.components import MEAN, SIGMA, WEIGHT
from tofmix.estimation.mixture.counting import LEAST_BOUND, Rules, Workspace, new_workspace, try_one_more
from tofmix.estimation.mixture.em import expectation_maximisation
from tofmix.estimation.mixture.gain_bound import gain_bound_of_clear, steepest_place
from tofmix.estimation.samples import Readings, readings_of
from tofmix.estimation.settings import MODE_TIED
from tofmix.sensor import Sensor

LEAST = 5.8
ALL = Rules(0.0, 1.0, 8, 0.0)


def _fitted(column: np.ndarray, start: list[float], sensor: Sensor) -> tuple[Readings, Beam, Workspace]:
    data, beam, work = readings_of(column), beam_of(sensor), new_workspace(8, len(column))
    k = len(start)
    work.fit[MEAN, :k], work.fit[SIGMA, :k], work.fit[WEIGHT, :k] = start, 20.0, (1 - beam.p_outlier) / k
    expectation_maximisation(data, k, work.fit, beam, MODE_TIED, 300, 1e-9, work.scratch)
    return data, beam, work


@pytest.mark.slow
def test_a_surface_that_gains_enough_has_a_bound_above_the_threshold(rng: np.random.Generator, sensor: Sensor) -> None:
    gaining, missed, quick = 0, 0, 0
    for shares, apart in (([0.5, 0.5], 45), ([0.9, 0.1], 80), ([0.97, 0.03], 120), ([1.0, 0.0], 0)):
        block = draw(rng, sensor, ranges_mm=[1500, 1500 + apart], shares=shares, n=100, pixels=sized(300, 15))
        for column in block.T:
            data, beam, work = _fitted(column, [float(column.mean())], sensor)
            bound = gain_bound_of_clear(data, 1, work.fit, beam, work.scratch, math.inf)
            quick += bound < LEAST_BOUND * LEAST
            gain = try_one_more(data, 1, work, beam, ALL)
            if gain >= LEAST:
                gaining += 1
                missed += bound < LEAST_BOUND * LEAST
    assert gaining > sized(400, 18)
    assert missed <= 1
    assert quick > sized(200, 8)  # it does turn pixels away


@pytest.mark.slow
def test_gain_bound_is_infinite_where_surfaces_overlap(rng: np.random.Generator, sensor: Sensor) -> None:
    near = draw(rng, sensor, ranges_mm=[1500, 1560], shares=[0.5, 0.5], n=100, pixels=1)[:, 0]
    data, beam, work = _fitted(near, [1490.0, 1570.0], sensor)
    assert gain_bound_of_clear(data, 2, work.fit, beam, work.scratch, math.inf) == math.inf
    away = np.append(draw(rng, sensor, ranges_mm=[1500], shares=[1.0], n=99, pixels=1)[:, 0], 3000.0)
    data, beam, work = _fitted(away, [1500.0], sensor)
    assert gain_bound_of_clear(data, 1, work.fit, beam, work.scratch, math.inf) == math.inf


@pytest.mark.slow
def test_gain_bound_agrees_with_the_exhaustive_search(rng: np.random.Generator, sensor: Sensor) -> None:
    block = draw(rng, sensor, ranges_mm=[1200, 3000], shares=[0.5, 0.5], n=200, pixels=sized(200, 30))
    both = []
    for column in block.T:
        data, beam, work = _fitted(column, [1200.0, 3000.0], sensor)
        quick = gain_bound_of_clear(data, 2, work.fit, beam, work.scratch, math.inf)
        both.append((quick, steepest_place(data, 2, work.fit, beam, work.scratch, math.inf)[2]))
    quick, full = np.array([pair for pair in both if np.isfinite(pair[0])]).T
    assert len(quick) > sized(150, 20)
    assert np.corrcoef(quick, full)[0, 1] > sized(0.8, 0.6)
