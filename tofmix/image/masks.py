"""Masks of pixels: connected components, and what lies around pixels; in NumPy, for SciPy takes longer to import.

`tests/image/test_patch.py` holds each against SciPy.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray


def components(one: IntArray, other: IntArray, count: int) -> IntArray:
    """Number (count,) of the connected component of each of `count` nodes, in the order of their first nodes.

    `one` and `other` (edge,) are the nodes that an edge connects.
    """
    least = np.arange(count)
    while True:
        before = least
        low = np.minimum(least[one], least[other])
        least = before.copy()
        np.minimum.at(least, before[one], low)
        np.minimum.at(least, before[other], low)
        while not np.array_equal(least, least[least]):
            least = least[least]
        if np.array_equal(least, before):
            return np.unique(least, return_inverse=True)[1].astype(np.int64).reshape(count)


def count_around(mask: BoolArray, reach: int) -> IntArray:
    """How many pixels of a mask (row, col) are true within `reach` rows and columns of each."""
    return _summed(mask.astype(np.int64), reach)


def sum_around(values: FloatArray, reach: int) -> FloatArray:
    """Sum of the values (row, col) within `reach` rows and columns of each pixel."""
    return _summed(values.astype(np.float64), reach)


def _summed(total: NDArray[Any], reach: int) -> NDArray[Any]:
    for axis in (0, 1):
        pads = [(0, 0), (0, 0)]
        pads[axis] = reach + 1, reach
        sums = np.cumsum(np.pad(total, pads), axis=axis)
        first, last = np.arange(total.shape[axis]), np.arange(total.shape[axis]) + 2 * reach + 1
        total = np.take(sums, last, axis=axis) - np.take(sums, first, axis=axis)
    return total


def near(mask: BoolArray, reach: int) -> BoolArray:
    """Which pixels (row, col) have a true pixel of the mask within `reach` rows and columns."""
    return count_around(mask, reach) > 0


def around(values: FloatArray, choose: np.ufunc) -> FloatArray:
    """Least or most (`np.minimum`, `np.maximum`) of the 3 x 3 pixels around each; the image's edge is repeated."""
    for axis in (0, 1):
        pads = [(0, 0), (0, 0)]
        pads[axis] = 1, 1
        wide = np.moveaxis(np.pad(values, pads, mode="edge"), axis, 0)
        values = np.moveaxis(choose(choose(wide[:-2], wide[1:-1]), wide[2:]), 0, axis)
    return values


def neighbour_pairs(shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Pixels (pair,) to the left of others, then above them, and these."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    return (
        np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()]),
        np.concatenate([index[:, 1:].ravel(), index[1:].ravel()]),
    )
