"""Numbers of an edge from the shares of a run of pixels, and whether these agree with it. Compiled.

Levenberg and Marquardt's method over angle, offset and the third number of `edge_shape`. No share is held; all are
weighed.

The pixels around an edge: their places in its pixel's plane, and the shares of its surface there. Compiled.
"""

import math

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.plane import dot
from tofmix.surfaces.edge_shape import (
    ANGLE,
    ARC,
    BACK,
    BAR,
    COV_ANGLE,
    FLOOR,
    HIDES,
    HIDES_AT,
    HIDES_COL,
    HIDES_ROW,
    LINE,
    OFFSET,
    SAMPLES,
    SHARE,
    THIRD,
    VAR_ANGLE,
    VAR_OFFSET,
    VAR_THIRD,
    X_ROW,
    Y_ROW,
    X,
    Y,
    predict,
)
from tofmix.surfaces.settings import EdgeSettings
from tofmix.surfaces.shares import Cuts, Shares
from tofmix.surfaces.smooth_fits import SurfaceView, inverse_of


@borrowing
def share_of(
    label: int,
    row: int,
    col: int,
    shares: Shares,
    view: SurfaceView,
) -> float:
    """Share (0 to 1) that a surface and all nearer ones have in a pixel; -1 if unknown.

    In a pixel without the surface the share is 0 if all its surfaces are farther than the surface would be there;
    nearer surfaces hide it.
    """
    entries = shares.entries[row, col]
    if entries == 0:
        return -1.0
    for k in range(entries):
        if shares.label[row, col, k] == label:
            return float(shares.up_to[row, col, k])
    # Entries are near to far: if the nearest is farther than the surface, all are.
    return 0.0 if shares.inverse[row, col, 0] < inverse_of(view.planes, label, row, col, view.directions) else -1.0


@borrowing
def collect(
    label: int,
    row: int,
    col: int,
    reach: int,
    shares: Shares,
    view: SurfaceView,
    cuts: Cuts,
    nearer: FloatArray,
    frame: FloatArray,
    pixels: FloatArray,
) -> int:
    """Fill `pixels` with those around (row, col) with a known share of a surface; return their number.

    The pixel itself comes first. `frame` (3, 3) is filled with the rows that give x, y and 1 of a ray in the pixel's
    own plane.
    """
    to_plane(view.rays[row, col], frame)
    rows, cols = shares.entries.shape
    found = 0
    for step in range((2 * reach + 1) * (2 * reach + 1) + 1):
        r, c = row, col
        if step > 0:
            r = row - reach + (step - 1) // (2 * reach + 1)
            c = col - reach + (step - 1) % (2 * reach + 1)
            if (r == row and c == col) or r < 0 or c < 0 or r >= rows or c >= cols:
                continue
        share = share_of(label, r, c, shares, view)
        if share < 0.0:
            continue
        one = pixels[found]
        ray = view.rays[r, c]
        depth = dot(frame[2], ray[0])
        if depth <= 0.0:
            continue
        one[X], one[Y] = dot(frame[0], ray[0]) / depth, dot(frame[1], ray[0]) / depth
        for k in range(2):
            change = dot(frame[2], ray[1 + k])
            one[X_ROW + 2 * k] = (dot(frame[0], ray[1 + k]) - one[X] * change) / depth
            one[Y_ROW + 2 * k] = (dot(frame[1], ray[1 + k]) - one[Y] * change) / depth
        one[SHARE], one[SAMPLES], one[FLOOR] = share, shares.samples[r, c], shares.floor[r, c]
        one[HIDES] = 0.0
        if shares.label[r, c, 0] != label and share > 0.0:
            known = _hide(label, r, c, shares, cuts, nearer, one)
            if not known and step > 0:
                continue
        found += 1
    return found


@borrowing
def _hide(
    label: int,
    row: int,
    col: int,
    shares: Shares,
    cuts: Cuts,
    fits: FloatArray,
    pixel: FloatArray,
) -> bool:
    """Set the edge of the surface before a label's in its pixel; return whether it is known."""
    cut, entry = cuts.first[row, col], 1
    while cut >= 0 and shares.label[row, col, entry] != label:
        cut = cuts.following[cut]
        entry += 1
    if cut < 0 or fits[cut, BACK] == 0.0:
        return False
    pixel[HIDES] = 1.0
    pixel[HIDES_ROW], pixel[HIDES_COL] = math.cos(fits[cut, ANGLE]), math.sin(fits[cut, ANGLE])
    pixel[HIDES_AT] = -fits[cut, OFFSET]
    return True


@borrowing
def to_plane(ray: FloatArray, frame: FloatArray) -> None:
    """Fill `frame` so that frame @ (centre + x down + y across) = (x, y, 1)."""
    for i in range(3):
        # Rows of the inverse of the matrix with the columns down, across, centre: cross products of the two others.
        p, q = ray[2 if i == 0 else (0 if i == 1 else 1)], ray[0 if i == 0 else (1 if i == 1 else 2)]
        frame[i, 0] = p[1] * q[2] - p[2] * q[1]
        frame[i, 1] = p[2] * q[0] - p[0] * q[2]
        frame[i, 2] = p[0] * q[1] - p[1] * q[0]
    whole = frame[0, 0] * ray[1, 0] + frame[0, 1] * ray[1, 1] + frame[0, 2] * ray[1, 2]
    for i in range(3):
        for j in range(3):
            frame[i, j] /= whole


_PRIOR = (4.0, 4.0, 4.0)
"""Weights of the first guess of angle (1/rad^2), offset (1/pixel^2) and the third number: they keep a fit regular."""


@borrowing
def _variance(share: float, pixel: FloatArray, bend: float) -> float:
    """Variance of a measured share where the true one is `share`; the area under an arc is not exact."""
    own = (share * (1.0 - share) + 0.25 / pixel[SAMPLES]) / pixel[SAMPLES] + pixel[FLOOR]
    # Error of the area under an arc, in units of its curvature squared, pixels^2: rms over places and directions.
    arc_error = 0.014
    return float(own + (arc_error * bend * bend) ** 2)


@borrowing
def is_of_run(
    kind: int,
    fit: FloatArray,
    down: float,
    right: float,
    pixel: FloatArray,
    back: float,
    ahead: float,
    settings: EdgeSettings,
) -> bool:
    """Whether a collected pixel lies at the edge of normal (down, right), not farther along it than the run."""
    along = -right * pixel[X] + down * pixel[Y]
    if along < -back - 0.5 or along > ahead + 0.5:
        return False
    off = down * pixel[X] + right * pixel[Y]
    if kind == ARC:
        across, bend = off - fit[OFFSET], fit[THIRD]
        if bend * across >= 1.0:
            return False  # the other side of the circle
        radius = math.sqrt((1.0 - bend * across) ** 2 + bend * bend * along * along)
        off = fit[OFFSET] + (2.0 * across - bend * (across * across + along * along)) / (1.0 + radius)
    least = fit[OFFSET] - settings.half_width
    most = (fit[THIRD] if kind == BAR else fit[OFFSET]) + settings.half_width
    return bool(least <= off <= most)


@borrowing
def _equations(
    kind: int,
    pixels: FloatArray,
    count: int,
    fit: FloatArray,
    start: FloatArray,
    back: float,
    ahead: float,
    normal: FloatArray,
    right: FloatArray,
    out: FloatArray,
    work: FloatArray,
    settings: EdgeSettings,
) -> float:
    """Fill the normal equations of a run about the numbers of `fit`; return chi-square, the first guess's included."""
    numbers = 2 if kind == LINE else 3
    down, across = math.cos(fit[ANGLE]), math.sin(fit[ANGLE])
    total = 0.0
    for i in range(3):
        off = start[ANGLE + i] - fit[ANGLE + i]
        right[i] = _PRIOR[i] * off
        total += _PRIOR[i] * off * off
        for j in range(3):
            normal[i, j] = _PRIOR[i] if i == j else 0.0
    for k in range(count):
        if not is_of_run(kind, fit, down, across, pixels[k], back, ahead, settings):
            continue
        predict(kind, fit[ANGLE], fit[OFFSET], fit[THIRD], pixels[k], out, work)
        weight = 1.0 / _variance(out[0], pixels[k], fit[THIRD] if kind == ARC else 0.0)
        miss = pixels[k, SHARE] - out[0]
        total += weight * miss * miss
        for i in range(numbers):
            right[i] += weight * out[1 + i] * miss
            for j in range(numbers):
                normal[i, j] += weight * out[1 + i] * out[1 + j]
    return total


@borrowing
def adjust(
    kind: int,
    pixels: FloatArray,
    count: int,
    fit: FloatArray,
    start: FloatArray,
    back: float,
    ahead: float,
    steps: int,
    normal: FloatArray,
    right: FloatArray,
    out: FloatArray,
    work: FloatArray,
    settings: EdgeSettings,
) -> None:
    """Fit the numbers of an edge to its run, from those of `fit`, which is changed; its variances are filled.

    Levenberg and Marquardt's method.
    """
    damping, converged = 0.0, False
    total = _equations(kind, pixels, count, fit, start, back, ahead, normal, right, out, work, settings)
    for _ in range(steps):
        if converged:
            break
        angle, offset, third = fit[ANGLE], fit[OFFSET], fit[THIRD]
        a, b, c = normal[0, 0] * (1.0 + damping), normal[0, 1], normal[0, 2]
        d, e, f = normal[1, 1] * (1.0 + damping), normal[1, 2], normal[2, 2] * (1.0 + damping)
        co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
        whole = a * co_a + b * co_b + c * co_c
        turn = (co_a * right[0] + co_b * right[1] + co_c * right[2]) / whole
        move = (co_b * right[0] + (a * f - c * c) * right[1] + (b * c - a * e) * right[2]) / whole
        bend = (co_c * right[0] + (b * c - a * e) * right[1] + (a * d - b * b) * right[2]) / whole
        fit[ANGLE] += min(max(turn, -0.3), 0.3)
        fit[OFFSET] += min(max(move, -0.4), 0.4)
        if kind == ARC:
            fit[THIRD] = min(
                max(fit[THIRD] + min(max(bend, -0.1), 0.1), -settings.most_curvature), settings.most_curvature
            )
        elif kind == BAR:
            fit[THIRD] = max(fit[THIRD] + min(max(bend, -0.4), 0.4), fit[OFFSET] + 0.05)
        converged = abs(turn) < 1e-4 and abs(move) < 1e-4 and abs(bend) < 1e-4  # noqa: PLR2004  rad, pixels: far below errors
        new = _equations(kind, pixels, count, fit, start, back, ahead, normal, right, out, work, settings)
        if new > total:
            fit[ANGLE], fit[OFFSET], fit[THIRD] = angle, offset, third
            damping = max(10.0 * damping, 0.1)
            total = _equations(kind, pixels, count, fit, start, back, ahead, normal, right, out, work, settings)
        else:
            total = new
            damping = 0.1 * damping if damping > 0.01 else 0.0  # noqa: PLR2004  hardly any
    a, b, c, d, e, f = normal[0, 0], normal[0, 1], normal[0, 2], normal[1, 1], normal[1, 2], normal[2, 2]
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    whole = a * co_a + b * co_b + c * co_c
    fit[VAR_ANGLE], fit[COV_ANGLE] = co_a / whole, co_b / whole
    fit[VAR_OFFSET], fit[VAR_THIRD] = (a * f - c * c) / whole, (a * d - b * b) / whole


@borrowing
def disagreement(
    kind: int,
    pixels: FloatArray,
    count: int,
    fit: FloatArray,
    back: float,
    ahead: float,
    inner_back: float,
    inner_ahead: float,
    out: FloatArray,
    work: FloatArray,
    settings: EdgeSettings,
) -> float:
    """Chi-square of the pixels of a run that are not of the inner run, in standard deviations of the normal law.

    Pixels that are pure, as they should be, count neither way.
    """
    total, told = 0.0, 0
    down, right = math.cos(fit[ANGLE]), math.sin(fit[ANGLE])
    for k in range(count):
        if not is_of_run(kind, fit, down, right, pixels[k], back, ahead, settings):
            continue
        along = -right * pixels[k, X] + down * pixels[k, Y]
        if -inner_back - 0.5 <= along <= inner_ahead + 0.5:
            continue
        predict(kind, fit[ANGLE], fit[OFFSET], fit[THIRD], pixels[k], out, work)
        variance = _variance(out[0], pixels[k], fit[THIRD] if kind == ARC else 0.0)
        variance += out[1] * out[1] * fit[VAR_ANGLE] + 2.0 * out[1] * out[2] * fit[COV_ANGLE]
        variance += out[2] * out[2] * fit[VAR_OFFSET] + out[3] * out[3] * fit[VAR_THIRD]
        miss = pixels[k, SHARE] - out[0]
        z2 = miss * miss / variance
        if z2 > 0.1 or 0.001 < out[0] < 0.999:  # noqa: PLR2004  nothing is told of the edge
            total += z2
            told += 1
    if told == 0:
        return 0.0
    # Wilson and Hilferty (1931): the cube root of chi-square is nearly normal.
    spread = 2.0 / (9.0 * told)
    return float(((total / told) ** (1.0 / 3.0) - 1.0 + spread) / math.sqrt(spread))


@borrowing
def chi_square(
    kind: int,
    pixels: FloatArray,
    count: int,
    fit: FloatArray,
    back: float,
    ahead: float,
    out: FloatArray,
    work: FloatArray,
    settings: EdgeSettings,
) -> float:
    """Chi-square of a run."""
    down, right = math.cos(fit[ANGLE]), math.sin(fit[ANGLE])
    total = 0.0
    for k in range(count):
        if is_of_run(kind, fit, down, right, pixels[k], back, ahead, settings):
            predict(kind, fit[ANGLE], fit[OFFSET], fit[THIRD], pixels[k], out, work)
            miss = pixels[k, SHARE] - out[0]
            total += miss * miss / _variance(out[0], pixels[k], fit[THIRD] if kind == ARC else 0.0)
    return total
