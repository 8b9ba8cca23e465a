"""Input of smooth surfaces: ranges and amplitudes of an image's pixels, and the directions of their beams."""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray


class View(NamedTuple):
    """An image, pixel by pixel, row by row. Arrays are (pixel,) unless said otherwise.

    Parameters
    ----------
    shape : (int, int)
        Rows, columns.
    scale_mm : float
        K, mm a radian of phase; infinite where ranges are averaged as they are.
    valid : bool
        Whether the pixel has a range.
    range_mm, range_variance : float64
        Range of the mean sample, mm, and its variance by noise and fixed pattern, mm^2.
    log_amplitude, amplitude_variance : float64
        Logarithm of its amplitude, and its variance by noise and by texture from pixel to pixel.
    pattern_variance, texture_variance : float
        Parts of both variances that are no noise: they are the same in each frame.
    direction, right, below : (pixel, 3) float64
        Unit vector of the beam, and the vectors from it to those of the next pixels.
    pitch : float64
        Tangent of the angle to the next pixel, the larger of both.
    """

    shape: tuple[int, int]
    scale_mm: float
    valid: BoolArray
    range_mm: FloatArray
    range_variance: FloatArray
    log_amplitude: FloatArray
    amplitude_variance: FloatArray
    pattern_variance: float
    texture_variance: float
    direction: FloatArray
    right: FloatArray
    below: FloatArray
    pitch: FloatArray

    def rays(self, pixels: IntArray, places: FloatArray) -> FloatArray:
        """Unit vectors (..., place, 3) of pixels (...,), at places (place, 2) down and right of their middles."""
        once, again = np.unique(pixels, return_inverse=True)  # a pixel is in the windows of many others
        ways = (
            self.direction[once][:, np.newaxis]
            + places[:, :1] * self.below[once][:, np.newaxis]
            + places[:, 1:] * self.right[once][:, np.newaxis]
        )
        unit = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
        return np.asarray(unit[again.reshape(pixels.shape)])


def lattice_of_places(count: int, step: int) -> FloatArray:
    """Places (count, 2) in a pixel, as `grid_of_places`, of which no two are in one row or column: a lattice.

    On a grid whole columns of places would cross an upright limb at once.

    Parameters
    ----------
    count, step : int
        Number of places, and a number without a common divisor, by which the rows go on from column to column.
    """
    place = np.arange(count)
    return np.stack([(place * step % count + 0.5) / count - 0.5, (place + 0.5) / count - 0.5], axis=-1)


def grid_of_places(side: int) -> FloatArray:
    """Middles (side^2, 2) of the parts of a pixel, down and right of its middle, in units of the pixel."""
    steps = (np.arange(side) + 0.5) / side - 0.5
    return np.stack([part.ravel() for part in np.meshgrid(steps, steps, indexing="ij")], axis=-1)
