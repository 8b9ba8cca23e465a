"""Edges in a pixel: lines, arcs and bars, and the area that a surface covers behind them. Compiled.

Places are in a pixel's own plane: (x, y), down and to the right of its centre, in pixels of it, where the rays of
others meet it. A straight edge in space is a straight line there, for any projection of the camera.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.surfaces.half_plane import chord, chord_outside, covered, covered_by_both

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
