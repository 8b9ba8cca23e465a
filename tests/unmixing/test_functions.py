"""Functions in NumPy give what SciPy gives."""

import numpy as np
import pytest
from scipy import special, stats

from tofmix.unmixing.functions import binomial_most, chi_square_6, logsumexp, ndtr


def test_probabilities_of_a_gaussian_are_scipys_to_the_last_digits() -> None:
    x = np.concatenate([np.linspace(-40.0, 40.0, 40001), np.geomspace(1e-300, 1e3, 5000), [np.inf, -np.inf, 0.0]])
    np.testing.assert_allclose(ndtr(x), special.ndtr(x), rtol=4e-15, atol=1e-300)
    np.testing.assert_allclose(ndtr(-x), special.ndtr(-x), rtol=4e-15, atol=1e-300)
    assert np.isnan(ndtr(np.array([np.nan]))[0])


def test_sums_of_exponentials_are_scipys_also_where_a_term_or_all_are_none(rng: np.random.Generator) -> None:
    logs = rng.normal(0.0, 300.0, (5, 1000))
    logs[rng.random(logs.shape) < 0.3] = -np.inf
    logs[:, 0] = -np.inf
    np.testing.assert_allclose(logsumexp(logs), special.logsumexp(logs, axis=0), rtol=1e-14)


@pytest.mark.parametrize("probability", [1e-12, 1e-6, 0.01, 0.5, 0.999, 1.0 - 1e-9])
def test_limits_of_chi_square_are_scipys(probability: float) -> None:
    assert chi_square_6(probability) == pytest.approx(float(special.chdtri(6, probability)), rel=1e-7)
    assert stats.chi2.sf(chi_square_6(probability), 6) == pytest.approx(probability, rel=1e-12)


@pytest.mark.parametrize("share", [1e-4, 0.01, 0.3])
@pytest.mark.parametrize("probability", [0.5, 0.99, 1.0 - 1e-6])
def test_most_successes_are_scipys(share: float, probability: float) -> None:
    trials = np.append(np.arange(1, 1200, 7), [3000, 7000, 30_000]).reshape(5, -1)
    expected = stats.binom.ppf(probability, trials, share)
    np.testing.assert_array_equal(binomial_most(probability, trials, share), expected)
