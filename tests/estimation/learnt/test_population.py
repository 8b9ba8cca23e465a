"""Widths of pixels and pairs of surfaces: populations compared by their likelihood."""

import itertools

import numpy as np
import pytest
from scipy.stats import norm

from tofmix.arrays import FloatArray
from tofmix.estimation.learnt.law import law_of
from tofmix.estimation.learnt.population import population_likelihoods, spread_beside_pairs

LAW = law_of(None, background=(0.1, 10.0))
CLUSTERS, FRAMES = 300, 100
FIRST_SCALE = 9.0


def errors(*, spread: float, apart: float, step: float) -> FloatArray:
    """Errors (cluster, frame), in sigmas, of pixels whose log widths spread, a quarter of them pairs, on a step."""
    rng = np.random.default_rng(1)
    out = np.exp(spread * rng.standard_normal((CLUSTERS, 1))) * rng.standard_normal((CLUSTERS, FRAMES))
    pairs = CLUSTERS // 4
    out[:pairs] += apart * (rng.random((pairs, FRAMES)) < 0.5)
    if step > 0.0:
        place = rng.uniform(0.0, step, (CLUSTERS, 1))
        out = step * np.rint((out + place) / step) - place
    return np.asarray(out - out.mean(axis=1, keepdims=True))


def spread_of(error: FloatArray, step: float) -> float | None:
    each = np.ones(len(error))
    return spread_beside_pairs(
        error, half=0.5 * step * each, rest=0.005 * each, span=32.0 * each, law=LAW, scale=FIRST_SCALE
    )


@pytest.mark.parametrize("step", [0.0, 1.0])
@pytest.mark.parametrize("apart", [2.0, 3.0])
def test_pairs_of_equal_widths_have_no_spread_of_widths(apart: float, step: float) -> None:
    assert spread_of(errors(spread=0.0, apart=apart, step=step), step) is None


@pytest.mark.parametrize("step", [0.0, 1.0])
@pytest.mark.parametrize("spread", [0.1, 0.3])
def test_widths_without_pairs_keep_the_spread_that_was_measured(spread: float, step: float) -> None:
    assert spread_of(errors(spread=spread, apart=0.0, step=step), step) == FIRST_SCALE


@pytest.mark.parametrize("step", [0.0, 1.0])
def test_widths_beside_pairs_have_their_own_spread(step: float) -> None:
    found = spread_of(errors(spread=0.3, apart=3.0, step=step), step)
    assert found is not None
    assert found == pytest.approx(0.3 * 0.831, rel=0.45)  # the scales that are tried are 41 % apart


def test_equal_widths_of_one_surface_leave_the_choice_to_held_out_pixels() -> None:
    assert spread_of(errors(spread=0.0, apart=0.0, step=0.0), 0.0) == FIRST_SCALE


@pytest.mark.parametrize("step", [0.6, 3.0])
def test_likelihood_is_the_integral_over_places_of_the_product_over_cells(step: float) -> None:
    error = errors(spread=0.0, apart=2.0, step=step)[:3]
    pairs, log_widths = np.array([[0.0, 1.0], [2.0, 0.3]]), np.array([-0.2, 0.3])
    each = np.ones(3)
    found = population_likelihoods(error, 0.5 * step * each, 0.1 * each, 32.0 * each, LAW, pairs, log_widths)
    assert found.shape == (3, 2, 2)
    naive = np.zeros(found.shape)
    for c, p, u in itertools.product(range(3), range(2), range(2)):
        (apart, share), width = pairs[p], np.exp(log_widths[u])
        mean = np.linspace(-6.0, 6.0, 2401)[:, None] - (1.0 - share) * apart
        density = np.zeros((len(mean), FRAMES))
        for place, part in ((mean, share), (mean + apart, 1.0 - share)):
            low, high = ((error[c] + side * step - place) / width for side in (-0.5, 0.5))
            density += 0.9 * part * (norm.cdf(high) - norm.cdf(low)) / step
        logs = np.log(density + 0.1 / 32.0).sum(axis=1)
        naive[c, p, u] = logs.max() + np.log(np.exp(logs - logs.max()).sum())
    # Up to a number of the cluster; fifteen places and tables of the distribution are exact to 0.15 nat.
    np.testing.assert_allclose(found - found[:, :1, :1], naive - naive[:, :1, :1], atol=0.15)
