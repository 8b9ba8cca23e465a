"""Areas that straight lines cut off a pixel: the unit square around its centre. Compiled.

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
