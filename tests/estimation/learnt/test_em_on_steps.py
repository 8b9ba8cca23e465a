"""EM of one surface whose samples are stored on a step: it reaches the maximum, however coarse the step is."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from tofmix.estimation.beam import Beam, Steps, beam_of
from tofmix.estimation.learnt import components as names
from tofmix.estimation.learnt.acceleration import maximise
from tofmix.estimation.learnt.law import law_of
from tofmix.estimation.learnt.pixel_samples import Samples, fill_cells, fill_times
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
