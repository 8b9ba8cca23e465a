"""Short edges between two long ones: the end of a strip, or the bottom of a notch. Compiled.

A run along the end of a slat is as long as the slat is wide, and most of its pixels see a corner. So no line agrees
with them. The two long edges are known from their own runs. The short edge between them is fitted to the shares of the
pixels around, as one of the three edges of an area. A notch is the same with the two sides of all edges exchanged.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.surfaces.half_plane import covered_by_three

REACH = 2
"""Pixels around: an end of three pixels is in the window of each of them. Places are numbered by row, then column."""

PLACES = (2 * REACH + 1) ** 2

ANGLE, OFFSET, VAR_ANGLE, COVARIANCE, VAR_OFFSET, NUMBERS = 0, 1, 2, 3, 4, 5
"""Numbers of a short edge: angle of its normal from the rows' axis, rad; offset, pixels; variances."""

_PRIOR_WEIGHT = 4.0
"""Weight of the first guess: 1/rad^2, about a right angle; 1/pixel^2. It keeps a fit regular, as in `edge_run`."""

_STEP = 1.0e-4
"""Difference for derivatives, rad and pixels."""

_STEPS = 8
"""Steps of Levenberg and Marquardt's method at most."""

_OFFSETS = 7
"""First guesses of the offset, half a pixel apart."""


@borrowing
def line_in_pixel(g: FloatArray, ray: FloatArray, out: FloatArray) -> None:
    """Fill `out` (3,): slopes down and right, of length 1, and value at the centre, of a plane g . ray in a pixel."""
    for i in range(3):
        out[i] = g[0] * ray[(i + 1) % 3, 0] + g[1] * ray[(i + 1) % 3, 1] + g[2] * ray[(i + 1) % 3, 2]
    length = math.sqrt(out[0] * out[0] + out[1] * out[1])
    for i in range(3):
        out[i] /= length


@borrowing
def misfit(area: float, told: FloatArray) -> float:
    """Squared difference of an area and a share (share, samples, further variance), in units of its variance."""
    miss = told[0] - area
    return float(miss * miss / ((area * (1.0 - area) + 0.25 / told[1]) / told[1] + told[2]))


@borrowing
def _areas(
    flip: float, one: FloatArray, other: FloatArray, angle: float, offset: float, frame: FloatArray, rays: FloatArray,
    row: int, col: int, told: FloatArray, work: FloatArray, lines: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill `out` (PLACES,): the area of the three edges in each pixel with a share; with `flip` -1 that of a notch."""
    down, right = math.cos(angle), math.sin(angle)
    g, local = lines[0], lines[1]
    for i in range(3):
        g[i] = down * frame[0, i] + right * frame[1, i] - offset * frame[2, i]
    for place in range(PLACES):
        if told[place, 0] < 0.0:
            continue
        r, c = row + place // (2 * REACH + 1) - REACH, col + place % (2 * REACH + 1) - REACH
        line_in_pixel(g, rays[r, c], local)
        area = covered_by_three(flip, one[place], other[place], local, work)
        out[place] = area if flip > 0.0 else 1.0 - area


@borrowing
def _total(areas: FloatArray, told: FloatArray, reach: int) -> float:
    """Chi-square of the pixels up to `reach` away."""
    total = 0.0
    for place in range(PLACES):
        r, c = place // (2 * REACH + 1) - REACH, place % (2 * REACH + 1) - REACH
        if told[place, 0] >= 0.0 and abs(r) <= reach and abs(c) <= reach:
            total += misfit(areas[place], told[place])
    return total


@borrowing
def fit_short_edge(
    flip: float, one: FloatArray, other: FloatArray, frame: FloatArray, rays: FloatArray, row: int, col: int,
    told: FloatArray, work: FloatArray, lines: FloatArray, areas: FloatArray, fit: FloatArray,
) -> float:  # fmt: skip
    """Fit a short edge between two known ones.

    Parameters
    ----------
    flip : float
        1: the surface is on the covered side of all edges; -1: of any.
    one, other : (PLACES, 3) float64
        The known edges in each pixel: slopes of length 1, value at the centre.
    frame : (3, 3) float64
        Rows that give x, y and 1 of a ray in the plane of pixel (row, col).
    rays : (row, col, 3, 3) float64
        Of `fit_edges`.
    told : (PLACES, 3) float64
        Share, samples, further variance; a share of -1 is not known.
    work, lines, areas
        Scratch: (3, 8, 2), (2, 3), (3, PLACES).
    fit : (NUMBERS,) float64
        Filled: `ANGLE` is that of the normal on the side that the edges cover (of a notch: that they leave open).

    Returns
    -------
    float
        Chi-square of the pixel and its eight neighbours.
    """
    middle = (PLACES - 1) // 2
    # At a right angle to the middle between both edges: the normals' sum, or across their difference.
    across, along = one[middle, 0] - other[middle, 0], one[middle, 1] - other[middle, 1]
    if across * across + along * along < _STEP:
        across, along = one[middle, 0], one[middle, 1]
    first_angle, first_offset, least = 0.0, 0.0, math.inf
    for turn in range(2):
        angle = math.atan2(across, -along) + turn * math.pi
        for k in range(_OFFSETS):
            offset = 0.5 * (k - (_OFFSETS - 1) // 2)
            _areas(flip, one, other, angle, offset, frame, rays, row, col, told, work, lines, areas[0])
            total = _total(areas[0], told, REACH)
            if total < least:
                first_angle, first_offset, least = angle, offset, total
    fit[ANGLE], fit[OFFSET] = first_angle, first_offset
    damping = 0.0
    normal_a, normal_b, normal_c = 0.0, 0.0, 0.0
    for _ in range(_STEPS):
        angle, offset = fit[ANGLE], fit[OFFSET]
        _areas(flip, one, other, angle, offset, frame, rays, row, col, told, work, lines, areas[0])
        _areas(flip, one, other, angle + _STEP, offset, frame, rays, row, col, told, work, lines, areas[1])
        _areas(flip, one, other, angle, offset + _STEP, frame, rays, row, col, told, work, lines, areas[2])
        normal_a, normal_b, normal_c = _PRIOR_WEIGHT, 0.0, _PRIOR_WEIGHT
        right_a, right_c = _PRIOR_WEIGHT * (first_angle - angle), _PRIOR_WEIGHT * (first_offset - offset)
        for place in range(PLACES):
            if told[place, 0] < 0.0:
                continue
            area = areas[0, place]
            weight = 1.0 / ((area * (1.0 - area) + 0.25 / told[place, 1]) / told[place, 1] + told[place, 2])
            by_angle, by_offset = (areas[1, place] - area) / _STEP, (areas[2, place] - area) / _STEP
            miss = told[place, 0] - area
            normal_a += weight * by_angle * by_angle
            normal_b += weight * by_angle * by_offset
            normal_c += weight * by_offset * by_offset
            right_a += weight * by_angle * miss
            right_c += weight * by_offset * miss
        total = _total(areas[0], told, REACH)
        turn, move = 0.0, 0.0
        for _ in range(4):
            a, c = normal_a * (1.0 + damping), normal_c * (1.0 + damping)
            whole = a * c - normal_b * normal_b
            turn, move = (c * right_a - normal_b * right_c) / whole, (a * right_c - normal_b * right_a) / whole
            fit[ANGLE], fit[OFFSET] = angle + min(max(turn, -0.3), 0.3), offset + min(max(move, -0.4), 0.4)
            _areas(flip, one, other, fit[ANGLE], fit[OFFSET], frame, rays, row, col, told, work, lines, areas[0])
            if _total(areas[0], told, REACH) <= total:
                damping *= 0.1
                break
            fit[ANGLE], fit[OFFSET] = angle, offset
            damping = max(10.0 * damping, 0.1)
        if abs(turn) < _STEP and abs(move) < _STEP:
            break
    whole = normal_a * normal_c - normal_b * normal_b
    fit[VAR_ANGLE], fit[COVARIANCE], fit[VAR_OFFSET] = normal_c / whole, -normal_b / whole, normal_a / whole
    _areas(flip, one, other, fit[ANGLE], fit[OFFSET], frame, rays, row, col, told, work, lines, areas[0])
    return _total(areas[0], told, 1)
