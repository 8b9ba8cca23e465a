"""Fitting of edges to the shares of the pixels along them. Compiled.

The share of a surface in a pixel is the area that it covers there. An edge is fitted to the shares of a run of pixels
on both sides of the wanted pixel: a straight line, an arc, or two parallel lines (a bar). The run grows pixel by pixel
as long as the shares agree with it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.surfaces.edge_run import adjust, chi_square, collect, disagreement
from tofmix.surfaces.edge_shape import (
    AGREES,
    AHEAD,
    ANGLE,
    ARC,
    BACK,
    BAR,
    COLUMNS,
    FIT_COLUMNS,
    KIND,
    LINE,
    OFFSET,
    SHARE,
    THIRD,
    X,
    Y,
    covered,
)
from tofmix.surfaces.settings import EdgeSettings
from tofmix.surfaces.shares import Cuts, Shares
from tofmix.surfaces.smooth_fits import SurfaceView


@borrowing
def _first_guess(pixels: FloatArray, count: int, start: FloatArray) -> bool:
    """Set a line by the slope of the shares of the eight neighbours, and by the pixel's own share (Youngs 1982)."""
    down, right, share = 0.0, 0.0, min(max(pixels[0, SHARE], 0.02), 0.98)
    for k in range(1, count):
        if abs(pixels[k, X]) < 1.5 and abs(pixels[k, Y]) < 1.5:  # noqa: PLR2004  the eight neighbours
            weight = 1.0 / (pixels[k, X] ** 2 + pixels[k, Y] ** 2)
            down += weight * (pixels[k, SHARE] - share) * pixels[k, X]
            right += weight * (pixels[k, SHARE] - share) * pixels[k, Y]
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
        if abs(pixels[k, X]) < 2.5 and abs(pixels[k, Y]) < 2.5:  # noqa: PLR2004  two pixels around
            total += pixels[k, SHARE]
            x += pixels[k, SHARE] * pixels[k, X]
            y += pixels[k, SHARE] * pixels[k, Y]
    x, y = x / max(total, 1e-9), y / max(total, 1e-9)
    xx, xy, yy = 0.0, 0.0, 0.0
    for k in range(count):
        if abs(pixels[k, X]) < 2.5 and abs(pixels[k, Y]) < 2.5:  # noqa: PLR2004  two pixels around
            xx += pixels[k, SHARE] * (pixels[k, X] - x) ** 2
            xy += pixels[k, SHARE] * (pixels[k, X] - x) * (pixels[k, Y] - y)
            yy += pixels[k, SHARE] * (pixels[k, Y] - y) ** 2
    for i in range(FIT_COLUMNS):
        start[i] = 0.0
    # The normal is across the longer axis.
    start[ANGLE] = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi
    middle = math.cos(start[ANGLE]) * x + math.sin(start[ANGLE]) * y
    wide = min(max(total / 5.0, 0.3), 3.0)
    start[OFFSET], start[THIRD] = middle - 0.5 * wide, middle + 0.5 * wide


@borrowing
def _best_start(
    kind: int,
    pixels: FloatArray,
    count: int,
    start: FloatArray,
    trial: FloatArray,
    best: FloatArray,
    normal: FloatArray,
    right: FloatArray,
    out: FloatArray,
    work: FloatArray,
    settings: EdgeSettings,
) -> None:
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
        adjust(kind, pixels, count, trial, start, reach, reach, 2 * settings.steps, normal, right, out, work, settings)
        total = chi_square(kind, pixels, count, trial, reach, reach, out, work, settings)
        if total < least:
            least = total
            for i in range(FIT_COLUMNS):
                best[i] = trial[i]
    for i in range(FIT_COLUMNS):
        start[i] = best[i]


@borrowing
def _grow(
    kind: int,
    pixels: FloatArray,
    count: int,
    fit: FloatArray,
    start: FloatArray,
    normal: FloatArray,
    right: FloatArray,
    out: FloatArray,
    work: FloatArray,
    settings: EdgeSettings,
) -> None:
    """Fit an edge to the pixel and its neighbours, then to a run as long as the shares agree with it."""
    back, ahead = (2.0, 2.0) if kind == ARC else (1.0, 1.0)
    for i in range(FIT_COLUMNS):
        fit[i] = start[i]
    adjust(kind, pixels, count, fit, start, back, ahead, 3 * settings.steps, normal, right, out, work, settings)
    most = settings.agree_sigmas
    off = disagreement(kind, pixels, count, fit, back, ahead, -9.0, -9.0, out, work, settings)
    fit[AGREES] = 1.0 if off < most else 0.0
    go_back, go_ahead, pace = fit[AGREES] > 0.0, fit[AGREES] > 0.0, 1.0
    while go_back or go_ahead:
        more_back, more_ahead = False, False
        if go_back and back + pace <= settings.longest_run:
            off = disagreement(kind, pixels, count, fit, back + pace, ahead, back, ahead, out, work, settings)
            more_back = off < most
        if go_ahead and ahead + pace <= settings.longest_run:
            off = disagreement(kind, pixels, count, fit, back, ahead + pace, back, ahead, out, work, settings)
            more_ahead = off < most
        if pace == 1.0:
            go_back, go_ahead = more_back, more_ahead
        if more_back or more_ahead:
            old_back, old_ahead = back, ahead
            back, ahead = back + (pace if more_back else 0.0), ahead + (pace if more_ahead else 0.0)
            adjust(kind, pixels, count, fit, start, back, ahead, settings.steps, normal, right, out, work, settings)
            if disagreement(kind, pixels, count, fit, back, ahead, -9.0, -9.0, out, work, settings) > most:
                # The new ones agreed one by one, and not together.
                back, ahead = old_back, old_ahead
                adjust(kind, pixels, count, fit, start, back, ahead, settings.steps, normal, right, out, work, settings)
                go_back, go_ahead = go_back and pace > 1.0, go_ahead and pace > 1.0
                more_back = more_ahead = False
        # A long run grows by two at a time, until that fails.
        pace = 2.0 if more_back and more_ahead and min(back, ahead) >= settings.fast_run else 1.0
    fit[KIND], fit[BACK], fit[AHEAD] = kind, back, ahead


@borrowing
def _near_line_first(pixels: FloatArray, count: int, start: FloatArray, settings: EdgeSettings) -> int:
    """Put pixels that may be of a straight run first, the own one before all, and return how many they are."""
    down, right = math.cos(start[ANGLE]), math.sin(start[ANGLE])
    kept = 0
    for k in range(count):
        off = abs(down * pixels[k, X] + right * pixels[k, Y] - start[OFFSET])
        along = abs(-right * pixels[k, X] + down * pixels[k, Y])
        if k == 0 or off < 2.0 * settings.half_width + settings.first_turn * along:
            for i in range(COLUMNS):
                pixels[kept, i], pixels[k, i] = pixels[k, i], pixels[kept, i]
            kept += 1
    return kept


@jit
def fit_edges(
    which: NDArray[np.int64],
    fits: FloatArray,
    nearer: FloatArray,
    cuts: Cuts,
    shares: Shares,
    view: SurfaceView,
    settings: EdgeSettings,
) -> None:
    """Fit an edge in each of some pixels.

    Parameters
    ----------
    which : (chosen,) int64
        Cuts that are fitted.
    fits : (cut, FIT_COLUMNS) float64
        The fits, filled; `AGREES` is 0 where none agrees with the shares.
    nearer : (cut, FIT_COLUMNS) float64
        Fits of the cuts that are nearer in their pixels than these, made before; 0 for none.
    cuts, shares, view
        Of the window.
    """
    size = 2 * settings.longest_run + 1
    pixels = np.empty((size * size, COLUMNS))
    frame, normal, right = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    out, work = np.empty(7), np.empty((3, 8, 2))
    start, line, other, best = np.empty((4, FIT_COLUMNS))
    for cut in which:
        found = collect(
            cuts.near[cut],
            cuts.row[cut],
            cuts.col[cut],
            settings.longest_run,
            shares,
            view,
            cuts,
            nearer,
            frame,
            pixels,
        )
        fit = fits[cut]
        if not _first_guess(pixels, found, start):
            fit[:] = start
            continue
        adjust(LINE, pixels, found, start, start, 1.0, 1.0, settings.steps, normal, right, out, work, settings)
        near_line = _near_line_first(pixels, found, start, settings)
        _grow(LINE, pixels, near_line, line, start, normal, right, out, work, settings)
        for i in range(FIT_COLUMNS):
            fit[i] = line[i]
        if line[BACK] + line[AHEAD] < 2 * settings.longest_run:
            start[ANGLE], start[OFFSET], start[THIRD] = line[ANGLE], line[OFFSET], 0.0
            _best_start(ARC, pixels, found, start, other, best, normal, right, out, work, settings)
            _grow(ARC, pixels, found, other, start, normal, right, out, work, settings)
            if other[AGREES] > 0.0:
                back, ahead = other[BACK], other[AHEAD]
                steps = settings.steps
                adjust(LINE, pixels, found, line, start, back, ahead, steps, normal, right, out, work, settings)
                straight = chi_square(LINE, pixels, found, line, back, ahead, out, work, settings)
                bent = chi_square(ARC, pixels, found, other, back, ahead, out, work, settings)
                if straight - bent > settings.curvature_gain:
                    for i in range(FIT_COLUMNS):
                        fit[i] = other[i]
        if fit[AGREES] == 0.0:
            _first_bar(pixels, found, start)
            _best_start(BAR, pixels, found, start, other, best, normal, right, out, work, settings)
            _grow(BAR, pixels, found, other, start, normal, right, out, work, settings)
            if other[AGREES] > 0.0:
                for i in range(FIT_COLUMNS):
                    fit[i] = other[i]
