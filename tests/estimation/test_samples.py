"""Sorting the samples of a block, against NumPy, and binning them, against fits of every sample."""

import numpy as np
import pytest
from benchmarks import binning
from support.sizes import sized

from tofmix.arrays import FloatArray
from tofmix.compiled.vector import LANES
from tofmix.estimation.samples import BIN, FARTHEST_MM, LONG_WINDOW, Readings, gather, padded, sort_samples


def test_valid_samples_come_first_and_ascend(rng: np.random.Generator) -> None:
    block = rng.normal(1000, 100, (50, 7)).astype(np.float32)
    block[rng.random(block.shape) < 0.2] = np.nan
    block[3, 2], block[4, 2] = np.inf, 10 * FARTHEST_MM
    ordered = sort_samples(block)
    for pixel in range(7):
        valid = block[np.isfinite(block[:, pixel]) & (block[:, pixel] < FARTHEST_MM), pixel]
        assert ordered.valid[pixel] == len(valid)
        np.testing.assert_array_equal(ordered.values[pixel, : len(valid)], np.sort(valid))


def _gathered(values: FloatArray, sigma_mm: float) -> Readings:
    scratch = np.empty(padded(len(values))), np.empty(padded(len(values)))
    return gather(values, len(values), np.array([1000.0]), np.array([sigma_mm]), *scratch)


@pytest.mark.slow
def test_last_group_is_padded_with_values_of_count_zero() -> None:
    data = _gathered(np.array([1.0, 2.0, 2.0, 5.0]), 10.0)
    assert data.value.tolist() == [1.0, 2.0] + [5.0] * (LANES - 2)
    assert data.times.tolist() == [1.0, 2.0, 1.0] + [0.0] * (LANES - 3)
    assert data.total == 4.0


def test_bins_keep_the_mean_and_lose_little_spread(rng: np.random.Generator) -> None:
    values = np.sort(rng.normal(1000.0, 20.0, LONG_WINDOW))
    data = _gathered(values, 20.0)
    assert data.times.sum() == LONG_WINDOW
    assert np.count_nonzero(data.times) < LONG_WINDOW / 5
    assert data.value @ data.times / LONG_WINDOW == pytest.approx(values.mean(), rel=1e-12)
    spread = data.value**2 @ data.times / LONG_WINDOW - values.mean() ** 2
    assert 0.0 < values.var() - spread < BIN**2 / 12.0 * 20.0**2 * 1.5


@pytest.mark.slow
@pytest.mark.parametrize(
    "samples", [1000, pytest.param(10_000, marks=pytest.mark.compiled("fits of 10,000 samples each"))]
)
def test_binning_moves_no_fit_by_a_hundredth_of_its_standard_error(samples: int, rng: np.random.Generator) -> None:
    for surfaces in (1, 2, 3):
        means, shares, left = binning.errors(samples, surfaces, sized(10, 2), rng)
        assert np.abs(means).max() < 0.01
        assert np.abs(shares).max() < 0.01
        assert left < 200
    assert np.abs(means).max() > 0.0  # it was binned
