"""EM of one surface whose samples are stored on a step: it reaches the maximum, however coarse the step is."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from tofmix.estimation.beam import Beam, Steps, beam_of
from tofmix.estimation.learnt import components as names
from tofmix.estimation.learnt.acceleration import maximise
from tofmix.estimation.learnt.components import Samples, fill_cells, fill_times
from tofmix.estimation.learnt.law import law_of
from tofmix.estimation.learnt.trials import new_workspace
from tofmix.sensor import NoiseCurve, Sensor

SIGMA_MM, MOST_ITERATIONS, TOLERANCE = 6.0, 50, 1.0e-3
LAW = law_of(None, background=(0.0, 1.0e9))


def beam_on(step_mm: float) -> Beam:
    curve = NoiseCurve(np.array([0.0, 8000.0]), np.array([SIGMA_MM, SIGMA_MM]))
    camera = Sensor(name="camera", range_min_mm=500.0, range_max_mm=8000.0, noise=curve)
    return beam_of(camera)._replace(steps=Steps(np.zeros(1), np.array([step_mm]), np.zeros(0)))


@pytest.mark.parametrize("frames", [30, 1000])
@pytest.mark.parametrize("step", [1.0, 5.0, 10.0])
def test_em_converges_within_the_default_iterations_to_the_most_likely_range(step: float, frames: int) -> None:
    rng, step_mm = np.random.default_rng(3), step * SIGMA_MM
    beam, work = beam_on(step_mm), new_workspace(3, frames, 1)
    for _ in range(20):
        place = rng.uniform(1500.0, 4500.0)
        value = np.sort(step_mm * np.rint((place + SIGMA_MM * rng.standard_normal(frames)) / step_mm))
        data = Samples(value, np.zeros(frames))
        fill_times(data, work.scratch)
        fill_cells(data, beam, work.scratch)
        work.fit[:] = 0.0
        work.fit[names.MEAN, 0], work.fit[names.SIGMA, 0] = np.median(value), SIGMA_MM
        work.fit[names.WEIGHT, 0] = 1.0
        assert maximise(data, 1, work.fit, LAW, beam, MOST_ITERATIONS, TOLERANCE, work.scratch) > 0

        def loss(mean: float, value: np.ndarray[tuple[int], np.dtype[np.float64]] = value) -> float:
            inside = ndtr((value + 0.5 * step_mm - mean) / SIGMA_MM) - ndtr((value - 0.5 * step_mm - mean) / SIGMA_MM)
            return -float(np.log(inside + 1e-300).sum())

        middle = float(value.mean())
        best = minimize_scalar(loss, bounds=(middle - 0.5 * step_mm, middle + 0.5 * step_mm), method="bounded")
        assert loss(float(work.fit[names.MEAN, 0])) == pytest.approx(best.fun, abs=0.05)


def steps_by_range(range_mm: list[float], step_mm: list[float]) -> Beam:
    return beam_on(1.0)._replace(steps=Steps(np.array(range_mm), np.array(step_mm), np.zeros(0)))


def test_steps_that_double_meet_at_their_ends() -> None:
    beam = steps_by_range([1024.0, 2048.0 * (1.0 - 1e-9), 2048.0, 4096.0], [16.0, 16.0, 32.0, 32.0])
    value = np.concatenate([np.arange(1920.0, 2048.0, 16.0), np.arange(2048.0, 2305.0, 32.0)])
    work = new_workspace(3, len(value), 1)
    data = Samples(value.copy(), np.zeros(len(value)))
    fill_cells(data, beam, work.scratch)
    half = work.scratch[names.CELL, : len(value)]
    between = 0.5 * (value[1:] + value[:-1])
    np.testing.assert_allclose((data.value - half)[1:], between, atol=1e-4)
    np.testing.assert_allclose((data.value + half)[:-1], between, atol=1e-4)


def test_steps_in_proportion_to_range_end_where_the_rounding_does() -> None:
    part = 0.02
    beam = steps_by_range([500.0, 8000.0], [500.0 * part, 8000.0 * part])
    number = np.arange(350, 410)
    work = new_workspace(3, len(number), 1)
    data = Samples(np.exp(part * number), np.zeros(len(number)))
    fill_cells(data, beam, work.scratch)
    half = work.scratch[names.CELL, : len(number)]
    step = data.value * part
    assert np.abs((data.value - half - np.exp(part * (number - 0.5))) / step).max() < 2e-3
    assert np.abs((data.value + half - np.exp(part * (number + 0.5))) / step).max() < 2e-3


def test_a_surface_where_the_step_doubles_is_at_its_most_likely_range() -> None:
    rng = np.random.default_rng(5)
    beam = steps_by_range([1024.0, 2048.0 * (1.0 - 1e-9), 2048.0, 4096.0], [15.0, 15.0, 30.0, 30.0])
    # The stored values are 2048 - 15 k below and 2048 + 30 k beyond; the cell of 2048 ends at 2040.5 and 2063.
    stored = np.concatenate([2048.0 - 15.0 * np.arange(10, 0, -1), 2048.0 + 30.0 * np.arange(10)])
    ends = np.concatenate([[-np.inf], 0.5 * (stored[1:] + stored[:-1]), [np.inf]])
    frames = 400
    work = new_workspace(3, frames, 1)
    for place in (2044.0, 2052.0, 2060.0):
        cell = np.searchsorted(ends, place + SIGMA_MM * rng.standard_normal(frames)) - 1
        data = Samples(np.sort(stored[cell]), np.zeros(frames))
        fill_times(data, work.scratch)
        fill_cells(data, beam, work.scratch)
        work.fit[:] = 0.0
        work.fit[names.MEAN, 0], work.fit[names.SIGMA, 0], work.fit[names.WEIGHT, 0] = place + 3.0, SIGMA_MM, 1.0
        assert maximise(data, 1, work.fit, LAW, beam, MOST_ITERATIONS, TOLERANCE, work.scratch) > 0

        def loss(mean: float, cell: np.ndarray[tuple[int], np.dtype[np.int64]] = cell) -> float:
            inside = ndtr((ends[cell + 1] - mean) / SIGMA_MM) - ndtr((ends[cell] - mean) / SIGMA_MM)
            return -float(np.log(inside + 1e-300).sum())

        best = minimize_scalar(loss, bounds=(2030.0, 2070.0), method="bounded")
        assert float(work.fit[names.MEAN, 0]) == pytest.approx(best.x, abs=0.1)
