"""Sorting the samples of a block, against NumPy."""

import numpy as np

from tofmix.estimation.samples import FARTHEST_MM, sort_samples


def test_valid_samples_come_first_and_ascend(rng: np.random.Generator) -> None:
    block = rng.normal(1000, 100, (50, 7)).astype(np.float32)
    block[rng.random(block.shape) < 0.2] = np.nan
    block[3, 2], block[4, 2] = np.inf, 10 * FARTHEST_MM
    ordered = sort_samples(block)
    for pixel in range(7):
        valid = block[np.isfinite(block[:, pixel]) & (block[:, pixel] < FARTHEST_MM), pixel]
        assert ordered.valid[pixel] == len(valid)
        np.testing.assert_array_equal(ordered.values[pixel, : len(valid)], np.sort(valid))
