"""The samples of a block of pixels, in the order in which every step reads them.

Sorted once, valid ones first, one pixel after the other in memory: the steps then
neither skip invalid values nor depend on the order of the frames.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.jit import jit

FARTHEST_MM = 1.0e9
"""A value beyond this is no range of any camera, and is skipped as invalid."""


class SortedSamples(NamedTuple):
    """Samples of many pixels: `values` (pixel, frame) float64 in mm, of which the first `valid` (pixel,) ascend."""

    values: FloatArray
    valid: IntArray


@jit
def sort_samples(block: Float32Array) -> SortedSamples:
    """Sort the valid samples of each pixel of a block (frame, pixel)."""
    frames, pixels = block.shape
    values = np.zeros((pixels, frames))
    count = np.zeros(pixels, dtype=np.int64)
    for pixel in range(pixels):
        n = 0
        for frame in range(frames):
            value = block[frame, pixel]
            if abs(value) <= FARTHEST_MM:  # false for NaN
                values[pixel, n] = value
                n += 1
        values[pixel, :n].sort()
        count[pixel] = n
    return SortedSamples(values, count)


def sorted_valid(samples_mm: ArrayLike) -> FloatArray:
    """Sort one pixel's finite samples.

    Parameters
    ----------
    samples_mm : array_like
        Samples, mm, of any shape.

    Returns
    -------
    (n,) float64
        Finite samples, ascending.

    Raises
    ------
    ValueError
        If there is none.
    """
    samples = np.asarray(samples_mm, dtype=np.float64).ravel()
    samples = np.sort(samples[np.isfinite(samples)])
    if samples.size == 0:
        raise ValueError("samples: none is finite")
    return samples
