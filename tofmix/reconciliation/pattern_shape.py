"""Whether a map of biases is a pattern: of a `fixed_pattern`, pixels, columns and rows are each drawn by themselves.

Where a map runs smoothly over the image, over its columns or rows, or as a plane over a surface, something else has
bent or tilted the ranges: a static bias that no law describes would else be called a pattern.
"""

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray

SMOOTH = 0.2
"""Correlation of neighbours in a map above which it is no pattern of pixels."""

TILTED = 0.8
"""Share of what a map has on one surface, of a plane above which it is no pattern of pixels."""

_LINES = 0.2  # share of what a map has, from which its columns, or its rows, are looked at by themselves
_CHANCE = 4.0  # of the correlation of so many neighbouring lines, in its standard deviations
_PLANE_LINES = 8  # rows and columns, for a plane to be told from a pattern
_SWEEPS = 30  # over columns and rows in turn, where not all pixels are known


def tilted(values: FloatArray, known: BoolArray, surface: IntArray) -> bool:
    """Whether a map (row, col) runs as a plane over a surface, which is then tilted.

    Of a surface of so many rows and columns: those of a pattern would be in order by chance once in some thousands.
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
    """Whether a map (row, col), or what its columns or rows have in common, runs smoothly over the image.

    Of the pixels whose bias is known: the map has 0 where nothing returns, which would else leave of a column what its
    lit part has.
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
    """Whether values of columns or rows, of so many known pixels each, follow one another.

    Of n lines drawn by themselves, neighbours correlate by 0 +- 1 / sqrt(n).
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
