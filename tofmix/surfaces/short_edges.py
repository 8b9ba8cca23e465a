"""Short edges beside long ones: the end of a strip, the bottom of a notch, and a side of a few pixels. Compiled.

A run along the end of a slat is as long as the slat is wide, and most of its pixels see a corner, so no line agrees
with them. The long edges are known from their own runs. The short edge is fitted to the shares of the pixels around, as
one edge of an area: that on the covered side of the short and of one or two known edges. A notch is such an area that
the surface does not cover.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.surfaces.edge_shape import covered_by_three

_WINDOW = sorted(
    ((down, right) for down in range(-2, 3) for right in range(-2, 3)),
    key=lambda place: max(abs(place[0]), abs(place[1])) > 1,
)  # the pixel and its eight neighbours first

PLACE_DOWN = tuple(down for down, _ in _WINDOW)
PLACE_RIGHT = tuple(right for _, right in _WINDOW)
"""Places of the window, pixels down and to the right of its middle. That of each pixel of an end holds all three."""

NEAREST, MIDDLE, PLACES = 9, 4, len(_WINDOW)
"""The pixel and its eight neighbours come first, by row; the pixel is the fifth of them; all."""

SHORT_ANGLE, SHORT_OFFSET, SHORT_VAR_ANGLE, SHORT_COVARIANCE, SHORT_VAR_OFFSET, SHORT_NUMBERS = range(6)
"""Numbers of a short edge: angle of its normal, which points to the covered side, from the rows' axis, rad; offset,
pixels; their variances."""

SHORT_SCRATCH = 4
"""Rows of scratch: areas, twice more for derivatives, and lines and equations."""

_PRIOR_WEIGHT = 4.0
"""Weight of the first guess: 1/rad^2, about a right angle, and 1/pixel^2. It keeps a fit regular, as in `edge_run`."""

_STEP = 1.0e-4
"""Difference for derivatives, and a change that ends a fit: rad and pixels, far below errors."""


_FIRST_OFFSETS = (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
"""First guesses of the offset, pixels."""


@borrowing
def line_in_pixel(g: FloatArray, ray: FloatArray, out: FloatArray) -> None:
    """Fill `out` (3,): slopes down and right, of length 1, and value at the centre, of a plane g . ray in a pixel."""
    for i in range(3):
        out[i] = g[0] * ray[(i + 1) % 3, 0] + g[1] * ray[(i + 1) % 3, 1] + g[2] * ray[(i + 1) % 3, 2]
    length = math.sqrt(out[0] * out[0] + out[1] * out[1])
    for i in range(3):
        out[i] /= length


@borrowing
def area_variance(area: float, told: FloatArray) -> float:
    """Variance of a share (share, samples, further variance) where the surface covers an area."""
    return float((area * (1.0 - area) + 0.25 / told[1]) / told[1] + told[2])


@borrowing
def misfit(area: float, told: FloatArray) -> float:
    """Squared difference of an area and a share in units of the share's variance."""
    miss = told[0] - area
    return float(miss * miss / area_variance(area, told))


@borrowing
def _fill_areas(
    side: float,
    one: FloatArray,
    other: FloatArray,
    angle: float,
    offset: float,
    frame: FloatArray,
    rays: FloatArray,
    row: int,
    col: int,
    told: FloatArray,
    work: FloatArray,
    lines: FloatArray,
    areas: FloatArray,
) -> float:
    """Fill the area within three edges in each pixel of the window; return chi-square of the shares."""
    down, right = math.cos(angle), math.sin(angle)
    g, local = lines[:3], lines[3:6]
    for i in range(3):
        g[i] = down * frame[0, i] + right * frame[1, i] - offset * frame[2, i]
    total = 0.0
    for place in range(PLACES):
        if told[place, 0] < 0.0:
            continue
        line_in_pixel(g, rays[row + PLACE_DOWN[place], col + PLACE_RIGHT[place]], local)
        area = covered_by_three(side, one[place], other[place], local, work)
        areas[place] = area if side > 0.0 else 1.0 - area
        total += misfit(areas[place], told[place])
    return total


@borrowing
def _first_guess(
    side: float,
    one: FloatArray,
    other: FloatArray,
    frame: FloatArray,
    rays: FloatArray,
    row: int,
    col: int,
    told: FloatArray,
    work: FloatArray,
    scratch: FloatArray,
    fit: FloatArray,
) -> None:
    """Set the best of a few edges across the middle between the known ones, or at a right angle to a single one."""
    down, right = one[MIDDLE, 0] - other[MIDDLE, 0], one[MIDDLE, 1] - other[MIDDLE, 1]
    if down * down + right * right < _STEP:
        down, right = one[MIDDLE, 0], one[MIDDLE, 1]
    least = math.inf
    for turn in range(2):
        angle = math.atan2(down, -right) + turn * math.pi
        for offset in _FIRST_OFFSETS:
            total = _fill_areas(
                side, one, other, angle, offset, frame, rays, row, col, told, work, scratch[3], scratch[0]
            )
            if total < least:
                fit[SHORT_ANGLE], fit[SHORT_OFFSET], least = angle, offset, total


@borrowing
def _equations(
    side: float,
    one: FloatArray,
    other: FloatArray,
    frame: FloatArray,
    rays: FloatArray,
    row: int,
    col: int,
    told: FloatArray,
    work: FloatArray,
    scratch: FloatArray,
    fit: FloatArray,
    angle: float,
    offset: float,
) -> float:
    """Fill normal equations (scratch[3, 6:11]) about a fit; return chi-square, that of the first guess included."""
    lines, equations = scratch[3], scratch[3, 6:11]
    here, there = fit[SHORT_ANGLE], fit[SHORT_OFFSET]
    total = _fill_areas(side, one, other, here, there, frame, rays, row, col, told, work, lines, scratch[0])
    _fill_areas(side, one, other, here + _STEP, there, frame, rays, row, col, told, work, lines, scratch[1])
    _fill_areas(side, one, other, here, there + _STEP, frame, rays, row, col, told, work, lines, scratch[2])
    equations[0], equations[1], equations[2] = _PRIOR_WEIGHT, 0.0, _PRIOR_WEIGHT
    equations[3], equations[4] = _PRIOR_WEIGHT * (angle - here), _PRIOR_WEIGHT * (offset - there)
    for place in range(PLACES):
        if told[place, 0] < 0.0:
            continue
        area = scratch[0, place]
        by_angle, by_offset = (scratch[1, place] - area) / _STEP, (scratch[2, place] - area) / _STEP
        weight, miss = 1.0 / area_variance(area, told[place]), told[place, 0] - area
        equations[0] += weight * by_angle * by_angle
        equations[1] += weight * by_angle * by_offset
        equations[2] += weight * by_offset * by_offset
        equations[3] += weight * by_angle * miss
        equations[4] += weight * by_offset * miss
    return float(total + _PRIOR_WEIGHT * ((angle - here) ** 2 + (offset - there) ** 2))


@borrowing
def fit_short_edge(
    side: float,
    one: FloatArray,
    other: FloatArray,
    frame: FloatArray,
    rays: FloatArray,
    row: int,
    col: int,
    told: FloatArray,
    work: FloatArray,
    scratch: FloatArray,
    fit: FloatArray,
) -> float:
    """Fit a short edge beside known ones.

    Parameters
    ----------
    side : float
        1: the surface is on the covered side of all edges; -1: of any.
    one, other : (PLACES, 3) float64
        The known edges in each pixel: slopes of length 1, value at the centre; twice the same if there is one.
    frame : (3, 3) float64
        Rows that give x, y and 1 of a ray in the plane of pixel (row, col).
    rays : (row, col, 3, 3) float64
        Of `fit_edges`.
    told : (PLACES, 3) float64
        Share, samples, further variance; a share of -1 is not known.
    work, scratch
        Scratch: (3, 8, 2), (SHORT_SCRATCH, PLACES).
    fit : (SHORT_NUMBERS,) float64
        Filled.

    Returns
    -------
    float
        Chi-square of the pixel and its eight neighbours.
    """
    _first_guess(side, one, other, frame, rays, row, col, told, work, scratch, fit)
    first_angle, first_offset = fit[SHORT_ANGLE], fit[SHORT_OFFSET]
    equations, damping = scratch[3, 6:11], 0.0
    total = _equations(side, one, other, frame, rays, row, col, told, work, scratch, fit, first_angle, first_offset)
    steps = 10  # steps of Levenberg and Marquardt's method at most
    for _ in range(steps):
        angle, offset = fit[SHORT_ANGLE], fit[SHORT_OFFSET]
        a, b, c = equations[0] * (1.0 + damping), equations[1], equations[2] * (1.0 + damping)
        whole = a * c - b * b
        turn, move = (c * equations[3] - b * equations[4]) / whole, (a * equations[4] - b * equations[3]) / whole
        fit[SHORT_ANGLE] += min(max(turn, -0.3), 0.3)
        fit[SHORT_OFFSET] += min(max(move, -0.4), 0.4)
        new = _equations(side, one, other, frame, rays, row, col, told, work, scratch, fit, first_angle, first_offset)
        if new > total:
            fit[SHORT_ANGLE], fit[SHORT_OFFSET] = angle, offset
            damping = max(10.0 * damping, 0.1)
            total = _equations(
                side, one, other, frame, rays, row, col, told, work, scratch, fit, first_angle, first_offset
            )
        else:
            total, damping = new, 0.1 * damping
        if abs(turn) < _STEP and abs(move) < _STEP:
            break
    whole = equations[0] * equations[2] - equations[1] * equations[1]
    fit[SHORT_VAR_ANGLE], fit[SHORT_VAR_OFFSET] = equations[2] / whole, equations[0] / whole
    fit[SHORT_COVARIANCE] = -equations[1] / whole
    nearest = 0.0
    for place in range(NEAREST):
        if told[place, 0] >= 0.0:
            nearest += misfit(scratch[0, place], told[place])
    return nearest
