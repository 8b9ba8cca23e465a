"""The neighbouring surfaces of a pixel, from the one-surface pixels in a window around it. Compiled.

Each one-surface pixel predicts 1 / r at the pixel in question by its own plane. Predictions that agree are of one
surface; a plane is then fitted to all its pixels, and another one to their light. `tofmix.unmixing.neighbours` uses
them.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.plane import dot, fit_plane
from tofmix.unmixing.image import TINY, Measured, PixelDirections
from tofmix.unmixing.settings import NeighbourSettings

MOST_SURFACES = 4
"""Most neighbouring surfaces of a pixel, the largest first."""

_NUMBERS, _INDICES = 15, 9
"""Rows of the scratch, of numbers and of indices. The columns are the members in a window, in the order of places."""

_COSINE, _X, _Y, _INVERSE, _VARIANCE, _VALUE, _ERROR = range(7)
_OWN_X, _OWN_Y, _OWN_VALUE, _OWN_WEIGHT, _OWN_VARIANCE, _RESIDUAL, _LIGHT, _LIGHT_ERROR = range(7, _NUMBERS)
_OTHER, _DOWN, _RIGHT, _ORDER, _GROUP, _SIZE, _CLOSE, _OWN, _LINE = range(_INDICES)


class Members(NamedTuple):
    """One-surface pixels, as far as they are known. Arrays are (pixel,).

    Parameters
    ----------
    is_member : bool
        Whether the pixel is one.
    has_plane : bool
        Whether it predicts by its plane; else by its range, as a surface that faces the beam.
    has_light : bool
        Whether its amplitude is that of the surface: next to open space a pixel has the range of the surface, and less
        light.
    is_known : bool
        Whether it surely sees one surface; else it only agrees with its neighbours.
    is_trusted : bool
        Whether its surface may be continued: it is known, and more than one pixel wide or seen elsewhere too.
    is_fresh : bool
        Whether it is known by its agreement with the neighbours alone.
    plane : (pixel, 3) float64
        m of 1 / r = m . d, 1 / mm.
    middle : int64
        Pixel in the middle of the plane's window.
    line : int64
        Number of the narrow surface that the pixel sees (`tofmix.unmixing.lines`): its pixels predict together, by
        their line. -1: none.
    """

    is_member: BoolArray
    has_plane: BoolArray
    has_light: BoolArray
    is_known: BoolArray
    is_trusted: BoolArray
    is_fresh: BoolArray
    plane: FloatArray
    middle: IntArray
    line: IntArray


class NeighbourSurfaces(NamedTuple):
    """Neighbouring surfaces of pixels (n,), up to `MOST_SURFACES` each. Arrays are (n, surface) unless said otherwise.

    Parameters
    ----------
    found : bool
        Whether there is a surface of this number.
    near : (n, surface, 3) float64
        Coefficients of 1 / r in the pixel's local coordinates, 1 / mm.
    near_covariance : (n, surface, 3, 3) float64
        Their covariance.
    light, light_covariance : float64
        Likewise of u = ln A + 3 ln r.
    is_known, is_trusted, is_fresh : bool
        Whether most of its pixels are (`Members`).
    row, col : float64
        Middle of its pixels, relative to the pixel.
    touches : bool
        Whether it has a pixel within `beside`.
    noise_radial, noise_tangential : float64
        Mean variance of its pixels' mean phasors by noise.
    scatter_radial, scatter_tangential : float64
        Mean variance of its pixels' samples.
    """

    found: BoolArray
    near: FloatArray
    near_covariance: FloatArray
    light: FloatArray
    light_covariance: FloatArray
    is_known: BoolArray
    is_trusted: BoolArray
    is_fresh: BoolArray
    row: FloatArray
    col: FloatArray
    touches: BoolArray
    noise_radial: FloatArray
    noise_tangential: FloatArray
    scatter_radial: FloatArray
    scatter_tangential: FloatArray


@jit
def fill_surfaces(
    pixels: IntArray,
    rows: int,
    cols: int,
    beams: PixelDirections,
    measured: Measured,
    members: Members,
    pattern_variance: float,
    texture_variance: float,
    out: NeighbourSurfaces,
    settings: NeighbourSettings,
) -> None:
    """Fill the neighbouring surfaces of pixels (n,) of an image of `rows` x `cols`; `out` holds zeros before.

    The variances are those of ranges (mm^2) and of ln A from pixel to pixel, beyond noise.
    """
    places = (2 * settings.reach + 1) ** 2 - 1  # the middle left out
    numbers, indices = np.empty((_NUMBERS, places)), np.empty((_INDICES, places), np.int64)
    normal, fit = np.empty((4, 3)), np.empty((4, 3))
    for at in range(len(pixels)):
        pixel = pixels[at]
        count = _gather(
            pixel, rows, cols, beams, measured, members, pattern_variance, texture_variance, numbers, indices, settings
        )
        _predict_lines(pixel, count, texture_variance, beams, measured, numbers, indices, normal, fit, settings)
        groups = _sort(count, numbers, indices, settings)
        _measure(count, groups, indices, settings.near)
        for number in range(MOST_SURFACES):
            group = _next_largest(groups, indices, places)
            if group < 0:
                break
            out.found[at, number] = True
            size = _collect(count, group, _GROUP, indices)
            _fit_ranges(pixel, at, number, size, beams, members, numbers, indices, normal, out, settings)
            _fit_light(
                pixel,
                at,
                number,
                size,
                texture_variance,
                beams,
                measured,
                members,
                numbers,
                indices,
                normal,
                out,
                settings,
            )
            _describe(at, number, size, measured, members, indices, out, settings.beside)


@borrowing
def _pitch(pixel: int, beams: PixelDirections) -> float:
    """The larger of both pitches."""
    return float(max(beams.pitch_across[pixel], beams.pitch_down[pixel]))


@borrowing
def _gather(
    pixel: int,
    rows: int,
    cols: int,
    beams: PixelDirections,
    measured: Measured,
    members: Members,
    pattern_variance: float,
    texture_variance: float,
    numbers: FloatArray,
    indices: IntArray,
    settings: NeighbourSettings,
) -> int:
    """Collect the members around a pixel: where they are, and their prediction of 1 / r there with its variance."""
    row, col = pixel // cols, pixel % cols
    own = beams.direction[pixel]
    free = (settings.free_slope * _pitch(pixel, beams)) ** 2
    light_free = (settings.light_slope * _pitch(pixel, beams) + settings.least_light_slope) ** 2
    count = 0
    for r in range(max(row - settings.reach, 0), min(row + settings.reach + 1, rows)):
        for c in range(max(col - settings.reach, 0), min(col + settings.reach + 1, cols)):
            other = r * cols + c
            if other == pixel or not members.is_member[other]:
                continue
            way, inverse = beams.direction[other], 1.0 / measured.range_mm[other]
            cosine = dot(way, own)
            square = inverse * inverse
            variance = (measured.range_variance[other] + pattern_variance) * square * square
            indices[_OTHER, count], indices[_DOWN, count], indices[_RIGHT, count] = other, r - row, c - col
            indices[_LINE, count] = members.line[other]
            numbers[_COSINE, count], numbers[_INVERSE, count], numbers[_VARIANCE, count] = cosine, inverse, variance
            numbers[_X, count] = dot(way, beams.across[pixel]) / cosine / beams.pitch_across[pixel]
            numbers[_Y, count] = dot(way, beams.down[pixel]) / cosine / beams.pitch_down[pixel]
            away = (r - row) ** 2 + (c - col) ** 2
            numbers[_LIGHT, count] = measured.log_light[other]
            numbers[_LIGHT_ERROR, count] = (
                _light_variance(other, inverse, texture_variance, measured) + away * light_free
            )
            if members.has_plane[other]:
                middle = members.middle[other]
                down, right = middle // cols - row, middle % cols - col
                numbers[_VALUE, count] = dot(members.plane[other], own)
                # A plane through 3 x 3 points has the variance 1 / 9 in its middle, and a slope the variance 1 / 6.
                numbers[_ERROR, count] = variance * (1.0 / 9.0 + (down * down + right * right) / 6.0)
            else:
                numbers[_VALUE, count] = inverse / cosine
                numbers[_ERROR, count] = variance + away * free * square
            count += 1
    return count


@borrowing
def _predict_lines(
    pixel: int,
    count: int,
    texture_variance: float,
    beams: PixelDirections,
    measured: Measured,
    numbers: FloatArray,
    indices: IntArray,
    normal: FloatArray,
    fit: FloatArray,
    settings: NeighbourSettings,
) -> None:
    """Let the members of each narrow surface predict together: 1 / r and u at the pixel, with their variances.

    A line of pixels determines the slope along itself. Across it a small slope is expected: any two lines lie on a
    plane, so lines that need a steep one to agree may be of two surfaces.
    """
    for first in range(count):
        line, is_first = indices[_LINE, first], True
        for k in range(first):
            is_first = is_first and indices[_LINE, k] != line
        if line >= 0 and is_first:
            size = _collect(count, line, _LINE, indices)
            _predict_ranges(size, _pitch(pixel, beams), numbers, indices, normal, fit, settings)
            _predict_light(
                size, _pitch(pixel, beams), texture_variance, measured, numbers, indices, normal, fit, settings
            )


@borrowing
def _predict_ranges(
    size: int,
    pitch: float,
    numbers: FloatArray,
    indices: IntArray,
    normal: FloatArray,
    fit: FloatArray,
    settings: NeighbourSettings,
) -> None:
    """Predict 1 / r at the pixel from the members of a narrow surface."""
    x, y, value, weight = (
        numbers[_OWN_X, :size],
        numbers[_OWN_Y, :size],
        numbers[_OWN_VALUE, :size],
        numbers[_OWN_WEIGHT, :size],
    )
    variance, residual = numbers[_OWN_VARIANCE, :size], numbers[_RESIDUAL, :size]
    coefficients, covariance, level = fit[0], fit[1:], 0.0
    for k in range(size):
        place = indices[_OWN, k]
        x[k], y[k], variance[k] = numbers[_X, place], numbers[_Y, place], numbers[_VARIANCE, place]
        value[k], weight[k] = numbers[_INVERSE, place] / numbers[_COSINE, place], 1.0 / variance[k]
        level += value[k] / size
    for k in range(size):
        value[k] -= level
    slope = settings.known_slope * pitch * level
    fit_plane(x, y, value, weight, 1.0 / (slope * slope), normal, coefficients, covariance, residual)
    _widen(size, residual, weight, variance, covariance, settings.chance_sigmas)
    for k in range(size):
        place = indices[_OWN, k]
        numbers[_VALUE, place], numbers[_ERROR, place] = level + coefficients[0], covariance[0, 0]


@borrowing
def _predict_light(
    size: int,
    pitch: float,
    texture_variance: float,
    measured: Measured,
    numbers: FloatArray,
    indices: IntArray,
    normal: FloatArray,
    fit: FloatArray,
    settings: NeighbourSettings,
) -> None:
    """Predict u at the pixel from the members of a narrow surface, at the places of `_predict_ranges`."""
    x, y, value, weight = (
        numbers[_OWN_X, :size],
        numbers[_OWN_Y, :size],
        numbers[_OWN_VALUE, :size],
        numbers[_OWN_WEIGHT, :size],
    )
    variance, residual = numbers[_OWN_VARIANCE, :size], numbers[_RESIDUAL, :size]
    coefficients, covariance, level = fit[0], fit[1:], 0.0
    for k in range(size):
        place = indices[_OWN, k]
        other = indices[_OTHER, place]
        variance[k] = _light_variance(other, numbers[_INVERSE, place], texture_variance, measured)
        value[k], weight[k] = measured.log_light[other], 1.0 / variance[k]
        level += value[k] / size
    for k in range(size):
        value[k] -= level
    slope = settings.light_slope * pitch + settings.least_light_slope
    fit_plane(x, y, value, weight, 1.0 / (slope * slope), normal, coefficients, covariance, residual)
    _widen(size, residual, weight, variance, covariance, settings.chance_sigmas)
    for k in range(size):
        place = indices[_OWN, k]
        numbers[_LIGHT, place], numbers[_LIGHT_ERROR, place] = level + coefficients[0], covariance[0, 0]


@borrowing
def _light_variance(other: int, inverse: float, texture_variance: float, measured: Measured) -> float:
    """Variance of a pixel's u."""
    return float(
        measured.light_variance[other] + 9.0 * measured.range_variance[other] * inverse * inverse + texture_variance
    )


@borrowing
def _sort(count: int, numbers: FloatArray, indices: IntArray, settings: NeighbourSettings) -> int:
    """Number the surfaces that members belong to, from far to near, and return how many there are.

    Predictions are put in order; where the step to the next is larger than their errors, a new surface begins. So it
    does beside a narrow surface where a prediction contradicts the most certain one, which vague ones would connect.
    """
    value, order = numbers[_VALUE], indices[_ORDER]
    for k in range(count):
        at = k
        while at > 0 and value[order[at - 1]] > value[k]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = k
    _find_steps(count, numbers, indices, settings)
    number = 0
    for k in range(count):
        number += indices[_SIZE, k]
        indices[_GROUP, order[k]] = number
    return number + 1 if count > 0 else 0


@borrowing
def _find_steps(count: int, numbers: FloatArray, indices: IntArray, settings: NeighbourSettings) -> None:
    """Mark, in the row of sizes, the predictions in order at which a new surface begins."""
    value, error, order, begins = numbers[_VALUE], numbers[_ERROR], indices[_ORDER], indices[_SIZE]
    best = -1
    for k in range(count):
        here = order[k]
        begins[k] = 0
        if k > 0:
            before = order[k - 1]
            apart = settings.apart_sigmas * math.sqrt(2.0 * min(error[here], error[before]))
            is_apart = value[here] - value[before] > max(apart, settings.apart * abs(value[before]))
            begins[k] = is_apart or _contradicts(here, best, numbers, indices, settings)
        if begins[k] == 1 or best < 0 or error[here] < error[best]:
            best = here
    best = -1
    for k in range(count - 1, -1, -1):
        here = order[k]
        if best >= 0 and begins[k + 1] == 0 and _contradicts(here, best, numbers, indices, settings):
            begins[k + 1] = 1
        if best < 0 or begins[k + 1] == 1 or error[here] < error[best]:
            best = here


@borrowing
def _contradicts(one: int, other: int, numbers: FloatArray, indices: IntArray, settings: NeighbourSettings) -> bool:
    """Whether two predictions, one of them of a narrow surface, differ by more than both errors.

    The slope across a narrow surface may be that to a pixel of another one, so the predictions of light count there.
    """
    if indices[_LINE, one] < 0 and indices[_LINE, other] < 0:
        return False
    value, error, light, light_error = numbers[_VALUE], numbers[_ERROR], numbers[_LIGHT], numbers[_LIGHT_ERROR]
    apart = settings.apart_sigmas * math.sqrt(error[one] + error[other])
    light_apart = settings.apart_sigmas * math.sqrt(light_error[one] + light_error[other])
    is_apart = abs(value[one] - value[other]) > max(apart, settings.apart * abs(value[other]))
    return bool(is_apart or abs(light[one] - light[other]) > light_apart)


@borrowing
def _measure(count: int, groups: int, indices: IntArray, near: int) -> None:
    """Count the members of each surface, and those nearby."""
    size, close = indices[_SIZE], indices[_CLOSE]
    for number in range(groups):
        size[number], close[number] = 0, 0
    for k in range(count):
        number = indices[_GROUP, k]
        size[number] += 1
        if max(abs(indices[_DOWN, k]), abs(indices[_RIGHT, k])) <= near:
            close[number] += 1


@borrowing
def _next_largest(groups: int, indices: IntArray, places: int) -> int:
    """Take the surface with most pixels nearby, then with most pixels; -1: those left are of one pixel, or farther."""
    size, close = indices[_SIZE], indices[_CLOSE]
    best = -1
    for number in range(groups):
        if (
            close[number] > 0
            and size[number] > 1
            and (best < 0 or close[number] * places + size[number] > close[best] * places + size[best])
        ):
            best = number
    if best >= 0:
        close[best] = 0
    return best


@borrowing
def _collect(count: int, number: int, row: int, indices: IntArray) -> int:
    """List the members of a number in a row of indices, and return how many they are."""
    size = 0
    for k in range(count):
        if indices[row, k] == number:
            indices[_OWN, size] = k
            size += 1
    return size


@borrowing
def _fit_ranges(
    pixel: int,
    at: int,
    number: int,
    size: int,
    beams: PixelDirections,
    members: Members,
    numbers: FloatArray,
    indices: IntArray,
    normal: FloatArray,
    out: NeighbourSurfaces,
    settings: NeighbourSettings,
) -> None:
    """Fit a plane to the ranges of a surface, relative to the mean of the planes of its pixels."""
    x, y, value, weight = (
        numbers[_OWN_X, :size],
        numbers[_OWN_Y, :size],
        numbers[_OWN_VALUE, :size],
        numbers[_OWN_WEIGHT, :size],
    )
    variance, residual = numbers[_OWN_VARIANCE, :size], numbers[_RESIDUAL, :size]
    coefficients, covariance = out.near[at, number], out.near_covariance[at, number]
    plane = normal[0]
    plane[:] = 0.0
    level, known = 0.0, 0
    for k in range(size):
        other, place = indices[_OTHER, indices[_OWN, k]], indices[_OWN, k]
        level += numbers[_INVERSE, place]
        if members.has_plane[other]:
            known += 1
            for i in range(3):
                plane[i] += members.plane[other, i]
    level /= size
    for i in range(3):
        plane[i] = plane[i] / known if known > 0 else level * beams.direction[pixel, i]
    for k in range(size):
        place = indices[_OWN, k]
        x[k], y[k], variance[k] = numbers[_X, place], numbers[_Y, place], numbers[_VARIANCE, place]
        expected = dot(beams.direction[indices[_OTHER, place]], plane)
        value[k], weight[k] = (numbers[_INVERSE, place] - expected) / numbers[_COSINE, place], 1.0 / variance[k]
    m0, m1, m2 = plane[0], plane[1], plane[2]
    slope = (settings.known_slope if known > 0 else settings.free_slope) * _pitch(pixel, beams) * level
    slope_weight = 1.0 / (slope * slope)
    fit_plane(x, y, value, weight, slope_weight, normal, coefficients, covariance, residual)
    left = 0
    for k in range(size):
        left += residual[k] * residual[k] * weight[k] <= settings.outlier
    if left < size and 2 * left >= size:
        for k in range(size):
            if residual[k] * residual[k] * weight[k] > settings.outlier:
                weight[k] = 0.0
        fit_plane(x, y, value, weight, slope_weight, normal, coefficients, covariance, residual)
    right, down = beams.across[pixel], beams.down[pixel]
    coefficients[0] += m0 * beams.direction[pixel, 0] + m1 * beams.direction[pixel, 1] + m2 * beams.direction[pixel, 2]
    coefficients[1] += (m0 * right[0] + m1 * right[1] + m2 * right[2]) * beams.pitch_across[pixel]
    coefficients[2] += (m0 * down[0] + m1 * down[1] + m2 * down[2]) * beams.pitch_down[pixel]
    _widen(size, residual, weight, variance, covariance, settings.chance_sigmas)


@borrowing
def _fit_light(
    pixel: int,
    at: int,
    number: int,
    size: int,
    texture_variance: float,
    beams: PixelDirections,
    measured: Measured,
    members: Members,
    numbers: FloatArray,
    indices: IntArray,
    normal: FloatArray,
    out: NeighbourSurfaces,
    settings: NeighbourSettings,
) -> None:
    """Fit u = ln A + 3 ln r of a surface, over its pixels that were not left out of its plane."""
    x, y, value, weight = (
        numbers[_OWN_X, :size],
        numbers[_OWN_Y, :size],
        numbers[_OWN_VALUE, :size],
        numbers[_OWN_WEIGHT, :size],
    )
    variance, residual = numbers[_OWN_VARIANCE, :size], numbers[_RESIDUAL, :size]
    coefficients, covariance = out.light[at, number], out.light_covariance[at, number]
    lit = False
    for k in range(size):
        lit = lit or (weight[k] > 0.0 and members.has_light[indices[_OTHER, indices[_OWN, k]]])
    level, total = 0.0, 0.0
    for k in range(size):
        place = indices[_OWN, k]
        other, inverse = indices[_OTHER, place], numbers[_INVERSE, place]
        variance[k] = _light_variance(other, inverse, texture_variance, measured)
        used = weight[k] > 0.0 and (members.has_light[other] or not lit)
        away = indices[_DOWN, place] ** 2 + indices[_RIGHT, place] ** 2
        weight[k] = math.exp(-away / (2.0 * settings.light_reach**2)) / variance[k] if used else 0.0
        value[k] = measured.log_light[other]
        level += value[k] * weight[k]
        total += weight[k]
    level /= total
    for k in range(size):
        value[k] = value[k] - level if weight[k] > 0.0 else 0.0
    slope = settings.light_slope * _pitch(pixel, beams) + settings.least_light_slope
    fit_plane(x, y, value, weight, 1.0 / (slope * slope), normal, coefficients, covariance, residual)
    coefficients[0] += level
    _widen(size, residual, weight, variance, covariance, settings.chance_sigmas)


@borrowing
def _widen(
    size: int,
    residual: FloatArray,
    weight: FloatArray,
    variance: FloatArray,
    covariance: FloatArray,
    chance_sigmas: float,
) -> None:
    """Widen a fit's covariance where its residuals scatter more than noise.

    The whole covariance is multiplied by the excess, at least 1. The variance of the value also includes the deviation
    of a surface from its plane, at a crease or on a curved surface: the scatter of residuals beyond noise and chance,
    which does not decrease with more pixels.
    """
    used, square, total, squares, level = 0, 0.0, 0.0, 0.0, 0.0
    for k in range(size):
        if weight[k] > 0.0:
            chance = weight[k] * variance[k]  # 1, or less where a pixel counts less
            used += 1
            square += residual[k] * residual[k] * weight[k]
            total += chance
            squares += chance * chance
            level += chance * variance[k]
    inflation = max(1.0, square / max(used - 3, 1))
    for i in range(3):
        for j in range(3):
            covariance[i, j] *= inflation
    total = max(total, TINY)
    free = max(total * total / max(squares, TINY) - 3.0, 1.0)
    excess = square / total - 1.0 - chance_sigmas * math.sqrt(2.0 / free)
    covariance[0, 0] += max(excess, 0.0) * level / total


@borrowing
def _describe(
    at: int,
    number: int,
    size: int,
    measured: Measured,
    members: Members,
    indices: IntArray,
    out: NeighbourSurfaces,
    beside: int,
) -> None:
    """Fill the properties of most pixels of a surface, and the means over the pixels."""
    known, trusted, fresh, part = 0, 0, 0, 1.0 / size
    for k in range(size):
        place = indices[_OWN, k]
        other = indices[_OTHER, place]
        known += members.is_known[other]
        trusted += members.is_trusted[other]
        fresh += members.is_fresh[other]
        out.row[at, number] += indices[_DOWN, place] * part
        out.col[at, number] += indices[_RIGHT, place] * part
        out.touches[at, number] |= max(abs(indices[_DOWN, place]), abs(indices[_RIGHT, place])) <= beside
        out.noise_radial[at, number] += measured.noise_radial[other] * part
        out.noise_tangential[at, number] += measured.noise_tangential[other] * part
        out.scatter_radial[at, number] += measured.scatter_radial[other] * part
        out.scatter_tangential[at, number] += measured.scatter_tangential[other] * part
    out.is_known[at, number] = 2 * known >= size
    out.is_trusted[at, number] = 2 * trusted >= size
    out.is_fresh[at, number] = 2 * fresh >= size
