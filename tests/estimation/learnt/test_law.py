"""Tables of the learnt shape, densities of stored samples, and the fits of shape and sigma."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import integrate, optimize, stats
from scipy.stats import norm
from support.learnt_pixels import KNOWN

from tofmix.estimation.learnt.law import (
    REACH,
    SCALE_OF_SPREAD,
    STEPS,
    Law,
    at_table,
    cell_information,
    density_at,
    edges_at,
    law_of,
    log_prior_t,
    precision_of_t,
    slope_at,
)
from tofmix.noise_shape import TAIL_DEGREES, NoiseShape

Z = np.linspace(-REACH, REACH, int(2 * REACH * STEPS) + 1)
FLAT = (1.0, 10.0)


def _shape_of(name: str) -> NoiseShape | None:
    return None if name == "gaussian" else KNOWN[name].shape()


@pytest.mark.parametrize("name", KNOWN)
def test_table_has_an_area_of_1_and_follows_the_density(name: str) -> None:
    law = law_of(_shape_of(name), background=FLAT)
    assert integrate.trapezoid(law.density, Z) == pytest.approx(1.0, abs=1e-6)
    # Between its points a table is a line: half a percent of a density's peak where it is sharp.
    assert np.abs(law.density - KNOWN[name].pdf(Z)).max() < 0.005 * KNOWN[name].pdf(np.linspace(-3, 3, 601)).max()


def test_table_is_read_off_linearly_and_is_scipys_gaussian_without_a_shape() -> None:
    law = law_of(None, background=FLAT)
    np.testing.assert_allclose(law.density, stats.norm.pdf(Z), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(law.slope, Z * stats.norm.pdf(Z), rtol=1e-12, atol=1e-15)
    assert law.information == pytest.approx(1.0, abs=1e-9)
    assert law.width_information == pytest.approx(2.0, abs=1e-9)
    assert law.cross_information == pytest.approx(0.0, abs=1e-9)
    table = law_of(KNOWN["skewed"].shape(), background=FLAT).density
    for z in np.linspace(-REACH + 0.01, REACH - 0.01, 77):
        assert at_table(float(z), table) == pytest.approx(float(np.interp(z, Z, table)), abs=1e-12)
    assert at_table(-REACH - 1.0, table) == 0.0
    assert at_table(REACH + 1.0, table) == 0.0
    assert at_table(math.nan, table) == 0.0


@pytest.mark.parametrize("name", ["skewed", "student", "laplace"])
def test_information_is_that_of_an_integral_over_the_true_density(name: str) -> None:
    known, law = KNOWN[name], law_of(_shape_of(name), background=FLAT)

    def score(z: float) -> float:
        step = 1e-5
        return float(np.log(known.pdf(z + step) / known.pdf(z - step)) / (2.0 * step))

    low = (0.0 - known.middle) / known.half + 1e-3 if name == "skewed" else -20.0

    def mean(of: Callable[[float], float]) -> float:
        parts = [(low, 0.0), (0.0, 20.0)]
        return sum(integrate.quad(lambda z: float(known.pdf(z)) * of(z), a, b, limit=200)[0] for a, b in parts)

    # At its end a gamma of 4 rises as z^3. A table has a corner there: (f' / f)^2 is larger.
    margin = 0.10 if name == "skewed" else 0.02
    assert law.information == pytest.approx(mean(lambda z: score(z) ** 2), rel=margin)
    assert law.width_information == pytest.approx(mean(lambda z: (z * score(z) + 1.0) ** 2), rel=margin)
    assert law.cross_information == pytest.approx(mean(lambda z: score(z) * (z * score(z) + 1.0)), rel=margin, abs=0.02)


@pytest.mark.parametrize("name", KNOWN)
def test_slope_is_the_fall_of_the_density_and_the_ends_hold_what_is_worth_a_look(name: str) -> None:
    law = law_of(_shape_of(name), background=FLAT)
    away = np.abs(Z[1:-1]) > 0.1  # a Laplace density has a corner at 0
    differences = -(law.density[2:] - law.density[:-2]) * STEPS / 2.0
    np.testing.assert_allclose(law.slope[1:-1][away], differences[away], atol=2e-3)
    outside = ~((law.low <= Z) & (law.high >= Z))
    assert law.density[outside].max() <= 1e-4 * law.density.max()


@pytest.mark.parametrize("value", [-3.0, -0.2, 0.0, 0.4, 5.0])
@pytest.mark.parametrize("scale", [0.3, 2.0])
def test_prior_is_students_t_over_its_peak_and_its_precision_the_slope_of_its_logarithm(
    value: float, scale: float
) -> None:
    prior = stats.t(TAIL_DEGREES, scale=scale)
    assert log_prior_t(value, scale) == pytest.approx(float(prior.logpdf(value) - prior.logpdf(0.0)), abs=1e-12)
    if value != 0.0:
        step = 1e-6
        slope = float(prior.logpdf(value + step) - prior.logpdf(value - step)) / (2.0 * step)
        assert -precision_of_t(value, scale) * value == pytest.approx(slope, rel=1e-5)


def test_scale_of_the_prior_is_the_likeliest_and_none_costs_nothing() -> None:
    assert log_prior_t(3.0, 0.0) == 0.0

    def loss(scale: float) -> float:
        mean, _ = integrate.quad(lambda x: stats.norm.pdf(x) * stats.t.logpdf(x, TAIL_DEGREES, scale=scale), -12, 12)
        return -float(mean)

    best = optimize.minimize_scalar(loss, bounds=(0.5, 1.2), method="bounded", options={"xatol": 1e-6}).x
    assert round(float(best), 3) == SCALE_OF_SPREAD


FLAT_CELLS = (1.0, 1.0)
OFFSETS = (-0.4, 0.0, 0.3, 0.5)


def skewed() -> NoiseShape:
    z = np.linspace(-4.0, 10.0, 400)
    y = np.maximum(z + 3.0, 0.0)
    return NoiseShape.standardised(z, y**3 * np.exp(-1.5 * y))


@pytest.fixture(params=["gaussian", "skewed"], scope="module")
def law(request: pytest.FixtureRequest) -> Law:
    return law_of(None if request.param == "gaussian" else skewed(), background=FLAT_CELLS)


@pytest.mark.parametrize("half", [0.05, 0.5, 1.7, 5.0])
@pytest.mark.parametrize("offset", OFFSETS)
def test_probabilities_of_all_cells_add_up_to_one(law: Law, half: float, offset: float) -> None:
    cells = 2.0 * half * (np.arange(-400, 401) + offset)
    total = sum(2.0 * half * density_at(z, half, law) for z in cells)
    assert total == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("half", [0.05, 0.5, 1.7])
def test_density_of_a_gaussian_cell_is_the_difference_of_its_distribution(half: float) -> None:
    gaussian = law_of(None, background=FLAT_CELLS)
    for z in np.linspace(-4.0, 4.0, 33):
        exact = (norm.cdf(z + half) - norm.cdf(z - half)) / (2.0 * half)
        assert density_at(z, half, gaussian) == pytest.approx(exact, abs=2e-4)


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
    gaussian = law_of(None, background=FLAT_CELLS)
    centre = step * (offset + np.arange(-200, 201))
    low, high = centre - 0.5 * step, centre + 0.5 * step
    p = norm.cdf(high) - norm.cdf(low)
    some = p > 1e-12
    by_mean = (norm.pdf(low) - norm.pdf(high))[some]
    by_width = (low * norm.pdf(low) - high * norm.pdf(high))[some]
    found = cell_information(step * offset, step, gaussian)
    expected = [(a * b / p[some]).sum() for a, b in ((by_mean, by_mean), (by_width, by_width), (by_mean, by_width))]
    np.testing.assert_allclose(found, expected, atol=5e-3)
