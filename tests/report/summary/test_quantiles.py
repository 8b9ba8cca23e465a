import numpy as np
import pytest

from tofmix.report.summary.quantiles import ValueCounts


def test_few_values_give_numpys_quantiles() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(0, 1000, 3001).astype(np.float32)
    counts = ValueCounts()
    for block in np.array_split(values, 7):
        counts.add(block)
    probabilities = [0.0, 0.05, 0.5, 0.777, 1.0]
    expected = np.quantile(values.astype(np.float64), probabilities)
    np.testing.assert_allclose(np.array(counts.quantiles(*probabilities), dtype=float), expected, rtol=1e-12)
    assert counts.count == values.size


def test_memory_stays_bounded_and_quantiles_close() -> None:
    rng = np.random.default_rng(2)
    counts = ValueCounts(limit=4096)
    values = rng.uniform(650, 7500, 200_000).astype(np.float32)
    for block in np.array_split(values, 100):
        counts.add(block)
    assert counts.count == values.size
    assert counts._keys.size <= 4096
    quantiles = np.array(counts.quantiles(0.05, 0.5, 0.95), dtype=float)
    np.testing.assert_allclose(quantiles, np.quantile(values, [0.05, 0.5, 0.95]), rtol=1e-3)


def test_order_of_blocks_does_not_matter() -> None:
    values = np.random.default_rng(3).uniform(-50, 50, 20_000).astype(np.float32)
    forward, backward = ValueCounts(limit=1000), ValueCounts(limit=1000)
    for block in np.array_split(values, 9):
        forward.add(block)
    for block in np.array_split(values[::-1], 31):
        backward.add(block)
    assert forward.quantiles(0.1, 0.5, 0.9) == backward.quantiles(0.1, 0.5, 0.9)


@pytest.mark.parametrize("value", [-3.5, -0.0, 0.0, 1e-30, 7500.0, np.finfo(np.float32).max])
def test_single_value_is_every_quantile(value: float) -> None:
    counts = ValueCounts()
    counts.add(np.full(5, value, dtype=np.float32))
    assert counts.quantiles(0.0, 0.5, 1.0) == [float(np.float32(value))] * 3


def test_quantiles_without_finite_values_are_none() -> None:
    counts = ValueCounts()
    counts.add(np.array([np.nan, np.inf, -np.inf], dtype=np.float32))
    assert counts.quantiles(0.5) == [None]
    assert counts.count == 0


def test_largest_values_stay_finite_when_coarse() -> None:
    counts = ValueCounts(limit=2)
    counts.add(np.array([1.0, 2.0, 3.0, 3.4e38], dtype=np.float32))
    assert np.isfinite(np.array(counts.quantiles(0.0, 1.0), dtype=float)).all()
