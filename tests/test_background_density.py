"""The density of random values over range: an area of 1, draws that follow it, and refusals."""

import numpy as np
import pytest

from tofmix.noise_shape import BackgroundDensity

FOG = BackgroundDensity(np.array([0.0, 200.0, 700.0, 2000.0, 9000.0]), np.array([1e-3, 8.0, 3.0, 0.2, 0.01]))


def test_the_area_of_a_density_is_one_whatever_its_scale() -> None:
    at = np.linspace(0.0, 9000.0, 90_001)
    assert np.trapezoid(FOG.at(at), at) == pytest.approx(1.0, abs=1e-6)
    assert BackgroundDensity(FOG.range_mm, FOG.density).same_as(FOG)


def test_the_uniform_density_is_one_over_the_length() -> None:
    uniform = BackgroundDensity.uniform(300.0, 5300.0)
    np.testing.assert_allclose(uniform.at([0.0, 300.0, 1000.0, 9000.0]), 2e-4, rtol=1e-12)
    np.testing.assert_allclose(uniform.quantile([0.0, 0.25, 1.0]), [300.0, 1550.0, 5300.0], rtol=1e-12)


def test_quantiles_invert_the_area_below() -> None:
    chance = np.linspace(0.0, 1.0, 101)
    at = np.linspace(0.0, 9000.0, 900_001)
    below = np.concatenate([[0.0], np.cumsum(0.5 * (FOG.at(at)[1:] + FOG.at(at)[:-1]) * np.diff(at))])
    np.testing.assert_allclose(np.interp(FOG.quantile(chance), at, below), chance, atol=1e-6)


@pytest.mark.parametrize(
    ("range_mm", "density", "said"),
    [
        ([0.0], [1.0], "at least 2"),
        ([0.0, 1.0, 2.0], [1.0, 1.0], "one length"),
        ([0.0, 1.0, 1.0], [1.0, 1.0, 1.0], "do not ascend"),
        ([0.0, 1.0], [1.0, 0.0], "not above 0"),
        ([0.0, 1.0], [1.0, np.nan], "not finite"),
    ],
)
def test_a_density_that_cannot_be_is_refused(range_mm: list[float], density: list[float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        BackgroundDensity(np.array(range_mm), np.array(density))
