"""The density of a stored sample: the noise integrated over its step."""

import numpy as np
import pytest
from scipy.stats import norm

from tofmix.estimation.learnt.law import Law, cell_information, density_at, edges_at, law_of, slope_at
from tofmix.noise_shape import NoiseShape

FLAT = (1.0, 1.0)
OFFSETS = (-0.4, 0.0, 0.3, 0.5)


def skewed() -> NoiseShape:
    z = np.linspace(-4.0, 10.0, 400)
    y = np.maximum(z + 3.0, 0.0)
    return NoiseShape.standardised(z, y**3 * np.exp(-1.5 * y))


@pytest.fixture(params=["gaussian", "skewed"], scope="module")
def law(request: pytest.FixtureRequest) -> Law:
    return law_of(None if request.param == "gaussian" else skewed(), background=FLAT)


@pytest.mark.parametrize("half", [0.05, 0.5, 1.7, 5.0])
@pytest.mark.parametrize("offset", OFFSETS)
def test_probabilities_of_all_cells_add_up_to_one(law: Law, half: float, offset: float) -> None:
    cells = 2.0 * half * (np.arange(-400, 401) + offset)
    total = sum(2.0 * half * density_at(z, half, law) for z in cells)
    assert total == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("half", [0.05, 0.5, 1.7])
def test_density_of_a_gaussian_cell_is_the_difference_of_its_distribution(half: float) -> None:
    gaussian = law_of(None, background=FLAT)
    for z in np.linspace(-4.0, 4.0, 33):
        exact = (norm.cdf(z + half) - norm.cdf(z - half)) / (2.0 * half)
        assert density_at(z, half, gaussian) == pytest.approx(exact, abs=2e-4)


def test_a_narrow_cell_has_the_density_of_the_noise(law: Law) -> None:
    for z in np.linspace(-3.0, 5.0, 17):
        assert density_at(z, 1e-3, law) == pytest.approx(density_at(z, 0.0, law), abs=2e-3)


@pytest.mark.parametrize("half", [0.3, 1.0, 1.7])
def test_slope_and_edges_are_the_derivatives_by_mean_and_log_width(law: Law, half: float) -> None:
    small = 0.01
    for z in np.linspace(-2.5, 3.5, 13):
        by_mean = (density_at(z - small, half, law) - density_at(z + small, half, law)) / (2.0 * small)
        assert slope_at(z, half, law) == pytest.approx(by_mean, abs=5e-3)

        def at_width(factor: float) -> float:
            return density_at(z / factor, half / factor, law) / factor  # noqa: B023  called here

        by_width = (at_width(1.0 + small) - at_width(1.0 - small)) / (2.0 * small)
        assert z * slope_at(z, half, law) - edges_at(z, half, law) == pytest.approx(by_width, abs=1e-2)


@pytest.mark.parametrize("step", [0.1, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("offset", OFFSETS)
def test_information_of_cells_is_the_mean_square_of_their_scores(step: float, offset: float) -> None:
    gaussian = law_of(None, background=FLAT)
    centre = step * (offset + np.arange(-200, 201))
    low, high = centre - 0.5 * step, centre + 0.5 * step
    p = norm.cdf(high) - norm.cdf(low)
    some = p > 1e-12
    by_mean = (norm.pdf(low) - norm.pdf(high))[some]
    by_width = (low * norm.pdf(low) - high * norm.pdf(high))[some]
    found = cell_information(step * offset, step, gaussian)
    expected = [(a * b / p[some]).sum() for a, b in ((by_mean, by_mean), (by_width, by_width), (by_mean, by_width))]
    np.testing.assert_allclose(found, expected, atol=5e-3)


def test_information_of_fine_cells_is_that_of_a_variance_with_rounding() -> None:
    gaussian = law_of(None, background=FLAT)
    for step in (0.2, 0.5, 1.0):
        location, width, _ = cell_information(0.1, step, gaussian)
        variance = 1.0 + step**2 / 12.0
        assert location == pytest.approx(1.0 / variance, rel=2e-3)
        assert width == pytest.approx(2.0 / variance**2, rel=2e-2)
