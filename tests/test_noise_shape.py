"""The shape of noise: an area of 1, the median 0, the width of a Gaussian; draws and chances go with its density."""

import numpy as np
import pytest
from scipy import stats

from tofmix.noise_shape import NoiseShape

Z = np.linspace(-12.0, 12.0, 2401)


def test_gaussian_table_has_the_chances_and_moments_of_a_gaussian() -> None:
    shape = NoiseShape(Z, stats.norm.pdf(Z))
    at = np.linspace(-4.0, 4.0, 33)
    np.testing.assert_allclose(shape.cdf(at), stats.norm.cdf(at), atol=5e-6)
    np.testing.assert_allclose(shape.quantile(stats.norm.cdf(at)), at, atol=1e-4)
    np.testing.assert_allclose(shape.moments(), [0.0, 1.0, 0.0, 0.0], atol=1e-3)


def test_standardised_moves_any_density_to_median_0_and_width_1() -> None:
    places = np.linspace(0.0, 400.0, 4001)
    shape = NoiseShape.standardised(places, stats.gamma.pdf(places, 4.0, scale=10.0))
    low, middle, high = shape.quantile(stats.norm.cdf([-1.0, 0.0, 1.0]))
    assert middle == pytest.approx(0.0, abs=1e-9)
    assert high - low == pytest.approx(2.0, abs=1e-9)
    assert shape.moments()[2] == pytest.approx(1.0, abs=0.01)  # 2 / sqrt(4)


def test_shape_rebuilt_from_its_numbers_is_equal_to_the_last_digit() -> None:
    rng = np.random.default_rng(4)
    for points in (11, 57, 200):
        once = NoiseShape.standardised(np.sort(rng.normal(0.0, 3.0, points)), rng.uniform(0.1, 1.0, points))
        assert NoiseShape(once.z, once.density).same_as(once)


def test_quantile_undoes_cdf_where_density_has_a_corner_or_is_0() -> None:
    shape = NoiseShape.standardised([-3.0, -1.0, 0.0, 2.0, 3.0, 6.0], [0.0, 1.0, 2.0, 0.1, 0.0, 0.0])
    chance = np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(shape.cdf(shape.quantile(chance)), chance, atol=1e-12)


@pytest.mark.parametrize(
    ("z", "density", "text"),
    [
        ([0.0, 1.0], [1.0, 1.0], "at least 3"),
        ([0.0, 2.0, 1.0], [1.0, 1.0, 1.0], "ascend"),
        ([-1.0, 0.0, 1.0], [1.0, -1.0, 1.0], "at least 0"),
        ([-1.0, 0.0, 1.0], [0.0, 0.0, 0.0], "above 0"),
        ([-1.0, 0.0, np.inf], [1.0, 1.0, 1.0], "finite"),
        (Z + 1.0, stats.norm.pdf(Z), "got 1 and 1"),
        (2.0 * Z, stats.norm.pdf(Z), "and 2"),
    ],
)
def test_invalid_noise_shapes_are_refused_with_the_reason(z: list[float], density: list[float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        NoiseShape(np.array(z), np.array(density))
