"""The functions that vectorise, against NumPy."""

import numpy as np
import pytest

from tofmix.compiled.jit import jit
from tofmix.compiled.vector import exp_minus, log_of, moments_of, product_of, sums_of, total_of


@jit
def _each(x: np.ndarray, e: np.ndarray, log: np.ndarray) -> None:
    for j in range(len(x)):
        e[j] = exp_minus(x[j])
        log[j] = log_of(x[j])


def test_vector_exponential_and_logarithm_agree_with_numpy(rng: np.random.Generator) -> None:
    x = np.concatenate([rng.uniform(0, 20, 5000), rng.uniform(20, 400, 1000), 10.0 ** rng.uniform(-300, 300, 5000)])
    x = np.concatenate([x, [1.0, np.sqrt(2), 2.0, np.nextafter(1, 0), 1e-300]])
    e, log = np.empty_like(x), np.empty_like(x)
    _each(x, e, log)
    near, far = x <= 20, (x > 20) & (x <= 400)
    np.testing.assert_allclose(e[near], np.exp(-x[near]), rtol=1e-10)
    np.testing.assert_allclose(e[far], np.exp(-x[far]), rtol=1e-2)
    assert np.all(e > 0)
    np.testing.assert_allclose(log, np.log(x), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("n", [0, 1, 3, 4, 7, 8, 101])
def test_vector_sums_agree_with_numpy(n: int, rng: np.random.Generator) -> None:
    a, b, c = rng.normal(size=(3, n))
    longer = np.append(b, 99.0)
    assert total_of(a) == pytest.approx(a.sum())
    assert product_of(a, longer) == pytest.approx(a @ b)
    assert sums_of(a, longer) == pytest.approx((a.sum(), a @ b))
    away = a - 0.3
    expected = [(b * c).sum(), (b * c * away).sum(), (b * c * away**2).sum()]
    assert moments_of(a, longer, c, 0.3) == pytest.approx(expected)
