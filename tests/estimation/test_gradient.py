"""The gradient's promises: it bounds every gain, and it is what it says."""

import naive
import numpy as np
from drawing import draw

from tofmix.estimation.beam import beam_of
from tofmix.estimation.gradient import best_share, steepest_place
from tofmix.estimation.mixture import expectation_maximisation, new_components
from tofmix.estimation.settings import MODE_TIED
from tofmix.sensor import Sensor


def test_no_second_surface_gains_more_than_the_steepest_slope(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    beam = beam_of(sensor)
    block = draw(rng, sensor, ranges_mm=[1500, 1530], shares=[0.7, 0.3], n=50, pixels=40)
    for column in np.sort(block, axis=0).T:
        samples = column.astype(np.float64)
        fit = new_components(1)
        fit.mean[0], fit.sigma[0], fit.weight[0] = samples.mean(), 25.0, 1 - beam.p_outlier
        expectation_maximisation(samples, 1, fit, beam, MODE_TIED, 200, 1e-9)
        densities = np.zeros(len(samples))
        slope, place = steepest_place(samples, 1, fit, beam, densities)
        one = naive.mixture_density(samples, fit.mean, fit.sigma, fit.weight, 0.0, sensor)
        np.testing.assert_allclose(densities, one, rtol=1e-9)

        # The slope is that of the likelihood as share moves there.
        def moved(share: float, place: float = place, one: naive.Array = one, samples: naive.Array = samples) -> float:
            assert sensor.noise is not None
            sigma = sensor.noise.sigma(np.array([place]))
            new = naive.mixture_density(samples, np.array([place]), sigma, np.array([1 - 1e-4]), 0.0, sensor)
            return float(np.log((1 - share) * one + share * new).sum())

        assert np.isclose((moved(1e-6) - moved(0)) / 1e-6, slope, rtol=1e-3, atol=0.05)
        two = naive.em(samples, np.array([samples.min(), samples.max()]), sensor, mode="tied", iterations=300)
        gain = np.log(naive.mixture_density(samples, *two, sensor)).sum() - np.log(one).sum()
        assert gain < slope + 0.1
        # and the best share is where it peaks
        best = best_share(samples, place, beam, densities)
        assert moved(best) >= max(moved(0.8 * best), moved(min(1.2 * best, 0.95))) - 1e-3 or slope < 0
