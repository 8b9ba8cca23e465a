"""What a surface covers in a pixel: one side of an edge, or a corner of two edges. Compiled.

Where no edge agrees with the shares around a pixel, or its run is short, the edges of neighbours are continued into it:
each alone, and each two of them as a corner, convex or concave. The one that fits the shares of the pixel and its eight
neighbours best is taken.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.jit import borrowing, jit
from tofmix.surfaces.edge_fit import (
    AHEAD,
    ANGLE,
    ARC,
    BACK,
    BAR,
    KIND,
    OFFSET,
    THIRD,
    VAR_ANGLE,
    VAR_OFFSET,
    VAR_THIRD,
    WORTH,
    share_of,
)
from tofmix.surfaces.half_plane import covered, covered_by_both

ONE, BOTH, EITHER = 0, 1, 2
"""A region is one side of an edge; on that side of two edges; or of either."""

# Columns of a region: which of these, then two edges of six numbers each.
SHAPE, FIRST, SECOND = 0, 1, 6
DOWN, RIGHT, AT, BEND, VARIANCE = range(5)
REGION_COLUMNS = 11
"""An edge is the place where y - BEND (y^2 + s^2) / 2 = 0, with y = DOWN u + RIGHT v - AT across it, (DOWN, RIGHT) of length 1, and s along it;
VARIANCE is that of AT."""

_AROUND = 3
"""Pixels around, in which an edge's neighbours are continued."""

_SHORT = 3.0
"""A run shorter than this on one side may end at a corner."""

_MOST = 8
"""Edges that are compared at most: the ones with the longest runs."""

_SAME_ANGLE, _SAME_PLACE = 0.15, 0.25
"""Two edges within this, rad and pixels, are one."""

_TWO = 9.0
"""Chi-square that a corner must save: three standard errors, as for a curvature."""


@jit
def ray_lines(
    fits: FloatArray, rows: NDArray[np.int32], cols: NDArray[np.int32], frames: FloatArray
) -> FloatArray:  # fmt: skip
    """Edges as planes through the camera: g . ray >= 0 on the covered side.

    Parameters
    ----------
    fits : (cut, FIT_COLUMNS) float64
        From `fit_edges`.
    rows, cols : (cut,) int32
        Pixels.
    frames : (row, col, 3, 3) float64
        Rows that give x, y and 1 of a ray in a pixel's own plane.

    Returns
    -------
    (cut, 2, 3) float64
        The second one is that of a bar, else 0.
    """
    out = np.zeros((len(fits), 2, 3))
    for cut in range(len(fits)):
        down, right = math.cos(fits[cut, ANGLE]), math.sin(fits[cut, ANGLE])
        frame = frames[rows[cut], cols[cut]]
        for i in range(3):
            across = down * frame[0, i] + right * frame[1, i]
            out[cut, 0, i] = across - fits[cut, OFFSET] * frame[2, i]
            if fits[cut, KIND] == BAR:
                out[cut, 1, i] = fits[cut, THIRD] * frame[2, i] - across
    return out


@borrowing
def continue_edge(
    fit: FloatArray, g: FloatArray, ray: FloatArray, down: int, right: int, out: FloatArray
) -> None:  # fmt: skip
    """Fill `out` (3,): slopes down and right and the value at the centre, of a fit's edge in a pixel (down, right) away.

    The slopes are of length 1. An arc turns on its way; in each pixel it is straight.
    """
    for i in range(3):
        out[i] = g[0] * ray[(i + 1) % 3, 0] + g[1] * ray[(i + 1) % 3, 1] + g[2] * ray[(i + 1) % 3, 2]
    length = math.sqrt(out[0] * out[0] + out[1] * out[1])
    for i in range(3):
        out[i] /= length
    if fit[KIND] == ARC:
        ahead_down, ahead_right = -out[1], out[0]
        turn = fit[THIRD] * (ahead_down * down + ahead_right * right)
        out[2] -= 0.5 * turn * (ahead_down * down + ahead_right * right)
        length = math.sqrt(1.0 + turn * turn)
        out[0], out[1] = (out[0] - turn * ahead_down) / length, (out[1] - turn * ahead_right) / length


@borrowing
def _area(shape: int, one: FloatArray, other: FloatArray, work: FloatArray) -> float:
    """Area of a region in a pixel."""
    area = covered(one[0], one[1], one[2])
    if shape == ONE:
        return area
    both = covered_by_both(one[0], one[1], one[2], other[0], other[1], other[2], work)
    return both if shape == BOTH else area + covered(other[0], other[1], other[2]) - both


@borrowing
def set_edge(region: FloatArray, at: int, local: FloatArray, fit: FloatArray, down: int, right: int) -> None:
    """Set an edge of a region to that of a fit some pixels away: its error is that of its place and of its direction."""
    region[at + DOWN], region[at + RIGHT], region[at + AT] = local[0], local[1], -local[2]
    region[at + BEND] = fit[THIRD] if fit[KIND] == ARC else 0.0
    region[at + VARIANCE] = fit[VAR_OFFSET] + (down * down + right * right) * fit[VAR_ANGLE]


@borrowing
def _own_region(fit: FloatArray, region: FloatArray) -> None:
    """Set the region of a pixel's own fit."""
    down, right = math.cos(fit[ANGLE]), math.sin(fit[ANGLE])
    kind = int(fit[KIND])
    region[SHAPE] = BOTH if kind == BAR else ONE
    region[FIRST + DOWN], region[FIRST + RIGHT], region[FIRST + AT] = down, right, fit[OFFSET]
    region[FIRST + BEND] = fit[THIRD] if kind == ARC else 0.0
    region[FIRST + VARIANCE] = fit[VAR_OFFSET]
    if kind == BAR:
        region[SECOND + DOWN], region[SECOND + RIGHT], region[SECOND + AT] = -down, -right, -fit[THIRD]
        region[SECOND + VARIANCE] = fit[VAR_THIRD]


@jit
def choose_regions(
    fits: FloatArray, lines: FloatArray, rows: NDArray[np.int32], cols: NDArray[np.int32],
    cut_labels: NDArray[np.int32], first_cut: NDArray[np.int32], next_cut: NDArray[np.int32],
    count: NDArray[np.int32], labels: NDArray[np.int32], inverses: FloatArray, up_to: FloatArray,
    samples: FloatArray, floor: FloatArray, planes: FloatArray, directions: FloatArray, rays: FloatArray,
) -> FloatArray:  # fmt: skip
    """Choose what each surface covers in its pixel.

    Parameters
    ----------
    fits, lines
        From `fit_edges` and `ray_lines`.
    first_cut : (row, col) int32
        Number of the first cut of each pixel, -1 without one.
    next_cut : (cut,) int32
        Number of the pixel's next cut, -1 after the last. The others are those of `fit_edges`.

    Returns
    -------
    (cut, REGION_COLUMNS) float64
        The regions.
    """
    out = np.zeros((len(fits), REGION_COLUMNS))
    height, width = count.shape
    chosen, second = np.empty(_MOST, np.int64), np.empty(_MOST, np.int64)
    local = np.empty((_MOST, 9, 3))  # each line in each of the nine pixels
    share, here, there = np.empty(9), np.empty(3), np.empty(3)
    work = np.empty((3, 8, 2))
    for cut in range(len(fits)):
        _own_region(fits[cut], out[cut])
        if fits[cut, WORTH] > 0.0 and min(fits[cut, BACK], fits[cut, AHEAD]) >= _SHORT:
            continue
        row, col = rows[cut], cols[cut]
        used = 0
        for longest in range(18, 1, -1):  # the edges with the longest runs first
            for r in range(max(row - _AROUND, 0), min(row + _AROUND + 1, height)):
                for c in range(max(col - _AROUND, 0), min(col + _AROUND + 1, width)):
                    other = first_cut[r, c]
                    while other >= 0:
                        fitting = fits[other, WORTH] > 0.0 and int(fits[other, BACK] + fits[other, AHEAD]) == longest
                        if cut_labels[other] == cut_labels[cut] and fitting:
                            for side in range(2 if fits[other, KIND] == BAR else 1):
                                continue_edge(fits[other], lines[other, side], rays[row, col], row - r, col - c, here)
                                new = used < _MOST and abs(here[2]) < _AROUND
                                for k in range(used):
                                    turn = here[0] * local[k, 4, 1] - here[1] * local[k, 4, 0]
                                    facing = here[0] * local[k, 4, 0] + here[1] * local[k, 4, 1]
                                    near = abs(here[2] - local[k, 4, 2]) < _SAME_PLACE
                                    new = new and not (abs(turn) < _SAME_ANGLE and facing > 0.0 and near)
                                if new:
                                    chosen[used], second[used] = other, side
                                    for i in range(3):
                                        local[used, 4, i] = here[i]
                                    used += 1
                        other = next_cut[other]
        for place in range(9):
            r, c = row + place // 3 - 1, col + place % 3 - 1
            share[place] = -1.0
            if 0 <= r < height and 0 <= c < width:
                share[place] = share_of(cut_labels[cut], r, c, count, labels, inverses, up_to, planes, directions)
                for k in range(used):
                    other = chosen[k]
                    continue_edge(
                        fits[other],
                        lines[other, second[k]],
                        rays[r, c],
                        r - rows[other],
                        c - cols[other],
                        local[k, place],
                    )
        own = np.inf
        best, best_shape, best_one, best_other = np.inf, -1, -1, -1
        for one in range(-1, used):
            for other in range(one, used):
                for shape in range(ONE, EITHER + 1):
                    if (shape == ONE) != (one == other) or (one < 0 and shape != ONE):
                        continue
                    total = _TWO if shape != ONE else 0.0
                    for place in range(9):
                        if share[place] < 0.0:
                            continue
                        r, c = row + place // 3 - 1, col + place % 3 - 1
                        if one < 0:
                            area = _own_area(fits[cut], lines[cut], rays[r, c], r - row, c - col, here, there, work)
                        else:
                            area = _area(shape, local[one, place], local[other, place], work)
                        worth = samples[r, c]
                        miss = share[place] - area
                        total += miss * miss / ((area * (1.0 - area) + 0.25 / worth) / worth + floor[r, c])
                    if one < 0:
                        own = total
                    if total < best:
                        best, best_shape, best_one, best_other = total, shape, one, other
        if best_one < 0 or best_shape < 0 or best >= own:
            continue
        if fits[cut, WORTH] > 0.0 and best_shape == ONE:
            continue  # its own edge agrees; that of a neighbour is the same, seen from farther away
        out[cut, SHAPE] = best_shape
        one = chosen[best_one]
        set_edge(out[cut], FIRST, local[best_one, 4], fits[one], row - rows[one], col - cols[one])
        if best_shape != ONE:
            one = chosen[best_other]
            set_edge(out[cut], SECOND, local[best_other, 4], fits[one], row - rows[one], col - cols[one])
    return out


@borrowing
def _own_area(
    fit: FloatArray, lines: FloatArray, ray: FloatArray, down: int, right: int, here: FloatArray, there: FloatArray,
    work: FloatArray,
) -> float:  # fmt: skip
    """Area that a pixel's own fit covers in a pixel around it, (down, right) away."""
    continue_edge(fit, lines[0], ray, down, right, here)
    if fit[KIND] != BAR:
        return covered(here[0], here[1], here[2])
    continue_edge(fit, lines[1], ray, down, right, there)
    return covered_by_both(here[0], here[1], here[2], there[0], there[1], there[2], work)


@borrowing
def inside(region: FloatArray, u: float, v: float) -> bool:
    """Whether a place (u, v) of the pixel, down and right of its centre, is of a region."""
    first = edge_side(region, FIRST, u, v) >= 0.0
    if region[SHAPE] == ONE:
        return first
    second = edge_side(region, SECOND, u, v) >= 0.0
    return (first and second) if region[SHAPE] == BOTH else (first or second)


@borrowing
def edge_side(region: FloatArray, at: int, u: float, v: float) -> float:
    """How far a place is on the covered side of one edge of a region, pixels."""
    down, right = region[at + DOWN], region[at + RIGHT]
    along = -right * u + down * v
    across = down * u + right * v - region[at + AT]
    return float(across - 0.5 * region[at + BEND] * (across * across + along * along))
