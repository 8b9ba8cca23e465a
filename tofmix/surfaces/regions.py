"""Area of a surface in a pixel: one side of an edge, or of several that meet there. Compiled.

Where no edge agrees with the shares around a pixel, or its run is short, the edges of neighbours are continued into it:
each alone, and each two of them as a corner, convex or concave. Where none of these explains the shares, one or two of
them meet a short edge that has no run of its own (`short_edges`), as at the end of a slat. The area that fits the
shares of the pixel and its eight neighbours best is taken.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.surfaces.edge_run import share_of, to_plane
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
    chord,
    covered,
    covered_by_both,
)
from tofmix.surfaces.settings import EdgeSettings
from tofmix.surfaces.shares import Cuts, Shares
from tofmix.surfaces.short_edges import (
    MIDDLE,
    NEAREST,
    PLACE_DOWN,
    PLACE_RIGHT,
    PLACES,
    SHORT_ANGLE,
    SHORT_COVARIANCE,
    SHORT_NUMBERS,
    SHORT_OFFSET,
    SHORT_SCRATCH,
    SHORT_VAR_ANGLE,
    SHORT_VAR_OFFSET,
    fit_short_edge,
    line_in_pixel,
    misfit,
)
from tofmix.surfaces.smooth_fits import SurfaceView

ONE, BOTH, EITHER, ALL, ANY = 0, 1, 2, 3, 4
"""A region is one side of an edge; on that side of two edges; of either; of three, as at the end of a strip; or of any
of three, as at the bottom of a notch."""

# Columns of a region: which of these, then three edges of five numbers each.
SHAPE, FIRST, SECOND, THIRD_EDGE = 0, 1, 6, 11  # columns at which they begin
DOWN, RIGHT, AT, BEND, VARIANCE = range(5)
REGION_COLUMNS = 16
"""An edge is the place where y - BEND (y^2 + s^2) / 2 = 0, with y = DOWN u + RIGHT v - AT
across it, (DOWN, RIGHT) of length 1, and s along it; VARIANCE is that of AT, NaN where the shares do not agree with the
edge: the error of a fit holds only if the fit does."""


@jit
def ray_lines(fits: FloatArray, rows: NDArray[np.int32], cols: NDArray[np.int32], frames: FloatArray) -> FloatArray:
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
def continue_edge(fit: FloatArray, g: FloatArray, ray: FloatArray, down: int, right: int, out: FloatArray) -> None:
    """Fill `out` (3,): a fit's edge in a pixel (down, right) away: its slopes down and right, its value at the centre.

    The slopes are of length 1. An arc turns on its way; in each pixel it is straight.
    """
    line_in_pixel(g, ray, out)
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
    agrees = fit[AGREES] > 0.0
    region[FIRST + VARIANCE] = fit[VAR_OFFSET] if agrees else np.nan
    if kind == BAR:
        region[SECOND + DOWN], region[SECOND + RIGHT], region[SECOND + AT] = -down, -right, -fit[THIRD]
        region[SECOND + VARIANCE] = fit[VAR_THIRD] if agrees else np.nan


@jit
def choose_regions(
    fits: FloatArray,
    lines: FloatArray,
    cuts: Cuts,
    shares: Shares,
    view: SurfaceView,
    settings: EdgeSettings,
) -> FloatArray:
    """Choose the area of each surface in its pixel.

    Parameters
    ----------
    fits, lines
        From `fit_edges` and `ray_lines`.
    cuts, shares, view
        Of the window.

    Returns
    -------
    (cut, REGION_COLUMNS) float64
        The regions.
    """
    out = np.zeros((len(fits), REGION_COLUMNS))
    chosen, sides = np.empty(settings.most_edges, np.int64), np.empty(settings.most_edges, np.int64)
    local = np.empty((settings.most_edges, PLACES, 3))  # each line in each pixel of the window
    told = np.empty((PLACES, 3))  # share, samples, further variance; share -1: not told
    here, there, work, best = np.empty(3), np.empty(3), np.empty((3, 8, 2)), np.empty(4, np.int64)
    frame, scratch = np.empty((3, 3)), np.empty((SHORT_SCRATCH, PLACES))
    trial, short = np.empty(SHORT_NUMBERS), np.empty(SHORT_NUMBERS)
    for cut in range(len(fits)):
        region, row, col = out[cut], cuts.row[cut], cuts.col[cut]
        _own_region(fits[cut], region)
        if fits[cut, AGREES] > 0.0 and min(fits[cut, BACK], fits[cut, AHEAD]) >= settings.short_run:
            continue
        used = _gather(cut, fits, lines, cuts, view.rays, chosen, sides, local, here, settings)
        _look(0, NEAREST, cut, used, chosen, sides, fits, lines, cuts, shares, view, told, local)
        if fits[cut, AGREES] > 0.0 and told[MIDDLE, 0] < 0.0:
            continue
        own = 0.0
        for place in range(NEAREST):
            if told[place, 0] >= 0.0:
                r, c = row + PLACE_DOWN[place], col + PLACE_RIGHT[place]
                area = _own_area(fits[cut], lines[cut], view.rays[r, c], r - row, c - col, here, there, work)
                own += misfit(area, told[place])
        least = _best(used, local, told, work, best, settings)
        # An edge that is fitted, and a corner, cost as much: nothing else could be better.
        if 2.0 * settings.corner_gain < min(least, own):
            _look(NEAREST, PLACES, cut, used, chosen, sides, fits, lines, cuts, shares, view, told, local)
            to_plane(view.rays[row, col], frame)
            least = _best_short(
                used,
                local,
                told,
                frame,
                view.rays,
                row,
                col,
                work,
                scratch,
                trial,
                short,
                best,
                min(least, own),
                settings,
            )
        if least < own and not (fits[cut, AGREES] > 0.0 and best[0] == ONE):
            # A neighbour's edge by itself is no better than an own one that agrees.
            region[SHAPE] = best[0]
            known = 1 if best[1] == best[2] else 2
            for k in range(known):
                one = chosen[best[1 + k]]
                at = FIRST if k == 0 else SECOND
                set_edge(region, at, local[best[1 + k], MIDDLE], fits[one], row - cuts.row[one], col - cuts.col[one])
            if best[3] > 0:
                _set_short(region, SECOND if known == 1 else THIRD_EDGE, short, here)
    return out


@borrowing
def _gather(
    cut: int,
    fits: FloatArray,
    lines: FloatArray,
    cuts: Cuts,
    rays: FloatArray,
    chosen: NDArray[np.int64],
    sides: NDArray[np.int64],
    local: FloatArray,
    here: FloatArray,
    settings: EdgeSettings,
) -> int:
    """Collect edges of the same surface around a cut, those with the longest runs first; return how many."""
    height, width = cuts.first.shape
    row, col = cuts.row[cut], cuts.col[cut]
    used = 0
    for longest in range(2 * settings.longest_run, 1, -1):
        for r in range(max(row - settings.around, 0), min(row + settings.around + 1, height)):
            for c in range(max(col - settings.around, 0), min(col + settings.around + 1, width)):
                other = cuts.first[r, c]
                while other >= 0:
                    fitting = fits[other, AGREES] > 0.0 and int(fits[other, BACK] + fits[other, AHEAD]) == longest
                    if cuts.near[other] == cuts.near[cut] and fitting:
                        for side in range(2 if fits[other, KIND] == BAR else 1):
                            continue_edge(fits[other], lines[other, side], rays[row, col], row - r, col - c, here)
                            if used < settings.most_edges and _is_new(here, local, used, settings):
                                chosen[used], sides[used] = other, side
                                for i in range(3):
                                    local[used, MIDDLE, i] = here[i]
                                used += 1
                    other = cuts.following[other]
    return used


@borrowing
def _is_new(here: FloatArray, local: FloatArray, used: int, settings: EdgeSettings) -> bool:
    """Whether an edge is near the pixel, and none of those that were collected before."""
    if abs(here[2]) > settings.around:
        return False
    for k in range(used):
        one = local[k, MIDDLE]
        turn = here[0] * one[1] - here[1] * one[0]
        facing = here[0] * one[0] + here[1] * one[1]
        if abs(turn) < settings.same_angle and facing > 0.0 and abs(here[2] - one[2]) < settings.same_place:
            return False
    return True


@borrowing
def _look(
    begin: int,
    end: int,
    cut: int,
    used: int,
    chosen: NDArray[np.int64],
    sides: NDArray[np.int64],
    fits: FloatArray,
    lines: FloatArray,
    cuts: Cuts,
    shares: Shares,
    view: SurfaceView,
    told: FloatArray,
    local: FloatArray,
) -> None:
    """Fill the shares of a cut's surface, and the chosen edges, in places of the window around it.

    Partly hidden shares are unknown.
    """
    label, row, col = cuts.near[cut], cuts.row[cut], cuts.col[cut]
    for place in range(begin, end):
        r, c = row + PLACE_DOWN[place], col + PLACE_RIGHT[place]
        told[place, 0] = -1.0
        if not (0 <= r < shares.entries.shape[0] and 0 <= c < shares.entries.shape[1]):
            continue
        share = share_of(label, r, c, shares, view)
        if share < 0.0 or (share > 0.0 and shares.label[r, c, 0] != label):
            continue
        told[place, 0], told[place, 1], told[place, 2] = share, shares.samples[r, c], shares.floor[r, c]
        for k in range(used):
            one = chosen[k]
            ray, down, right = view.rays[r, c], r - cuts.row[one], c - cuts.col[one]
            continue_edge(fits[one], lines[one, sides[k]], ray, down, right, local[k, place])


@borrowing
def _best(
    used: int, local: FloatArray, told: FloatArray, work: FloatArray, best: NDArray[np.int64], settings: EdgeSettings
) -> float:
    """Fill `best` (4,): shape and edges of the region that fits the nine pixels best, and 0; return its chi-square."""
    least = np.inf
    best[0] = best[1] = best[2] = best[3] = 0
    for one in range(used):
        for other in range(one, used):
            for shape in range(ONE, EITHER + 1):
                if (shape == ONE) != (one == other):
                    continue
                total = settings.corner_gain if shape != ONE else 0.0
                for place in range(NEAREST):
                    if told[place, 0] >= 0.0 and total < least:
                        total += misfit(_area(shape, local[one, place], local[other, place], work), told[place])
                if total < least:
                    least = total
                    best[0], best[1], best[2] = shape, one, other
    return float(least)


@borrowing
def _best_short(
    used: int,
    local: FloatArray,
    told: FloatArray,
    frame: FloatArray,
    rays: FloatArray,
    row: int,
    col: int,
    work: FloatArray,
    scratch: FloatArray,
    trial: FloatArray,
    short: FloatArray,
    best: NDArray[np.int64],
    least: float,
    settings: EdgeSettings,
) -> float:
    """Fill `best`, 1 last, and `short` by an area of one or two edges and a short one, where it fits better.

    Each corner costs `corner_gain`, and so do the numbers of the short edge.
    """
    for one in range(used):
        for other in range(one, used):
            corners = 1 if one == other else 2
            for is_notch in range(2):
                total = (1.0 + corners) * settings.corner_gain
                total += fit_short_edge(
                    1.0 - 2.0 * is_notch, local[one], local[other], frame, rays, row, col, told, work, scratch, trial
                )
                if total < least:
                    least = total
                    best[0] = (BOTH if corners == 1 else ALL) if is_notch == 0 else (EITHER if corners == 1 else ANY)
                    best[1], best[2], best[3] = one, other, 1
                    for i in range(SHORT_NUMBERS):
                        short[i] = trial[i]
    return float(least)


@borrowing
def _set_short(region: FloatArray, at: int, short: FloatArray, place: FloatArray) -> None:
    """Set an edge of a region to a short one; its error is that at the middle of its part in the pixel."""
    down, right = math.cos(short[SHORT_ANGLE]), math.sin(short[SHORT_ANGLE])
    region[at + DOWN], region[at + RIGHT], region[at + AT] = down, right, short[SHORT_OFFSET]
    region[at + BEND] = 0.0
    chord(down, right, -short[SHORT_OFFSET], place)
    along = -right * place[1] + down * place[2]
    region[at + VARIANCE] = (
        short[SHORT_VAR_OFFSET] + 2.0 * along * short[SHORT_COVARIANCE] + along * along * short[SHORT_VAR_ANGLE]
    )


@borrowing
def _own_area(
    fit: FloatArray,
    lines: FloatArray,
    ray: FloatArray,
    down: int,
    right: int,
    here: FloatArray,
    there: FloatArray,
    work: FloatArray,
) -> float:
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
    if region[SHAPE] == ANY:
        return first or second or edge_side(region, THIRD_EDGE, u, v) >= 0.0
    return first and second and (region[SHAPE] == BOTH or edge_side(region, THIRD_EDGE, u, v) >= 0.0)


@borrowing
def edge_side(region: FloatArray, at: int, u: float, v: float) -> float:
    """How far a place is on the covered side of one edge of a region, pixels."""
    down, right = region[at + DOWN], region[at + RIGHT]
    along = -right * u + down * v
    across = down * u + right * v - region[at + AT]
    return float(across - 0.5 * region[at + BEND] * (across * across + along * along))
