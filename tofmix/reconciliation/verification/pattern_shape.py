"""Whether a map of biases is a pattern: in a `fixed_pattern`, pixels, columns and rows are independent.

If a map is smooth over the image, over its columns or rows, or a plane over a surface, another cause has changed the
ranges. Without this test, any static bias that no law describes would be named a pattern.
"""

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray

SMOOTH = 0.2
"""Correlation of neighbours in a map, above which it is no pattern."""

TILTED = 0.8
"""Share of a plane in a map on one surface, above which the map is no pattern."""

_LINES = 0.2  # least share of the columns, or rows, in a map, from which they are tested
_CHANCE = 4.0  # margin of the correlation of neighbouring lines, in its standard deviations
_PLANE_LINES = 8  # least rows and columns for the test of a plane
_SWEEPS = 30  # alternations of columns and rows, if some pixels are unknown


def tilted(values: FloatArray, known: BoolArray, surface: IntArray) -> bool:
    """Whether a map (row, col) is a plane over a surface, which is then tilted.

    On a surface of so many rows and columns, a pattern looks like a plane once in some thousands of recordings.
    """
    for number in range(int(surface.max()) + 1):
        row, col = np.nonzero(known & (surface == number))
        if min(np.unique(row).size, np.unique(col).size) < _PLANE_LINES:
            continue
        value = values[row, col] - values[row, col].mean()
        slopes = np.stack([row - row.mean(), col - col.mean()], axis=1)
        plane = slopes @ np.linalg.lstsq(slopes, value, rcond=None)[0]
        if float((plane**2).sum()) > TILTED * float((value**2).sum()) > 0:
            return True
    return False


def smooth(values: FloatArray, known: BoolArray) -> bool:
    """Whether a map (row, col), or its means of columns or rows, are smooth over the image.

    Only pixels with a known bias count. In pixels without a return the map is 0, which would distort the mean of a
    column.
    """
    if not known.any():
        return False
    rest = np.where(known, values - values[known].mean(), 0.0)
    whole = float((rest**2).sum())
    lines = [np.zeros(values.shape[1]), np.zeros(values.shape[0])]
    for _ in range(_SWEEPS):
        for axis in (0, 1):
            mean = rest.sum(axis=axis) / np.maximum(known.sum(axis=axis), 1)
            lines[axis] += mean
            rest -= np.where(known, np.expand_dims(mean, axis), 0.0)
    if any(_lines_smooth(line, known.sum(axis=axis), whole) for axis, line in enumerate(lines)):
        return True
    power = float((rest**2).sum()) / known.sum()
    near = 0.5 * (
        _mean_product(rest[1:], rest[:-1], known[1:] & known[:-1])
        + _mean_product(rest[:, 1:], rest[:, :-1], known[:, 1:] & known[:, :-1])
    )
    return bool(near > SMOOTH * power > 0)


def _lines_smooth(line: FloatArray, pixels: IntArray, whole: float) -> bool:
    """Whether values of columns or rows, of `pixels` known pixels each, are smooth.

    In n independent lines, neighbours correlate by 0 +- 1 / sqrt(n).
    """
    seen = pixels > 0
    value = np.where(seen, line - line[seen].mean(), 0.0)
    if float((value**2 * pixels).sum()) < _LINES * whole:
        return False
    power = float((value**2).sum()) / seen.sum()
    near = _mean_product(value[1:], value[:-1], seen[1:] & seen[:-1])
    return bool(near > (SMOOTH + _CHANCE / np.sqrt(seen.sum())) * power)


def _mean_product(a: FloatArray, b: FloatArray, both: BoolArray) -> float:
    return float((a * b).sum() / max(int(both.sum()), 1))
