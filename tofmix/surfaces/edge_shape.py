"""Edges in a pixel: lines, arcs and bars, and the area that a surface covers behind them. Compiled.

Places are in a pixel's own plane: (x, y), down and to the right of its centre, in pixels of it, where the rays of
others meet it. A straight edge in space is a straight line there, for any projection of the camera.

Areas that straight lines cut off a pixel: the unit square around its centre. Compiled.

Places in a pixel are (u, v), down and to the right of its centre, from -1/2 to 1/2.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing


@borrowing
def covered(a: float, b: float, c: float) -> float:
    """Area of the part of a pixel in which a u + b v + c >= 0."""
    large, small = max(abs(a), abs(b)), min(abs(a), abs(b))
    tail = 0.5 * (large + small) - abs(c)
    if tail <= 0.0:
        return 1.0 if c > 0.0 else 0.0
    if tail >= small:
        return 0.5 + c / large
    cut = tail * tail / (2.0 * large * small)
    return 1.0 - cut if c > 0.0 else cut


@borrowing
def chord(a: float, b: float, c: float, out: FloatArray) -> None:
    """Fill `out` (3,): change of `covered` with c, and the middle (u, v) of the line in the pixel; 0 without one."""
    large, small = max(abs(a), abs(b)), min(abs(a), abs(b))
    tail = 0.5 * (large + small) - abs(c)
    out[0] = out[1] = out[2] = 0.0
    if tail <= 0.0:
        return
    if tail >= small:
        out[0] = 1.0 / large
        if abs(a) >= abs(b):
            out[1] = -c / a
        else:
            out[2] = -c / b
        return
    out[0] = tail / (large * small)
    side = -1.0 if c > 0.0 else 1.0  # the corner that is cut off, as seen along the gradient
    out[1] = side * math.copysign(0.5 - 0.5 * tail / abs(a), a)
    out[2] = side * math.copysign(0.5 - 0.5 * tail / abs(b), b)


@borrowing
def chord_outside(
    a: float, b: float, c: float, a_other: float, b_other: float, c_other: float, out: FloatArray
) -> None:
    """Fill `out` (3,) as `chord` does, with the part of the line alone on which the other line's value is negative."""
    square = a * a + b * b
    u, v = -a * c / square, -b * c / square  # the line's place nearest to the centre; it runs along (-b, a)
    begin, end = -math.inf, math.inf
    for axis in range(2):
        place, pace = (u, -b) if axis == 0 else (v, a)
        if pace == 0.0:
            if abs(place) > 0.5:  # noqa: PLR2004  half a pixel
                begin, end = 0.0, 0.0
        else:
            one, two = (-0.5 - place) / pace, (0.5 - place) / pace
            begin, end = max(begin, min(one, two)), min(end, max(one, two))
    value, slope = a_other * u + b_other * v + c_other, b_other * a - a_other * b
    if slope > 0.0:
        end = min(end, -value / slope)
    elif slope < 0.0:
        begin = max(begin, -value / slope)
    elif value >= 0.0:
        begin, end = 0.0, 0.0
    out[0] = max(end - begin, 0.0)  # of the length times (a, b)'s, over (a, b)'s
    middle = 0.5 * (begin + end) if out[0] > 0.0 else 0.0
    out[1], out[2] = u - b * middle, v + a * middle


@borrowing
def clip(corners: FloatArray, count: int, a: float, b: float, c: float, out: FloatArray) -> int:
    """Keep the part of a convex polygon in which a u + b v + c >= 0 (Sutherland and Hodgman 1974).

    Parameters
    ----------
    corners : (corner, 2) float64
        The polygon; its first `count` rows.
    out : (corner, 2) float64
        The part, with room for one corner more.

    Returns
    -------
    int
        Corners of the part.
    """
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        here = a * corners[i, 0] + b * corners[i, 1] + c
        there = a * corners[j, 0] + b * corners[j, 1] + c
        if here >= 0.0:
            out[kept, 0], out[kept, 1] = corners[i, 0], corners[i, 1]
            kept += 1
        if (here >= 0.0) != (there >= 0.0):
            part = here / (here - there)
            out[kept, 0] = corners[i, 0] + part * (corners[j, 0] - corners[i, 0])
            out[kept, 1] = corners[i, 1] + part * (corners[j, 1] - corners[i, 1])
            kept += 1
    return kept


@borrowing
def polygon_area(corners: FloatArray, count: int) -> float:
    """Area of a polygon, the first `count` rows (u, v)."""
    double = 0.0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        double += corners[i, 0] * corners[j, 1] - corners[j, 0] * corners[i, 1]
    return 0.5 * abs(double)


@borrowing
def covered_by_both(
    a: float, b: float, c: float, a_other: float, b_other: float, c_other: float, work: FloatArray
) -> float:
    """Area of the part of a pixel on the positive side of two lines; `work` is (3, 8, 2)."""
    one, other = covered(a, b, c), covered(a_other, b_other, c_other)
    if one == 0.0 or other == 0.0:
        return 0.0
    if one == 1.0:
        return other
    if other == 1.0:
        return one
    for i in range(4):
        work[0, i, 0] = -0.5 if i < 2 else 0.5  # noqa: PLR2004  round the square
        work[0, i, 1] = -0.5 if i in (0, 3) else 0.5
    count = clip(work[0], 4, a, b, c, work[1])
    count = clip(work[1], count, a_other, b_other, c_other, work[2])
    return polygon_area(work[2], count)


@borrowing
def covered_by_three(side: float, one: FloatArray, other: FloatArray, third: FloatArray, work: FloatArray) -> float:
    """Area of the part of a pixel on the positive side of three lines (slopes down and right, value at the centre).

    With a `side` of -1 it is that on the negative side of all of them. `work` is (3, 8, 2).
    """
    of_one = covered(side * one[0], side * one[1], side * one[2])
    of_other = covered(side * other[0], side * other[1], side * other[2])
    of_third = covered(side * third[0], side * third[1], side * third[2])
    if of_one == 0.0 or of_other == 0.0 or of_third == 0.0:
        return 0.0
    if of_one + of_other + of_third >= 2.0 + min(of_one, of_other, of_third):  # at most one line is in the pixel
        return min(of_one, of_other, of_third)
    for i in range(4):
        work[0, i, 0] = -0.5 if i < 2 else 0.5  # noqa: PLR2004  round the square
        work[0, i, 1] = -0.5 if i in (0, 3) else 0.5
    count = clip(work[0], 4, side * one[0], side * one[1], side * one[2], work[1])
    count = clip(work[1], count, side * other[0], side * other[1], side * other[2], work[2])
    count = clip(work[2], count, side * third[0], side * third[1], side * third[2], work[0])
    return polygon_area(work[0], count)


LINE, ARC, BAR = 0, 1, 2
"""Kinds of edges: n . x = c; the same with a curvature; between two parallel lines."""

UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of a place that is anywhere in a pixel, pixels^2: that of a uniform distribution of width 1."""

# Columns of a collected pixel.
X, Y, X_ROW, Y_ROW, X_COL, Y_COL, SHARE, SAMPLES, FLOOR, HIDES, HIDES_ROW, HIDES_COL, HIDES_AT = range(13)

COLUMNS = 13
"""Numbers of each pixel in the neighbourhood of a cut."""

# Columns of a fit.
KIND, ANGLE, OFFSET, THIRD, BACK, AHEAD, VAR_ANGLE, COV_ANGLE, VAR_OFFSET, VAR_THIRD, AGREES = range(11)
FIT_COLUMNS = 11
"""Columns of a fit: its kind; angle of n from the rows' axis, rad; c, pixels; curvature or second offset; run behind
and ahead, pixels; variances; 1 if the fit agrees with its run."""


@borrowing
def predict(
    kind: int, angle: float, offset: float, third: float, pixel: FloatArray, out: FloatArray, work: FloatArray
) -> None:
    """Fill `out` (7,): the share of a collected pixel, and its change with angle, offset and third number.

    The rest of `out` is scratch. Where a nearer surface hides a part of the pixel, the share is that of both. `work` is
    (3, 8, 2).
    """
    down, right = math.cos(angle), math.sin(angle)
    across = down * pixel[X] + right * pixel[Y] - offset
    along = -right * pixel[X] + down * pixel[Y]
    # A circle of curvature k through c n; y across and s along. Its centre is at y = 1 / k.
    bend = third if kind == ARC else 0.0
    by_row, by_col, off = down, right, across
    if bend != 0.0:
        to_centre = 1.0 - bend * across
        radius = math.sqrt(to_centre * to_centre + bend * bend * along * along)  # in units of 1 / k
        by_row = (to_centre * down + bend * along * right) / radius
        by_col = (to_centre * right - bend * along * down) / radius
        off = (2.0 * across - bend * (across * across + along * along)) / (1.0 + radius)  # distance from the circle
    a = by_row * pixel[X_ROW] + by_col * pixel[Y_ROW]
    b = by_row * pixel[X_COL] + by_col * pixel[Y_COL]
    place = out[4:7]
    c = off
    if bend != 0.0:
        c -= 0.5 * bend * _mean_square(a, b, off, pixel, by_row, by_col, place)
    out[0] = _covered_with_nearer(a, b, c, pixel, work, place)
    x = pixel[X] + pixel[X_ROW] * place[1] + pixel[X_COL] * place[2]
    y = pixel[Y] + pixel[Y_ROW] * place[1] + pixel[Y_COL] * place[2]
    turned = -right * x + down * y
    out[1] = place[0] * turned * (1.0 + bend * offset)
    out[2] = -place[0] * (1.0 - bend * (down * x + right * y - offset))
    out[3] = 0.0
    if kind == ARC:
        square = (down * x + right * y - offset) ** 2 + turned * turned + UNIFORM_VARIANCE * place[0] * place[0]
        out[3] = -0.5 * place[0] * square
    if kind == BAR:
        c = off + offset - third
        out[0] -= covered(a, b, c)
        chord(a, b, c, place)
        x = pixel[X] + pixel[X_ROW] * place[1] + pixel[X_COL] * place[2]
        y = pixel[Y] + pixel[Y_ROW] * place[1] + pixel[Y_COL] * place[2]
        out[1] -= place[0] * (-right * x + down * y)
        out[3] = place[0]


@borrowing
def own_area(fit: FloatArray, pixel: FloatArray, out: FloatArray, work: FloatArray) -> float:
    """Area that a fit covers in its own pixel; the arrays are scratch: (COLUMNS,), (7,), (3, 8, 2)."""
    for i in range(COLUMNS):
        pixel[i] = 0.0
    pixel[X_ROW] = pixel[Y_COL] = 1.0
    predict(int(fit[KIND]), fit[ANGLE], fit[OFFSET], fit[THIRD], pixel, out, work)
    return float(out[0])


@borrowing
def _mean_square(
    a: float, b: float, c: float, pixel: FloatArray, by_row: float, by_col: float, place: FloatArray
) -> float:
    """Mean square distance, along an edge's tangent in a pixel, from the place where it touches: of the part inside.

    Half of it times the curvature is the mean distance of the arc from the tangent, and so the area that the arc covers
    less.
    """
    chord(a, b, c, place)
    if place[0] == 0.0:
        return UNIFORM_VARIANCE
    x = pixel[X_ROW] * place[1] + pixel[X_COL] * place[2]
    y = pixel[Y_ROW] * place[1] + pixel[Y_COL] * place[2]
    middle = -by_col * x + by_row * y
    return float(middle * middle + UNIFORM_VARIANCE * place[0] * place[0])


@borrowing
def _covered_with_nearer(a: float, b: float, c: float, pixel: FloatArray, work: FloatArray, place: FloatArray) -> float:
    """Area of a half-plane and of a nearer surface; `place` is filled as by `chord`, where the edge is not hidden."""
    if pixel[HIDES] == 0.0:
        chord(a, b, c, place)
        return covered(a, b, c)
    p, q, r = pixel[HIDES_ROW], pixel[HIDES_COL], pixel[HIDES_AT]
    chord_outside(a, b, c, p, q, r, place)
    return covered(a, b, c) + covered(p, q, r) - covered_by_both(a, b, c, p, q, r, work)
