"""Area of a surface in a pixel: one side of an edge, or a corner of two edges. Compiled.

Where no edge agrees with the shares around a pixel, or its run is short, the edges of neighbours are continued into it:
each alone, and each two of them as a corner, convex or concave. The one that fits the shares of the pixel and its eight
neighbours best is taken.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.surfaces.edge_pixels import share_of
from tofmix.surfaces.edge_shape import (
    AGREES,
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
)
from tofmix.surfaces.half_plane import clip, covered, covered_by_both, polygon_area
from tofmix.surfaces.settings import EdgeSettings
from tofmix.surfaces.shapes import Shapes

ONE, BOTH, EITHER, ALL = 0, 1, 2, 3
"""A region is one side of an edge; on that side of two edges; of either; or of three, as at the end of a bar."""

# Columns of a region: which of these, then three edges of five numbers each.
SHAPE, FIRST, SECOND, THIRD_EDGE = 0, 1, 6, 11  # columns at which they begin
DOWN, RIGHT, AT, BEND, VARIANCE = range(5)
REGION_COLUMNS = 16
"""An edge is the place where y - BEND (y^2 + s^2) / 2 = 0, with y = DOWN u + RIGHT v - AT
across it, (DOWN, RIGHT) of length 1, and s along it; VARIANCE is that of AT."""


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
    """Fill `out` (3,): a fit's edge in a pixel (down, right) away: its slopes down and right, its value at the centre.

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
    """Set an edge of a region to that of a fit some pixels away; its error is that of place and direction."""
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
    samples: FloatArray, floor: FloatArray, planes: Shapes, directions: FloatArray, rays: FloatArray,
    settings: EdgeSettings,
) -> FloatArray:  # fmt: skip
    """Choose the area of each surface in its pixel.

    Parameters
    ----------
    fits, lines
        From `fit_edges` and `ray_lines`.
    first_cut : (row, col) int32
        Number of the first cut of each pixel, -1 without one.
    next_cut : (cut,) int32
        Number of the pixel's next cut, -1 after the last. The others are those of `fit_edges`.
    settings : EdgeSettings
        Thresholds.

    Returns
    -------
    (cut, REGION_COLUMNS) float64
        The regions.
    """
    out = np.zeros((len(fits), REGION_COLUMNS))
    chosen, sides = np.empty(settings.most_edges, np.int64), np.empty(settings.most_edges, np.int64)
    local = np.empty((settings.most_edges, 9, 3))  # each line in each of the nine pixels
    told = np.empty((9, 3))  # share, samples, further variance; share -1: not told
    here, there, work, best = np.empty(3), np.empty(3), np.empty((3, 8, 2)), np.empty(3, np.int64)
    for cut in range(len(fits)):
        region, row, col = out[cut], rows[cut], cols[cut]
        _own_region(fits[cut], region)
        if fits[cut, AGREES] > 0.0 and min(fits[cut, BACK], fits[cut, AHEAD]) >= settings.short_run:
            continue
        used = _gather(
            cut, fits, lines, rows, cols, cut_labels, first_cut, next_cut, rays, chosen, sides, local, here, settings
        )  # fmt: skip
        _tell(cut_labels[cut], row, col, count, labels, inverses, up_to, samples, floor, planes, directions, told)
        if fits[cut, AGREES] > 0.0 and told[4, 0] < 0.0:
            continue
        own = 0.0
        for place in range(9):
            r, c = row + place // 3 - 1, col + place % 3 - 1
            if told[place, 0] < 0.0:
                continue
            for k in range(used):
                one = chosen[k]
                continue_edge(
                    fits[one], lines[one, sides[k]], rays[r, c], r - rows[one], c - cols[one], local[k, place]
                )  # fmt: skip
            area = _own_area(fits[cut], lines[cut], rays[r, c], r - row, c - col, here, there, work)
            own += _misfit(area, told[place])
        if _best(used, local, told, work, best, settings) < own and not (fits[cut, AGREES] > 0.0 and best[0] == ONE):
            # A neighbour's edge by itself is no better than an own one that agrees.
            region[SHAPE] = best[0]
            for k in range(1 if best[0] == ONE else 2):
                one = chosen[best[1 + k]]
                at = FIRST if k == 0 else SECOND
                set_edge(region, at, local[best[1 + k], 4], fits[one], row - rows[one], col - cols[one])
        if region[SHAPE] == BOTH and told[4, 0] >= 0.0:
            _end_bar(region, told, work, settings)
    return out


@borrowing
def _gather(
    cut: int, fits: FloatArray, lines: FloatArray, rows: NDArray[np.int32], cols: NDArray[np.int32],
    cut_labels: NDArray[np.int32], first_cut: NDArray[np.int32], next_cut: NDArray[np.int32], rays: FloatArray,
    chosen: NDArray[np.int64], sides: NDArray[np.int64], local: FloatArray, here: FloatArray, settings: EdgeSettings,
) -> int:  # fmt: skip
    """Collect edges of the same surface around a cut, those with the longest runs first; return how many."""
    height, width = first_cut.shape
    row, col = rows[cut], cols[cut]
    used = 0
    for longest in range(2 * settings.longest_run, 1, -1):
        for r in range(max(row - settings.around, 0), min(row + settings.around + 1, height)):
            for c in range(max(col - settings.around, 0), min(col + settings.around + 1, width)):
                other = first_cut[r, c]
                while other >= 0:
                    fitting = fits[other, AGREES] > 0.0 and int(fits[other, BACK] + fits[other, AHEAD]) == longest
                    if cut_labels[other] == cut_labels[cut] and fitting:
                        for side in range(2 if fits[other, KIND] == BAR else 1):
                            continue_edge(fits[other], lines[other, side], rays[row, col], row - r, col - c, here)
                            if used < settings.most_edges and _is_new(here, local, used, settings):
                                chosen[used], sides[used] = other, side
                                for i in range(3):
                                    local[used, 4, i] = here[i]
                                used += 1
                    other = next_cut[other]
    return used


@borrowing
def _is_new(here: FloatArray, local: FloatArray, used: int, settings: EdgeSettings) -> bool:
    """Whether an edge is near the pixel, and none of those that were collected before."""
    if abs(here[2]) > settings.around:
        return False
    for k in range(used):
        turn = here[0] * local[k, 4, 1] - here[1] * local[k, 4, 0]
        facing = here[0] * local[k, 4, 0] + here[1] * local[k, 4, 1]
        if abs(turn) < settings.same_angle and facing > 0.0 and abs(here[2] - local[k, 4, 2]) < settings.same_place:
            return False
    return True


@borrowing
def _tell(
    label: int, row: int, col: int, count: NDArray[np.int32], labels: NDArray[np.int32], inverses: FloatArray,
    up_to: FloatArray, samples: FloatArray, floor: FloatArray, planes: Shapes, directions: FloatArray,
    told: FloatArray,
) -> None:  # fmt: skip
    """Fill the shares of a cut's surface in the nine pixels around it; partly hidden ones are unknown."""
    for place in range(9):
        r, c = row + place // 3 - 1, col + place % 3 - 1
        told[place, 0] = -1.0
        if 0 <= r < count.shape[0] and 0 <= c < count.shape[1]:
            share = share_of(label, r, c, count, labels, inverses, up_to, planes, directions)
            hidden = share > 0.0 and labels[r, c, 0] != label
            told[place, 0], told[place, 1], told[place, 2] = -1.0 if hidden else share, samples[r, c], floor[r, c]


@borrowing
def _misfit(area: float, told: FloatArray) -> float:
    """Squared difference of an area and a share in units of the share's variance."""
    miss = told[0] - area
    return float(miss * miss / ((area * (1.0 - area) + 0.25 / told[1]) / told[1] + told[2]))


@borrowing
def _best(
    used: int, local: FloatArray, told: FloatArray, work: FloatArray, best: NDArray[np.int64], settings: EdgeSettings
) -> float:  # fmt: skip
    """Fill `best` (3,): shape and edges of the region that fits the nine pixels best; return its chi-square."""
    least = np.inf
    for one in range(used):
        for other in range(one, used):
            for shape in range(ONE, EITHER + 1):
                if (shape == ONE) != (one == other):
                    continue
                total = settings.corner_gain if shape != ONE else 0.0
                for place in range(9):
                    if told[place, 0] >= 0.0 and total < least:
                        total += _misfit(_area(shape, local[one, place], local[other, place], work), told[place])
                if total < least:
                    least = total
                    best[0], best[1], best[2] = shape, one, other
    return float(least)


@borrowing
def _end_bar(region: FloatArray, told: FloatArray, work: FloatArray, settings: EdgeSettings) -> None:
    """End a bar across its pixel if its share there is too small for a bar that continues."""
    facing = region[FIRST + DOWN] * region[SECOND + DOWN] + region[FIRST + RIGHT] * region[SECOND + RIGHT]
    if facing > -settings.bar_cosine:
        return
    area = _area_of_three(region, work)
    if told[4, 0] > area or _misfit(area, told[4]) < settings.corner_gain:
        return
    ahead_down, ahead_right = -region[FIRST + RIGHT], region[FIRST + DOWN]
    rest = 0.0
    for place in range(9):
        if told[place, 0] > 0.0:
            rest += told[place, 0] * ((place // 3 - 1) * ahead_down + (place % 3 - 1) * ahead_right)
    sign = 1.0 if rest > 0.0 else -1.0
    region[SHAPE] = ALL
    region[THIRD_EDGE + DOWN], region[THIRD_EDGE + RIGHT] = sign * ahead_down, sign * ahead_right
    region[THIRD_EDGE + BEND] = 0.0
    low, high = -1.0, 1.0
    for _ in range(20):
        region[THIRD_EDGE + AT] = 0.5 * (low + high)
        if _area_of_three(region, work) > told[4, 0]:
            low = region[THIRD_EDGE + AT]
        else:
            high = region[THIRD_EDGE + AT]
    # The share's error, over the length of the end.
    wide = max(-region[SECOND + AT] - region[FIRST + AT], settings.least_bar)
    share = told[4, 0]
    region[THIRD_EDGE + VARIANCE] = (share * (1.0 - share) / told[4, 1] + told[4, 2]) / (wide * wide)


@borrowing
def _area_of_three(region: FloatArray, work: FloatArray) -> float:
    """Area of a region of all of its edges, two or three, as straight lines; `work` is (3, 8, 2)."""
    for i in range(4):
        work[0, i, 0] = -0.5 if i < 2 else 0.5  # noqa: PLR2004  round the square
        work[0, i, 1] = -0.5 if i in (0, 3) else 0.5
    corners = 4
    edges = 3 if region[SHAPE] == ALL else 2
    for k in range(edges):
        at = FIRST + k * (SECOND - FIRST)
        corners = clip(
            work[k], corners, region[at + DOWN], region[at + RIGHT], -region[at + AT], work[(k + 1) % 3]
        )  # fmt: skip
    return polygon_area(work[edges % 3], corners)


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
    if region[SHAPE] == EITHER:
        return first or second
    return first and second and (region[SHAPE] == BOTH or edge_side(region, THIRD_EDGE, u, v) >= 0.0)


@borrowing
def edge_side(region: FloatArray, at: int, u: float, v: float) -> float:
    """How far a place is on the covered side of one edge of a region, pixels."""
    down, right = region[at + DOWN], region[at + RIGHT]
    along = -right * u + down * v
    across = down * u + right * v - region[at + AT]
    return float(across - 0.5 * region[at + BEND] * (across * across + along * along))
