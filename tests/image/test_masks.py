"""Masks of pixels are those of SciPy."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tofmix.image.masks import components, count_around, near, sum_around


def test_components_are_scipys_in_their_order(rng: np.random.Generator) -> None:
    for edges in (0, 30, 200, 2000):
        one, other = rng.integers(0, 300, (2, edges))
        graph = coo_array((np.ones(edges, np.int8), (one, other)), shape=(300, 300))
        np.testing.assert_array_equal(components(one, other, 300), connected_components(graph, directed=False)[1])
    chain = rng.permutation(3000)
    assert not components(chain[:-1], chain[1:], 3000).any()


@pytest.mark.parametrize("reach", [0, 1, 3, 20])
def test_counts_and_neighbourhoods_are_scipys_also_at_the_border(reach: int, rng: np.random.Generator) -> None:
    square = np.ones((2 * reach + 1, 2 * reach + 1))
    for shape in ((12, 17), (1, 5), (3, 1)):
        mask = rng.random(shape) < 0.1
        counted = ndimage.convolve(mask.astype(np.int64), square.astype(np.int64), mode="constant")
        np.testing.assert_array_equal(count_around(mask, reach), counted)
        values = rng.standard_normal(shape)
        np.testing.assert_allclose(
            sum_around(values, reach), ndimage.convolve(values, square, mode="constant"), atol=1e-9
        )
        np.testing.assert_array_equal(near(mask, reach), ndimage.binary_dilation(mask, square.astype(bool)))
