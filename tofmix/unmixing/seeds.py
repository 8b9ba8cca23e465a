"""Pixels that surely see one surface: those in 3 x 3 windows in which range and light are those of a plane.

The scatter about such planes is measured too: beyond noise it is fixed pattern, in range, and texture, in light. Both
belong to the errors of everything that follows.
"""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.plane import fit_plane
from tofmix.image.segments import components
from tofmix.unmixing.functions import chi_square_6
from tofmix.unmixing.image import Measured, PhasorImage, PixelDirections, places, window
from tofmix.unmixing.settings import DEFAULT_SETTINGS, SeedSettings

_FREE = 6
"""Degrees of freedom of a plane through 3 x 3 pixels."""


def _continued(away: int) -> float:
    """Variance of a plane through 3 x 3 pixels, `away` pixels beyond these, in units of a pixel's own."""
    return 1.0 / 9.0 + (1 + away) ** 2 / 6.0


_CONTINUED = _continued(1)

_BLOCK = 1 << 14
"""Pixels that are worked on at once: some 10 MB an array."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seeds:
    """Results of 3 x 3 windows.

    Parameters
    ----------
    plane : (pixel, 3) float64
        m of the plane 1 / r = m . d of the best window that holds the pixel, 1 / mm; 0 where there is none.
    middle : (pixel,) int64
        The middle of that window.
    has_plane : (pixel,) bool
        Whether there is a plane, in a block of at least 4 x 4 pixels.
    certain : (pixel,) bool
        Whether light, too, is that of one surface: such a pixel sees nothing else.
    pattern_variance : float
        Variance of ranges beyond noise, mm^2.
    texture_variance : float
        Variance of ln A beyond noise.
    """

    plane: FloatArray
    middle: IntArray
    has_plane: BoolArray
    certain: BoolArray
    pattern_variance: float
    texture_variance: float


def find_seeds(image: PhasorImage, settings: SeedSettings = DEFAULT_SETTINGS.seeds) -> Seeds:
    """Fit a plane to each 3 x 3 window, in range and in light."""
    around = window(1, middle=True)
    planes, scatters = np.zeros((image.count, 3)), np.zeros((image.count, 4))
    pixels = _fit_windows(*image.shape, image.valid, image.beams, image.measured, planes, scatters)
    range_scatter, range_noise, light_scatter, light_noise = scatters[pixels].T
    limit = chi_square_6(settings.rare) / _FREE
    along = [_line_scatters(image, axis) for axis in (0, 1)]
    pattern = _beyond_noise([(range_scatter, range_noise), *(line[:2] for line in along)], limit, settings)
    if math.sqrt(pattern) > settings.most_pattern * image.scale_mm:
        pattern = 0.0  # no camera's: nearly all windows are of several surfaces, as behind a mesh
    texture = _beyond_noise([(light_scatter, light_noise), *(line[2:] for line in along)], limit, settings)
    excess = range_scatter / np.maximum(range_noise + pattern, np.finfo(float).tiny)
    of_plane = excess < limit
    of_surface = of_plane & (light_scatter < limit * (light_noise + texture))
    score, surely = np.full(image.count, np.inf), np.zeros(image.count, bool)
    score[pixels[of_plane]], surely[pixels[of_surface]] = excess[of_plane], True
    score[~_in_square(np.isfinite(score), image.shape)] = np.inf
    surely = _in_square(surely, image.shape)
    middle, has_plane, certain = (np.zeros(image.count, kind) for kind in (np.int64, bool, bool))
    for start in range(0, image.count, _BLOCK):
        own = np.arange(start, min(start + _BLOCK, image.count))
        others, inside = places(own, image.shape, around)
        scores = np.where(inside, score[others], np.inf)
        best = scores.argmin(axis=1)
        middle[own] = others[np.arange(len(own)), best]
        has_plane[own] = np.isfinite(scores.min(axis=1)) & image.valid[own]
        certain[own] = (inside & surely[others]).any(axis=1) & has_plane[own]
    unlike = _unlike(image, np.flatnonzero(certain & ~surely), planes, surely, pattern, settings)
    has_plane[unlike] = certain[unlike] = False
    return Seeds(
        plane=np.where(has_plane[:, np.newaxis], planes[middle], 0.0),
        middle=middle,
        has_plane=has_plane,
        certain=certain,
        pattern_variance=pattern,
        texture_variance=texture,
    )


def _unlike(
    image: PhasorImage,
    pixels: IntArray,
    planes: FloatArray,
    surely: BoolArray,
    pattern: float,
    settings: SeedSettings,
) -> IntArray:
    """Pixels at the border of a surface that may not belong to it, by the planes of neighbouring windows.

    A slope takes up a column of mixed pixels at a window's side. The neighbouring windows, two pixels away, do not
    include the column. A pixel is unlike where, along an axis, it has the range of neither side, or lies between two
    sides that differ.
    """
    row, col = np.divmod(pixels, image.shape[1])
    near = 1.0 / image.range_mm[pixels]
    sigma = np.sqrt((1.0 + _CONTINUED) * (image.range_variance[pixels] + pattern)) * near**2
    unlike = np.zeros(len(pixels), bool)
    for axis in (0, 1):
        least, ends = np.full(len(pixels), np.inf), []
        for away in (-2, 2):
            total, count = np.zeros(len(pixels)), np.zeros(len(pixels))
            for side in (-1, 0, 1):
                r, c = (row + away, col + side) if axis == 0 else (row + side, col + away)
                inside = (r >= 0) & (r < image.shape[0]) & (c >= 0) & (c < image.shape[1])
                middle = np.where(inside, r * image.shape[1] + c, 0)
                miss = (near - (planes[middle] * image.directions[pixels]).sum(axis=1)) / sigma
                known = inside & surely[middle]
                least = np.where(known, np.minimum(least, np.abs(miss)), least)
                total, count = total + np.where(known, miss, 0.0), count + known
            ends.append(np.where(count > 0, total / np.maximum(count, 1.0), np.nan))
        low, high = np.fmin(*ends), np.fmax(*ends)
        off = settings.between_sigmas
        between = (low < -off) & (high > off) & (high - low > settings.different_sigmas)
        unlike |= (np.isfinite(least) & (least > settings.unlike_sigmas)) | between
    return pixels[unlike]


def without_creases(image: PhasorImage, seeds: Seeds, segment: IntArray, sigmas: float) -> tuple[IntArray, IntArray]:
    """Part segments where the planes of neighbouring pixels disagree, as two walls do at their crease.

    Parameters
    ----------
    image, seeds
        Of one window.
    segment : (pixel,) int64
        Number of the segment of each pixel; -1 for none.
    sigmas : float
        Standard errors up to which a plane agrees with the next pixel.

    Returns
    -------
    segment : (pixel,) int64
        Numbers of the parts. A pixel without a plane, which a crease crosses, is of the part beside it, if there is
        only one.
    origin : (part,) int64
        The segment of each part.
    """
    index = np.arange(image.count).reshape(image.shape)
    ones, others, sides = [], [], []
    for one, other, step in ((index[:, :-1], index[:, 1:], 1), (index[:-1], index[1:], image.shape[1])):
        a, b = one.ravel(), other.ravel()
        same = (segment[a] >= 0) & (segment[a] == segment[b])
        a, b = a[same], b[same]
        known = seeds.has_plane[a] & seeds.has_plane[b]
        agree = known.copy()
        for away in (1, 2):  # a weak crease shows farther away
            for plane, pixel in ((a, a + away * step), (b, b - away * step)):
                agree &= _goes_on(image, seeds, segment, plane, pixel, away, sigmas)
        bare = ~seeds.has_plane[a] & ~seeds.has_plane[b]
        ones.append(a[agree | bare])
        others.append(b[agree | bare])
        sides.append(np.stack([a, b])[:, ~known & ~bare])
    number = components(np.concatenate(ones), np.concatenate(others), image.count)
    side = np.concatenate(sides, axis=1)
    plane_first = seeds.has_plane[side[0]]
    inner, outer = np.where(plane_first, side[1], side[0]), np.where(plane_first, side[0], side[1])
    count = int(number.max()) + 1
    least, most = np.full(count, count), np.full(count, -1)
    np.minimum.at(least, number[inner], number[outer])
    np.maximum.at(most, number[inner], number[outer])
    joined = np.where(most < 0, np.arange(count), np.where(least == most, most, -1))
    part = np.where(segment >= 0, joined[number], -1)
    kept, renamed = np.unique(part[part >= 0], return_inverse=True)
    out = np.full(image.count, -1)
    out[part >= 0] = renamed
    origin = np.zeros(kept.size, np.int64)
    origin[out[part >= 0]] = segment[part >= 0]
    return out, origin


def _goes_on(
    image: PhasorImage, seeds: Seeds, segment: IntArray, plane: IntArray, pixel: IntArray, away: int, sigmas: float
) -> BoolArray:
    """Whether the planes of pixels (n,) hold at pixels (n,) `away` from them, or these are of no segment."""
    inside = (pixel >= 0) & (pixel < image.count)
    at = np.where(inside, pixel, plane)
    rows, cols = (
        np.abs(one - other) for one, other in zip(*(np.divmod(k, image.shape[1]) for k in (at, plane)), strict=True)
    )
    inside &= (segment[at] == segment[plane]) & (np.maximum(rows, cols) == away)
    near = 1.0 / image.range_mm[at]
    variance = (1.0 + _continued(away)) * (image.range_variance[at] + seeds.pattern_variance)
    miss = near - (seeds.plane[plane] * image.directions[at]).sum(axis=1)
    return np.asarray(~inside | (np.abs(miss) < sigmas * np.sqrt(variance) * near**2))


@jit
def _fit_windows(
    rows: int,
    cols: int,
    valid: BoolArray,
    beams: PixelDirections,
    measured: Measured,
    plane: FloatArray,
    scatters: FloatArray,
) -> IntArray:
    """Fit planes to the 3 x 3 pixels around each pixel whose window is whole, and return those pixels.

    `plane` (pixel, 3) and `scatters` (pixel, 4) are filled there: m, and the mean squares of residuals and of noise, of
    ranges (mm^2) and of light.
    """
    x, y, value, even, residual = np.empty(9), np.empty(9), np.empty(9), np.ones(9), np.empty(9)
    normal, coefficients, covariance = np.empty((4, 3)), np.empty(3), np.empty((3, 3))
    other = np.empty(9, np.int64)
    whole, count = np.empty(rows * cols, np.int64), 0
    for row in range(1, rows - 1):
        for col in range(1, cols - 1):
            pixel, is_whole = row * cols + col, True
            for k in range(9):
                other[k] = (row + k // 3 - 1) * cols + col + k % 3 - 1
                is_whole = is_whole and valid[other[k]]
            if not is_whole:
                continue
            whole[count] = pixel
            count += 1
            own, right, down = beams.direction[pixel], beams.across[pixel], beams.down[pixel]
            range_noise, light_noise = 0.0, 0.0
            for k in range(9):
                way, inverse = beams.direction[other[k]], 1.0 / measured.range_mm[other[k]]
                cosine = way[0] * own[0] + way[1] * own[1] + way[2] * own[2]
                x[k] = (way[0] * right[0] + way[1] * right[1] + way[2] * right[2]) / cosine / beams.pitch_across[pixel]
                y[k] = (way[0] * down[0] + way[1] * down[1] + way[2] * down[2]) / cosine / beams.pitch_down[pixel]
                value[k] = inverse / cosine
                variance = measured.range_variance[other[k]]
                range_noise += variance
                light_noise += measured.light_variance[other[k]] + 9.0 * variance * inverse * inverse
            fit_plane(x, y, value, even, 0.0, normal, coefficients, covariance, residual)
            by_right = coefficients[1] / beams.pitch_across[pixel]
            by_down = coefficients[2] / beams.pitch_down[pixel]
            for i in range(3):
                plane[pixel, i] = coefficients[0] * own[i] + by_right * right[i] + by_down * down[i]
            scatters[pixel, 0] = _mean_square(residual) * measured.range_mm[pixel] ** 4
            scatters[pixel, 1], scatters[pixel, 3] = range_noise / 9.0, light_noise / 9.0
            for k in range(9):
                value[k] = measured.log_light[other[k]]
            fit_plane(x, y, value, even, 0.0, normal, coefficients, covariance, residual)
            scatters[pixel, 2] = _mean_square(residual)
    return whole[:count]


@borrowing
def _mean_square(residual: FloatArray) -> float:
    """Mean square of the residuals of a plane through 3 x 3 pixels."""
    total = 0.0
    for k in range(len(residual)):
        total += residual[k] * residual[k]
    return total / _FREE


def plane_vector(image: PhasorImage, pixels: IntArray, coefficients: FloatArray) -> FloatArray:
    """Vectors m (n, 3) of planes 1 / r = m . d, from their coefficients (n, 3) in each pixel's local coordinates."""
    at, right, down = (coefficients[:, k, np.newaxis] for k in range(3))
    return np.asarray(
        at * image.directions[pixels]
        + right / image.pitch_across[pixels, np.newaxis] * image.across[pixels]
        + down / image.pitch_down[pixels, np.newaxis] * image.down[pixels]
    )


def _excess(scatter: FloatArray, noise: FloatArray, settings: SeedSettings) -> float:
    """Variance to be added to the noise of windows so that the scatter of the quieter ones follows chi-squared."""
    if len(scatter) < settings.least_windows:
        return 0.0
    return min(_excess_at(scatter, noise, part) for part in settings.quantiles)


def _excess_at(
    scatter: FloatArray,
    noise: FloatArray,
    part: float,
    *,
    halvings: int = 24,  # of the interval in which a scatter is looked for: to a ten millionth of it
) -> float:
    target = chi_square_6(1.0 - part) / _FREE
    enough = np.sort(scatter / target - noise)  # variance from which on a window's scatter is no more than the target

    def too_small(excess: float) -> bool:
        # The quantile lies between two of the sorted values; it is worked out where the target does so, too.
        below = int(np.searchsorted(enough, excess, side="right")) - int(part * (len(enough) - 1))
        if below != 1:
            return below < 1
        return bool(np.quantile(scatter / np.maximum(noise + excess, np.finfo(float).tiny), part) > target)

    if not too_small(0.0):
        return 0.0
    low, high = 0.0, float(np.quantile(scatter, part)) / target
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_small(middle) else (low, middle)
    return high


def _beyond_noise(scatters: list[tuple[FloatArray, FloatArray]], limit: float, settings: SeedSettings) -> float:
    """Variance beyond noise, from scatter and noise (n,) of windows: the first ones of 3 x 3 pixels, then lines.

    Among surfaces narrower than a window no window is of one surface, but the lines along them are. So the lines count
    if a window of one surface would not scatter as much as most windows do, by what the lines show.
    """
    (scatter, noise), *lines = scatters
    excess = _excess(scatter, noise, settings)
    level = float(np.median(noise)) if noise.size else 0.0
    along = min((_excess(*line, settings) for line in lines if len(line[0]) >= settings.least_windows), default=excess)
    return along if level + excess > limit * (level + along) else excess


def _line_scatters(image: PhasorImage, axis: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Scatter and noise (n,) of ranges (mm^2) and of light about straight lines, along eight pixels each."""
    index = np.arange(image.count).reshape(image.shape)
    index = index if axis == 1 else index.T
    line = 8  # pixels of a line that is as free as a window: a straight line through them leaves six degrees of freedom
    if index.shape[1] < line:
        return (np.zeros(0),) * 4
    pixels = np.lib.stride_tricks.sliding_window_view(index, line, axis=1).reshape(-1, line)
    pixels = pixels[image.valid[pixels].all(axis=1)]
    middle = pixels[:, line // 2]
    own, unit = image.directions[middle], (image.down if axis == 0 else image.across)[middle]
    ways, near = image.directions[pixels], 1.0 / image.range_mm[pixels]
    cosine = np.einsum("nki,ni->nk", ways, own)
    x = np.einsum("nki,ni->nk", ways, unit) / cosine
    noise = image.range_variance[pixels]
    light = image.light_variance[pixels] + 9.0 * noise * near**2
    return (
        _about_line(x, near / cosine) * image.range_mm[middle] ** 4,
        noise.mean(axis=1),
        _about_line(x, image.log_light[pixels]),
        light.mean(axis=1),
    )


def _about_line(x: FloatArray, values: FloatArray) -> FloatArray:
    """Mean square (n,) of the residuals of straight lines through values (n, place) at places x."""
    x, values = x - x.mean(axis=1, keepdims=True), values - values.mean(axis=1, keepdims=True)
    slope = (x * values).sum(axis=1) / (x * x).sum(axis=1)
    return np.asarray(((values - slope[:, np.newaxis] * x) ** 2).sum(axis=1) / _FREE)


def _in_square(mask: BoolArray, shape: tuple[int, int]) -> BoolArray:
    """Pixels of a mask (pixel,) that belong to a square of 2 x 2 pixels of the mask."""
    grid = mask.reshape(shape)
    square = grid[:-1, :-1] & grid[1:, :-1] & grid[:-1, 1:] & grid[1:, 1:]
    out = np.zeros(shape, bool)
    for i in (0, 1):
        for j in (0, 1):
            out[i : i + square.shape[0], j : j + square.shape[1]] |= square
    return out.ravel()
