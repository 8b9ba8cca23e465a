"""The input of smooth surfaces, and its segments: pixels of one smooth surface each.

The input is ranges and amplitudes of an image's pixels, and the directions of their beams. Segments are found by second
differences of range and light.

Masks of pixels stand here too: connected components, and what lies around pixels, in NumPy, for SciPy takes longer to
import. `tests/image/test_patch.py` holds each against SciPy.
"""

from typing import Any, NamedTuple

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


LEAST_PIXELS = 6
"""Fewest pixels of a segment: a patch has six numbers."""

REACH = 4
"""Reach of the window whose pixels a patch goes through, pixels."""

_NOISE = 4.0  # standard errors of a second difference of range
_PITCHES, _LOOSE_PITCHES = 0.3, 0.8
_LIGHT, _LOOSE_LIGHT = 0.06, 0.32
"""Second differences that a bent surface has by itself: of range in widths of a pixel, of the logarithm of light."""
_STEP, _LIGHT_STEP = 0.04, 0.35
"""Largest difference between neighbours of one surface beyond its slope: part of the range; and of the logarithm of
light."""


def segments_of(view: View) -> IntArray:
    """Number (pixel,) of the segment of each pixel; -1 where it is of none.

    Pixels whose range and light go on evenly in four directions are seeds; where they make no segment nearby, less even
    ones. Seeds beside each other are of one surface unless range or light steps between them.
    """
    rows, cols = view.shape
    # 1 / r of a plane is linear in the image, however steep the plane is; its range is not.
    bent = _second_difference(view, 1.0 / view.range_mm, view.range_variance)[0] * view.range_mm**2
    error = _second_difference(view, view.range_mm, view.range_variance)[1]
    faded, light_error = _second_difference(view, view.log_amplitude, view.amplitude_variance)
    width = view.range_mm * view.pitch
    light_noise = 6.0  # and of the logarithm of light
    even = (bent < _NOISE * error + _PITCHES * width) & (faded < light_noise * light_error + _LIGHT)
    loose = (bent < _NOISE * error + _LOOSE_PITCHES * width) & (faded < light_noise * light_error + _LOOSE_LIGHT)
    first = _linked(view, even & view.valid, error) >= 0
    seed_reach = 2  # pixels
    return _linked(view, first | (loose & view.valid & ~near(first.reshape(rows, cols), seed_reach).ravel()), error)


def _linked(view: View, seed: BoolArray, error: FloatArray) -> IntArray:
    """Number (pixel,) of the segment of seeds beside each other, the largest first; -1 for seeds of too small ones."""
    rows, cols = view.shape
    index = np.arange(rows * cols).reshape(rows, cols)
    ones, others = [], []
    inverse = 1.0 / view.range_mm.reshape(rows, cols)
    for axis, (one, other) in enumerate(((index[:, :-1], index[:, 1:]), (index[:-1], index[1:]))):
        a, b = one.ravel(), other.ravel()
        joined = seed[a] & seed[b]
        square = view.range_mm[a] * view.range_mm[b]
        beyond = _beyond_slope(inverse, (_NOISE * error[a] / square).reshape(one.shape), 1 - axis)
        joined &= np.abs(beyond.ravel()) * square < _STEP * view.range_mm[a] + _NOISE * error[a]
        joined &= np.abs(view.log_amplitude[a] - view.log_amplitude[b]) < _LIGHT_STEP
        ones.append(a[joined])
        others.append(b[joined])
    number = components(np.concatenate(ones), np.concatenate(others), rows * cols)
    size = np.bincount(number[seed], minlength=int(number.max()) + 1)
    order = np.argsort(-size, kind="stable")
    renamed = np.full(len(size), -1)
    large = order[size[order] >= LEAST_PIXELS]
    renamed[large] = np.arange(large.size)
    return np.where(seed, renamed[number], -1).astype(np.int64)


def _beyond_slope(values: FloatArray, noise: FloatArray, axis: int) -> FloatArray:
    """Steps between neighbours along an axis, less the slope: of the steps before and after the smaller one.

    A steep plane has large steps, which are alike. A step between two surfaces is alone. A slope counts as far as it
    exceeds the `noise` of steps.
    """
    step = np.diff(values, axis=axis)
    place, last = np.arange(step.shape[axis]), step.shape[axis] - 1
    before = np.take(step, np.maximum(place - 1, 0), axis=axis)
    after = np.take(step, np.minimum(place + 1, last), axis=axis)
    least = np.maximum(np.minimum(np.abs(before), np.abs(after)) - noise, 0.0)
    return step - np.where(before * after > 0, np.sign(before) * least, 0.0)


def _second_difference(view: View, values: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Largest second difference (pixel,) of values in four directions, and its largest error."""
    rows, cols = view.shape
    middle, sigma = values.reshape(rows, cols), np.sqrt(variance).reshape(rows, cols)
    padded = np.pad(middle, 1, mode="reflect", reflect_type="odd")
    beside = np.pad(sigma, 1, mode="edge")
    largest, error = np.zeros((rows, cols)), np.zeros((rows, cols))
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        ahead = np.s_[1 + down : 1 + down + rows, 1 + right : 1 + right + cols]
        back = np.s_[1 - down : 1 - down + rows, 1 - right : 1 - right + cols]
        largest = np.maximum(largest, np.abs(padded[ahead] - 2.0 * middle + padded[back]))
        error = np.maximum(error, np.sqrt(beside[ahead] ** 2 + 4.0 * sigma**2 + beside[back] ** 2))
    return largest.ravel(), error.ravel()


def members_around(
    shape: tuple[int, int], segment: IntArray, at: IntArray, number: IntArray, reach: int, *, own: bool = False
) -> IntArray:
    """Pixels (n, place) of a segment within `reach` of each pixel; -1 for none.

    Parameters
    ----------
    shape : (int, int)
        Rows, columns.
    segment : (pixel,) int64
        Segment of each pixel.
    at, number : (n,) int64
        The pixels, and the segment in question of each.
    reach : int
        Pixels.
    own : bool
        Whether the pixel itself may be among them.
    """
    steps = np.arange(-reach, reach + 1)
    down, right = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
    row, col = (at // shape[1])[:, np.newaxis] + down, (at % shape[1])[:, np.newaxis] + right
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    pixel = np.where(inside, row * shape[1] + col, 0)
    inside &= segment[pixel] == number[:, np.newaxis]
    if not own:
        inside[:, (down == 0) & (right == 0)] = False
    return np.where(inside, pixel, -1)


def rim_of(mask: BoolArray, shape: tuple[int, int]) -> BoolArray:
    """Pixels (pixel,) of a mask beside pixels that are not in it."""
    return mask & near(~mask.reshape(shape), 1).ravel()
