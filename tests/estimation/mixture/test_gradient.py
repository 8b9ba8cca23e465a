"""The gradient bounds every gain, and matches finite differences."""

import numpy as np
import pytest
from support import naive
from support.drawing import draw
from support.sizes import sized

from tofmix.estimation.beam import beam_of
from tofmix.estimation.mixture.components import MEAN, SIGMA, TOTAL, WEIGHT, new_components, new_scratch
from tofmix.estimation.mixture.em import expectation_maximisation
from tofmix.estimation.mixture.gain_bound import best_share, steepest_place
from tofmix.estimation.samples import readings_of
from tofmix.estimation.settings import MODE_TIED
from tofmix.sensor import Sensor


@pytest.mark.slow
def test_no_second_surface_gains_more_than_the_steepest_slope(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    beam = beam_of(sensor)
    block = draw(rng, sensor, ranges_mm=[1500, 1530], shares=[0.7, 0.3], n=50, pixels=sized(20, 6))
    for column in np.sort(block, axis=0).T:
        samples, data = column.astype(np.float64), readings_of(column)
        fit, scratch = new_components(1), new_scratch(1, len(column))
        fit[MEAN, 0], fit[SIGMA, 0], fit[WEIGHT, 0] = samples.mean(), 25.0, 1 - beam.p_outlier
        expectation_maximisation(data, 1, fit, beam, MODE_TIED, 200, 1e-9, scratch)
        slope, place, _ = steepest_place(data, 1, fit, beam, scratch, 0.0)
        mean, sigma, weight = (fit[row, :1] for row in (MEAN, SIGMA, WEIGHT))
        one = naive.mixture_density(samples, mean, sigma, weight, 0.0, sensor)
        np.testing.assert_allclose(scratch[TOTAL], one, rtol=1e-9)

        # The slope is that of the likelihood as share moves there.
        def moved(share: float, place: float = place, one: naive.Array = one, samples: naive.Array = samples) -> float:
            assert sensor.noise is not None
            sigma = sensor.noise.sigma(np.array([place]))
            new = naive.mixture_density(samples, np.array([place]), sigma, np.array([1 - 1e-4]), 0.0, sensor)
            return float(np.log((1 - share) * one + share * new).sum())

        assert np.isclose((moved(1e-7) - moved(0)) / 1e-7, slope, rtol=1e-3, atol=0.05)
        two = naive.em(samples, np.array([samples.min(), samples.max()]), sensor, mode="tied", iterations=300)
        gain = np.log(naive.mixture_density(samples, *two, sensor)).sum() - np.log(one).sum()
        assert gain < slope + 0.1
        # and the best share is where it peaks
        best = best_share(data, place, beam, scratch)
        assert moved(best) >= max(moved(0.8 * best), moved(min(1.2 * best, 0.95))) - 1e-3 or slope < 0
