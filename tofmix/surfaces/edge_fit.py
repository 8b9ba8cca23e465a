"""Fitting of edges to the shares of the pixels along them. Compiled.

The share of a surface in a pixel is the area that it covers there. An edge is fitted to the shares of a run of pixels
on both sides of the wanted pixel: a straight line, an arc, or two parallel lines (a bar). The run grows pixel by pixel
as long as the shares agree with it. No pixel's own share is held; all are weighed.

Places are in a pixel's own plane: (x, y), down and to the right of its centre, in pixels of it, where the rays of
others meet it. A straight edge in space is a straight line there, for any projection of the camera.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.jit import borrowing, jit
from tofmix.surfaces.half_plane import chord, chord_outside, covered, covered_by_both

LINE, ARC, BAR = 0, 1, 2
"""Kinds of edges: n . x = c; the same with a curvature; between two parallel lines."""

REACH = 12
"""Pixels on each side that a run grows to at most."""

_LONG = 4.0
"""Pixels on a side from which on a run grows by two at a time."""

_BESIDE = 1.5
"""Distance from the line, pixels, up to which pixels are of its run."""

_UNSURE = 0.15
"""Change of direction, rad, that a run may have after its first pixels."""

_STEPS = 4
"""Steps of Gauss and Newton's method after a run has grown."""

_AGREED = 3.0
"""Standard deviations up to which a run agrees: one in a thousand that belongs to it does not."""

_CURVED = 9.0
"""Chi-square that a curvature must save: three standard errors."""

_MOST_BEND = 0.3
"""Largest curvature, 1/pixel: an arc of a smaller circle is hidden in a few pixels."""

_ARC_ERROR = 0.014
"""Error of the area under an arc, in units of its curvature squared, pixels^2: rms over places and directions."""

_PRIOR = (4.0, 4.0, 4.0)
"""Weights of the first guess of angle (1/rad^2), offset (1/pixel^2) and the third number: they keep a fit regular."""

_UNIFORM = 1.0 / 12.0
"""Variance of a place that is anywhere in a pixel, pixels^2."""

# Columns of a collected pixel.
_X, _Y, _X_ROW, _Y_ROW, _X_COL, _Y_COL, _SHARE, _SAMPLES, _FLOOR, _HIDES, _HIDES_ROW, _HIDES_COL, _HIDES_AT = range(13)

COLUMNS = 13
"""Numbers of each pixel in the neighbourhood of a cut."""

# Columns of a fit.
KIND, ANGLE, OFFSET, THIRD, BACK, AHEAD, VAR_ANGLE, COV_ANGLE, VAR_OFFSET, VAR_THIRD, WORTH = range(11)
FIT_COLUMNS = 11
"""Columns of a fit: its kind; angle of n from the rows' axis, rad; c, pixels; curvature or second offset; run behind
and ahead, pixels; variances; 1 if the fit agrees with its run."""


@borrowing
def share_of(
    label: int, row: int, col: int, count: NDArray[np.int32], labels: NDArray[np.int32], inverses: FloatArray,
    up_to: FloatArray, planes: FloatArray, directions: FloatArray,
) -> float:  # fmt: skip
    """Share (0 to 1) that a surface and all nearer ones have in a pixel; -1 if unknown.

    In a pixel without the surface the share is 0 if all its surfaces are farther than the surface's plane; nearer
    surfaces hide it.
    """
    entries = count[row, col]
    if entries == 0:
        return -1.0
    for k in range(entries):
        if labels[row, col, k] == label:
            return float(up_to[row, col, k])
    plane = 0.0
    for i in range(3):
        plane += planes[label, i] * directions[row, col, i]
    # Entries are near to far: if the nearest is farther than the plane, all are.
    return 0.0 if inverses[row, col, 0] < plane else -1.0


@borrowing
def predict(
    kind: int, angle: float, offset: float, third: float, pixel: FloatArray, out: FloatArray, work: FloatArray
) -> None:  # fmt: skip
    """Fill `out` (7,): the share of a collected pixel, and its change with angle, offset and third number.

    The rest of `out` is scratch. Where a nearer surface hides a part of the pixel, the share is that of both. `work` is
    (3, 8, 2).
    """
    down, right = math.cos(angle), math.sin(angle)
    across = down * pixel[_X] + right * pixel[_Y] - offset
    along = -right * pixel[_X] + down * pixel[_Y]
    # A circle of curvature k through c n; y across and s along. Its centre is at y = 1 / k.
    bend = third if kind == ARC else 0.0
    by_row, by_col, off = down, right, across
    if bend != 0.0:
        to_centre = 1.0 - bend * across
        radius = math.sqrt(to_centre * to_centre + bend * bend * along * along)  # in units of 1 / k
        by_row = (to_centre * down + bend * along * right) / radius
        by_col = (to_centre * right - bend * along * down) / radius
        off = (2.0 * across - bend * (across * across + along * along)) / (1.0 + radius)  # distance from the circle
    a = by_row * pixel[_X_ROW] + by_col * pixel[_Y_ROW]
    b = by_row * pixel[_X_COL] + by_col * pixel[_Y_COL]
    place = out[4:7]
    c = off
    if bend != 0.0:
        c -= 0.5 * bend * _mean_square(a, b, off, pixel, by_row, by_col, place)
    out[0] = _covered(a, b, c, pixel, work, place)
    x = pixel[_X] + pixel[_X_ROW] * place[1] + pixel[_X_COL] * place[2]
    y = pixel[_Y] + pixel[_Y_ROW] * place[1] + pixel[_Y_COL] * place[2]
    turned = -right * x + down * y
    out[1] = place[0] * turned * (1.0 + bend * offset)
    out[2] = -place[0] * (1.0 - bend * (down * x + right * y - offset))
    out[3] = 0.0
    if kind == ARC:
        square = (down * x + right * y - offset) ** 2 + turned * turned + _UNIFORM * place[0] * place[0]
        out[3] = -0.5 * place[0] * square
    if kind == BAR:
        c = off + offset - third
        out[0] -= covered(a, b, c)
        chord(a, b, c, place)
        x = pixel[_X] + pixel[_X_ROW] * place[1] + pixel[_X_COL] * place[2]
        y = pixel[_Y] + pixel[_Y_ROW] * place[1] + pixel[_Y_COL] * place[2]
        out[1] -= place[0] * (-right * x + down * y)
        out[3] = place[0]


@borrowing
def own_area(fit: FloatArray, pixel: FloatArray, out: FloatArray, work: FloatArray) -> float:
    """Area that a fit covers in its own pixel; the arrays are scratch: (COLUMNS,), (7,), (3, 8, 2)."""
    for i in range(COLUMNS):
        pixel[i] = 0.0
    pixel[_X_ROW] = pixel[_Y_COL] = 1.0
    predict(int(fit[KIND]), fit[ANGLE], fit[OFFSET], fit[THIRD], pixel, out, work)
    return float(out[0])


@borrowing
def _mean_square(
    a: float, b: float, c: float, pixel: FloatArray, by_row: float, by_col: float, place: FloatArray
) -> float:  # fmt: skip
    """Mean square distance, along an edge's tangent in a pixel, from the place where it touches: of the part inside.

    Half of it times the curvature is the mean distance of the arc from the tangent, and so the area that the arc covers
    less.
    """
    chord(a, b, c, place)
    if place[0] == 0.0:
        return _UNIFORM
    x = pixel[_X_ROW] * place[1] + pixel[_X_COL] * place[2]
    y = pixel[_Y_ROW] * place[1] + pixel[_Y_COL] * place[2]
    middle = -by_col * x + by_row * y
    return float(middle * middle + _UNIFORM * place[0] * place[0])


@borrowing
def _covered(
    a: float, b: float, c: float, pixel: FloatArray, work: FloatArray, place: FloatArray
) -> float:  # fmt: skip
    """Area of a half-plane and of a nearer surface; `place` is filled as by `chord`, where the edge is not hidden."""
    if pixel[_HIDES] == 0.0:
        chord(a, b, c, place)
        return covered(a, b, c)
    p, q, r = pixel[_HIDES_ROW], pixel[_HIDES_COL], pixel[_HIDES_AT]
    chord_outside(a, b, c, p, q, r, place)
    return covered(a, b, c) + covered(p, q, r) - covered_by_both(a, b, c, p, q, r, work)


@borrowing
def _variance(share: float, pixel: FloatArray, bend: float) -> float:
    """Variance of a measured share where the true one is `share`; the area under an arc is not exact."""
    own = (share * (1.0 - share) + 0.25 / pixel[_SAMPLES]) / pixel[_SAMPLES] + pixel[_FLOOR]
    return float(own + (_ARC_ERROR * bend * bend) ** 2)


@borrowing
def _is_of_run(
    kind: int, fit: FloatArray, down: float, right: float, pixel: FloatArray, back: float, ahead: float
) -> bool:  # fmt: skip
    """Whether a collected pixel lies at the edge of normal (down, right), not farther along it than the run."""
    along = -right * pixel[_X] + down * pixel[_Y]
    if along < -back - 0.5 or along > ahead + 0.5:
        return False
    off = down * pixel[_X] + right * pixel[_Y]
    if kind == ARC:
        across, bend = off - fit[OFFSET], fit[THIRD]
        if bend * across >= 1.0:
            return False  # the other side of the circle
        radius = math.sqrt((1.0 - bend * across) ** 2 + bend * bend * along * along)
        off = fit[OFFSET] + (2.0 * across - bend * (across * across + along * along)) / (1.0 + radius)
    least = fit[OFFSET] - _BESIDE
    most = (fit[THIRD] if kind == BAR else fit[OFFSET]) + _BESIDE
    return bool(least <= off <= most)


@borrowing
def _equations(
    kind: int, pixels: FloatArray, count: int, fit: FloatArray, start: FloatArray, back: float, ahead: float,
    normal: FloatArray, right: FloatArray, out: FloatArray, work: FloatArray,
) -> float:  # fmt: skip
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
        if not _is_of_run(kind, fit, down, across, pixels[k], back, ahead):
            continue
        predict(kind, fit[ANGLE], fit[OFFSET], fit[THIRD], pixels[k], out, work)
        weight = 1.0 / _variance(out[0], pixels[k], fit[THIRD] if kind == ARC else 0.0)
        miss = pixels[k, _SHARE] - out[0]
        total += weight * miss * miss
        for i in range(numbers):
            right[i] += weight * out[1 + i] * miss
            for j in range(numbers):
                normal[i, j] += weight * out[1 + i] * out[1 + j]
    return total


@borrowing
def _adjust(
    kind: int, pixels: FloatArray, count: int, fit: FloatArray, start: FloatArray, back: float, ahead: float,
    steps: int, normal: FloatArray, right: FloatArray, out: FloatArray, work: FloatArray,
) -> None:  # fmt: skip
    """Fit the numbers of an edge to its run, from those of `fit`, which is changed; its variances are filled.

    Levenberg and Marquardt's method.
    """
    damping, settled = 0.0, False
    total = _equations(kind, pixels, count, fit, start, back, ahead, normal, right, out, work)
    for _ in range(steps):
        if settled:
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
            fit[THIRD] = min(max(fit[THIRD] + min(max(bend, -0.1), 0.1), -_MOST_BEND), _MOST_BEND)
        elif kind == BAR:
            fit[THIRD] = max(fit[THIRD] + min(max(bend, -0.4), 0.4), fit[OFFSET] + 0.05)
        settled = abs(turn) < 1e-4 and abs(move) < 1e-4 and abs(bend) < 1e-4  # noqa: PLR2004  rad, pixels: far below errors
        new = _equations(kind, pixels, count, fit, start, back, ahead, normal, right, out, work)
        if new > total:
            fit[ANGLE], fit[OFFSET], fit[THIRD] = angle, offset, third
            damping = max(10.0 * damping, 0.1)
            total = _equations(kind, pixels, count, fit, start, back, ahead, normal, right, out, work)
        else:
            total = new
            damping = 0.1 * damping if damping > 0.01 else 0.0  # noqa: PLR2004  hardly any
    a, b, c, d, e, f = normal[0, 0], normal[0, 1], normal[0, 2], normal[1, 1], normal[1, 2], normal[2, 2]
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    whole = a * co_a + b * co_b + c * co_c
    fit[VAR_ANGLE], fit[COV_ANGLE] = co_a / whole, co_b / whole
    fit[VAR_OFFSET], fit[VAR_THIRD] = (a * f - c * c) / whole, (a * d - b * b) / whole


@borrowing
def _disagreement(
    kind: int, pixels: FloatArray, count: int, fit: FloatArray, back: float, ahead: float, inner_back: float,
    inner_ahead: float, out: FloatArray, work: FloatArray,
) -> float:  # fmt: skip
    """Chi-square of the pixels of a run that are not of the inner run, in standard deviations of the normal law.

    Pixels that are pure, as they should be, count neither way.
    """
    total, told = 0.0, 0
    down, right = math.cos(fit[ANGLE]), math.sin(fit[ANGLE])
    for k in range(count):
        if not _is_of_run(kind, fit, down, right, pixels[k], back, ahead):
            continue
        along = -right * pixels[k, _X] + down * pixels[k, _Y]
        if -inner_back - 0.5 <= along <= inner_ahead + 0.5:
            continue
        predict(kind, fit[ANGLE], fit[OFFSET], fit[THIRD], pixels[k], out, work)
        variance = _variance(out[0], pixels[k], fit[THIRD] if kind == ARC else 0.0)
        variance += out[1] * out[1] * fit[VAR_ANGLE] + 2.0 * out[1] * out[2] * fit[COV_ANGLE]
        variance += out[2] * out[2] * fit[VAR_OFFSET] + out[3] * out[3] * fit[VAR_THIRD]
        miss = pixels[k, _SHARE] - out[0]
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
def _grow(
    kind: int, pixels: FloatArray, count: int, fit: FloatArray, start: FloatArray, normal: FloatArray,
    right: FloatArray, out: FloatArray, work: FloatArray,
) -> None:  # fmt: skip
    """Fit an edge to the pixel and its neighbours, then to a run as long as the shares agree with it."""
    back, ahead = (2.0, 2.0) if kind == ARC else (1.0, 1.0)
    for i in range(FIT_COLUMNS):
        fit[i] = start[i]
    _adjust(kind, pixels, count, fit, start, back, ahead, 3 * _STEPS, normal, right, out, work)
    fit[WORTH] = 1.0 if _disagreement(kind, pixels, count, fit, back, ahead, -9.0, -9.0, out, work) < _AGREED else 0.0
    go_back, go_ahead, pace = fit[WORTH] > 0.0, fit[WORTH] > 0.0, 1.0
    while go_back or go_ahead:
        more_back = (
            go_back
            and back + pace <= REACH
            and _disagreement(kind, pixels, count, fit, back + pace, ahead, back, ahead, out, work) < _AGREED
        )
        more_ahead = (
            go_ahead
            and ahead + pace <= REACH
            and _disagreement(kind, pixels, count, fit, back, ahead + pace, back, ahead, out, work) < _AGREED
        )
        if pace == 1.0:
            go_back, go_ahead = more_back, more_ahead
        if more_back or more_ahead:
            old_back, old_ahead = back, ahead
            back, ahead = back + (pace if more_back else 0.0), ahead + (pace if more_ahead else 0.0)
            _adjust(kind, pixels, count, fit, start, back, ahead, _STEPS, normal, right, out, work)
            if _disagreement(kind, pixels, count, fit, back, ahead, -9.0, -9.0, out, work) > _AGREED:
                # The new ones agreed one by one, and not together.
                back, ahead = old_back, old_ahead
                _adjust(kind, pixels, count, fit, start, back, ahead, _STEPS, normal, right, out, work)
                go_back, go_ahead = go_back and pace > 1.0, go_ahead and pace > 1.0
                more_back = more_ahead = False
        # A long run grows by two at a time, until that fails.
        pace = 2.0 if more_back and more_ahead and min(back, ahead) >= _LONG else 1.0
    fit[KIND], fit[BACK], fit[AHEAD] = kind, back, ahead


@borrowing
def _beside_first(pixels: FloatArray, count: int, start: FloatArray) -> int:
    """Put pixels that may be of a straight run first, the own one before all, and return how many they are."""
    down, right = math.cos(start[ANGLE]), math.sin(start[ANGLE])
    kept = 0
    for k in range(count):
        off = abs(down * pixels[k, _X] + right * pixels[k, _Y] - start[OFFSET])
        along = abs(-right * pixels[k, _X] + down * pixels[k, _Y])
        if k == 0 or off < 2.0 * _BESIDE + _UNSURE * along:
            for i in range(COLUMNS):
                pixels[kept, i], pixels[k, i] = pixels[k, i], pixels[kept, i]
            kept += 1
    return kept


@borrowing
def _chi2(
    kind: int, pixels: FloatArray, count: int, fit: FloatArray, back: float, ahead: float, out: FloatArray,
    work: FloatArray,
) -> float:  # fmt: skip
    """Chi-square of a run."""
    down, right = math.cos(fit[ANGLE]), math.sin(fit[ANGLE])
    total = 0.0
    for k in range(count):
        if _is_of_run(kind, fit, down, right, pixels[k], back, ahead):
            predict(kind, fit[ANGLE], fit[OFFSET], fit[THIRD], pixels[k], out, work)
            miss = pixels[k, _SHARE] - out[0]
            total += miss * miss / _variance(out[0], pixels[k], fit[THIRD] if kind == ARC else 0.0)
    return total


@borrowing
def _collect(
    label: int, row: int, col: int, reach: int, count: NDArray[np.int32], labels: NDArray[np.int32],
    inverses: FloatArray, up_to: FloatArray, samples: FloatArray, floor: FloatArray, planes: FloatArray,
    directions: FloatArray, rays: FloatArray, first_cut: NDArray[np.int32], next_cut: NDArray[np.int32],
    nearer: FloatArray, frame: FloatArray, pixels: FloatArray,
) -> int:  # fmt: skip
    """Fill `pixels` with those around (row, col) with a known share of a surface; return their number.

    The pixel itself comes first. `rays` is (row, col, 3, 3): the ray of the centre, and its change down and across;
    `frame` (3, 3) is filled with the rows that give x, y and 1 of a ray in the pixel's own plane.
    """
    _invert(rays[row, col], frame)
    rows, cols = count.shape
    found = 0
    for step in range((2 * reach + 1) * (2 * reach + 1) + 1):
        r, c = row, col
        if step > 0:
            r = row - reach + (step - 1) // (2 * reach + 1)
            c = col - reach + (step - 1) % (2 * reach + 1)
            if (r == row and c == col) or r < 0 or c < 0 or r >= rows or c >= cols:
                continue
        share = share_of(label, r, c, count, labels, inverses, up_to, planes, directions)
        if share < 0.0:
            continue
        one = pixels[found]
        ray = rays[r, c]
        depth = _along(frame[2], ray[0])
        if depth <= 0.0:
            continue
        one[_X], one[_Y] = _along(frame[0], ray[0]) / depth, _along(frame[1], ray[0]) / depth
        for k in range(2):
            change = _along(frame[2], ray[1 + k])
            one[_X_ROW + 2 * k] = (_along(frame[0], ray[1 + k]) - one[_X] * change) / depth
            one[_Y_ROW + 2 * k] = (_along(frame[1], ray[1 + k]) - one[_Y] * change) / depth
        one[_SHARE], one[_SAMPLES], one[_FLOOR] = share, samples[r, c], floor[r, c]
        one[_HIDES] = 0.0
        if labels[r, c, 0] != label and share > 0.0:
            known = _hide(label, r, c, labels, first_cut, next_cut, nearer, one)
            if not known and step > 0:
                continue
        found += 1
    return found


@borrowing
def _hide(
    label: int, row: int, col: int, labels: NDArray[np.int32], first_cut: NDArray[np.int32],
    next_cut: NDArray[np.int32], fits: FloatArray, pixel: FloatArray,
) -> bool:  # fmt: skip
    """Set the edge of the surface before a label's in its pixel; return whether it is known."""
    cut, entry = first_cut[row, col], 1
    while cut >= 0 and labels[row, col, entry] != label:
        cut = next_cut[cut]
        entry += 1
    if cut < 0 or fits[cut, BACK] == 0.0:
        return False
    pixel[_HIDES] = 1.0
    pixel[_HIDES_ROW], pixel[_HIDES_COL] = math.cos(fits[cut, ANGLE]), math.sin(fits[cut, ANGLE])
    pixel[_HIDES_AT] = -fits[cut, OFFSET]
    return True


@borrowing
def _along(x: FloatArray, y: FloatArray) -> float:
    return float(x[0] * y[0] + x[1] * y[1] + x[2] * y[2])


@borrowing
def _invert(ray: FloatArray, frame: FloatArray) -> None:
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


@borrowing
def _first_guess(pixels: FloatArray, count: int, start: FloatArray) -> bool:
    """Set a line by the slope of the shares of the eight neighbours, and by the pixel's own share (Youngs 1982)."""
    down, right, share = 0.0, 0.0, min(max(pixels[0, _SHARE], 0.02), 0.98)
    for k in range(1, count):
        if abs(pixels[k, _X]) < 1.5 and abs(pixels[k, _Y]) < 1.5:  # noqa: PLR2004  the eight neighbours
            weight = 1.0 / (pixels[k, _X] ** 2 + pixels[k, _Y] ** 2)
            down += weight * (pixels[k, _SHARE] - share) * pixels[k, _X]
            right += weight * (pixels[k, _SHARE] - share) * pixels[k, _Y]
    for i in range(FIT_COLUMNS):
        start[i] = 0.0
    start[ANGLE] = math.atan2(right, down)
    a, b = math.cos(start[ANGLE]), math.sin(start[ANGLE])
    low, high = -1.0, 1.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        if covered(a, b, -middle) > share:
            low = middle
        else:
            high = middle
    start[OFFSET] = 0.5 * (low + high)
    return down != 0.0 or right != 0.0


@borrowing
def _first_bar(pixels: FloatArray, count: int, start: FloatArray) -> None:
    """Set a bar by the second moments of the shares within two pixels."""
    total, x, y = 0.0, 0.0, 0.0
    for k in range(count):
        if abs(pixels[k, _X]) < 2.5 and abs(pixels[k, _Y]) < 2.5:  # noqa: PLR2004  two pixels around
            total += pixels[k, _SHARE]
            x += pixels[k, _SHARE] * pixels[k, _X]
            y += pixels[k, _SHARE] * pixels[k, _Y]
    x, y = x / max(total, 1e-9), y / max(total, 1e-9)
    xx, xy, yy = 0.0, 0.0, 0.0
    for k in range(count):
        if abs(pixels[k, _X]) < 2.5 and abs(pixels[k, _Y]) < 2.5:  # noqa: PLR2004  two pixels around
            xx += pixels[k, _SHARE] * (pixels[k, _X] - x) ** 2
            xy += pixels[k, _SHARE] * (pixels[k, _X] - x) * (pixels[k, _Y] - y)
            yy += pixels[k, _SHARE] * (pixels[k, _Y] - y) ** 2
    for i in range(FIT_COLUMNS):
        start[i] = 0.0
    # The normal is across the longer axis.
    start[ANGLE] = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi
    middle = math.cos(start[ANGLE]) * x + math.sin(start[ANGLE]) * y
    wide = min(max(total / 5.0, 0.3), 3.0)
    start[OFFSET], start[THIRD] = middle - 0.5 * wide, middle + 0.5 * wide


@borrowing
def _best_start(
    kind: int, pixels: FloatArray, count: int, start: FloatArray, trial: FloatArray, best: FloatArray,
    normal: FloatArray, right: FloatArray, out: FloatArray, work: FloatArray,
) -> None:  # fmt: skip
    """Move a first guess to the best of a few fits of the nearest pixels.

    Arcs begin with several curvatures. Bars begin from the guess and from both sides of it: one that lies within a
    row of pixels can be moved without a change of any share, and no slope leads out of there.
    """
    reach = 2.0 if kind == ARC else 1.0
    least = np.inf
    for shift in range(-2, 3):
        for i in range(FIT_COLUMNS):
            trial[i] = start[i]
        if kind == ARC:
            trial[THIRD] += 0.12 * shift
        else:
            trial[OFFSET] += 0.15 * shift
            trial[THIRD] += 0.15 * shift
        _adjust(kind, pixels, count, trial, start, reach, reach, 2 * _STEPS, normal, right, out, work)
        total = _chi2(kind, pixels, count, trial, reach, reach, out, work)
        if total < least:
            least = total
            for i in range(FIT_COLUMNS):
                best[i] = trial[i]
    for i in range(FIT_COLUMNS):
        start[i] = best[i]


@jit
def fit_edges(
    which: NDArray[np.int64], fits: FloatArray, nearer: FloatArray, first_cut: NDArray[np.int32],
    next_cut: NDArray[np.int32],
    rows: NDArray[np.int32], cols: NDArray[np.int32], cut_labels: NDArray[np.int32], count: NDArray[np.int32],
    labels: NDArray[np.int32], inverses: FloatArray, up_to: FloatArray, samples: FloatArray, floor: FloatArray,
    planes: FloatArray, directions: FloatArray, rays: FloatArray,
) -> None:  # fmt: skip
    """Fit an edge in each of some pixels.

    Parameters
    ----------
    which : (chosen,) int64
        Cuts that are fitted.
    fits : (cut, FIT_COLUMNS) float64
        The fits, filled; `WORTH` is 0 where none agrees with the shares.
    nearer : (cut, FIT_COLUMNS) float64
        Fits of the cuts that are nearer in their pixels than these, made before; 0 for none.
    first_cut, next_cut
        The first cut of each pixel (row, col), and the next one of each cut's pixel; -1: none.
    rows, cols, cut_labels : (cut,) int32
        The pixels, and the surface that ends there.
    count, labels, inverses, up_to, samples, floor
        Of `Shares`.
    planes : (surface, 3) float64
        m of 1/r = m . d.
    directions : (row, col, 3) float64
        Unit vectors d.
    rays : (row, col, 3, 3) float64
        Ray through the centre of each pixel, and its change to the next row and to the next column.
    """
    size = 2 * REACH + 1
    pixels = np.empty((size * size, COLUMNS))
    frame, normal, right = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    out, work = np.empty(7), np.empty((3, 8, 2))
    start, line, other, best = np.empty((4, FIT_COLUMNS))
    for cut in which:
        found = _collect(
            cut_labels[cut], rows[cut], cols[cut], REACH, count, labels, inverses, up_to, samples, floor, planes,
            directions, rays, first_cut, next_cut, nearer, frame, pixels,
        )  # fmt: skip
        fit = fits[cut]
        if not _first_guess(pixels, found, start):
            fit[:] = start
            continue
        _adjust(LINE, pixels, found, start, start, 1.0, 1.0, _STEPS, normal, right, out, work)
        beside = _beside_first(pixels, found, start)
        _grow(LINE, pixels, beside, line, start, normal, right, out, work)
        for i in range(FIT_COLUMNS):
            fit[i] = line[i]
        if line[BACK] + line[AHEAD] < 2 * REACH:
            start[ANGLE], start[OFFSET], start[THIRD] = line[ANGLE], line[OFFSET], 0.0
            _best_start(ARC, pixels, found, start, other, best, normal, right, out, work)
            _grow(ARC, pixels, found, other, start, normal, right, out, work)
            if other[WORTH] > 0.0:
                back, ahead = other[BACK], other[AHEAD]
                _adjust(LINE, pixels, found, line, start, back, ahead, _STEPS, normal, right, out, work)
                straight = _chi2(LINE, pixels, found, line, back, ahead, out, work)
                if straight - _chi2(ARC, pixels, found, other, back, ahead, out, work) > _CURVED:
                    for i in range(FIT_COLUMNS):
                        fit[i] = other[i]
        if fit[WORTH] == 0.0:
            _first_bar(pixels, found, start)
            _best_start(BAR, pixels, found, start, other, best, normal, right, out, work)
            _grow(BAR, pixels, found, other, start, normal, right, out, work)
            if other[WORTH] > 0.0:
                for i in range(FIT_COLUMNS):
                    fit[i] = other[i]
