"""The surfaces beside a pixel, continued to it.

Each one-surface pixel nearby predicts 1 / r at the pixel in question by its own plane. Predictions that agree are of
one surface; a plane is then fitted to all its pixels in a window of 9 x 9, the pixel in question left out. No surface
needs to be followed over the image: creases, doors that stand ajar and curved things need no rule of their own.
"""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.unmixing.image import ComplexArray, PhasorImage, dot, local_coordinates, places, window
from tofmix.unmixing.plane_fit import fit_planes
from tofmix.unmixing.seeds import Seeds, plane_coefficients

MOST_SURFACES = 4
"""Surfaces that are looked at beside a pixel, the largest first."""

_REACH, _NEAR = 4, 3
"""Reach of the window, pixels, and distance within which a surface must have a pixel."""

_APART_SIGMAS, _APART = 4.0, 0.01
"""Standard errors, and part of 1 / r, that lie between the predictions of two surfaces."""

_OUTLIER = 16.0
"""Square of a residual over its variance, of a pixel that belongs to another surface after all."""

_FREE_SLOPE, _KNOWN_SLOPE = 2.0, 0.25
"""Standard deviation of a slope, in units of pitch / r, before it is measured: 2 is a surface seen at 27 degrees from
grazing; where pixels bring planes of their own, these are right to a few degrees."""

_LIGHT_SLOPE, _LIGHT_SLOPE_LEAST = 2.0, 0.005
"""Standard deviation of a slope of u, a pixel: 2 pitches, as the light of a lamp falls towards the image's corners, and
half a percent."""

_LIGHT_REACH = 2.0
"""Standard deviation, pixels, of the weights that u is fitted with: light varies where ranges do not."""


@dataclass(slots=True, kw_only=True, eq=False)
class Members:
    """One-surface pixels, as far as they are known. Arrays are (pixel,).

    Parameters
    ----------
    is_member : bool
        Whether the pixel is one.
    has_plane : bool
        Whether it predicts by a plane of its own; else by its own range, as a surface that is seen head-on.
    has_light : bool
        Whether its amplitude is that of the surface: beside open space a part of it has the range, and less light.
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
    """

    is_member: BoolArray
    has_plane: BoolArray
    has_light: BoolArray
    is_known: BoolArray
    is_trusted: BoolArray
    is_fresh: BoolArray
    plane: FloatArray
    middle: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NeighbourSurfaces:
    """Surfaces beside pixels (n,), at most `MOST_SURFACES` each. Arrays are (n, surface) unless said otherwise.

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
    noise_radial: FloatArray
    noise_tangential: FloatArray
    scatter_radial: FloatArray
    scatter_tangential: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Predictions:
    """What surfaces would return if they filled a pixel, or part of it. Arrays are (n,), one for each pixel.

    Parameters
    ----------
    phasor : complex128
        z.
    tangential, radial : float64
        Its variances across and along its direction, of the fit, the fixed pattern and the texture.
    range_mm, range_variance : float64
        Range, mm, and its variance, mm^2.
    """

    phasor: ComplexArray
    tangential: FloatArray
    radial: FloatArray
    range_mm: FloatArray
    range_variance: FloatArray


def phasor_of(
    near: FloatArray, near_variance: FloatArray, light: FloatArray, light_variance: FloatArray, *,
    image: PhasorImage, seeds: Seeds,
) -> Predictions:  # fmt: skip
    """Phasors (n,) of surfaces, from 1 / r (1 / mm), u, and their variances."""
    range_mm = 1.0 / np.maximum(near, _LEAST_NEAR)
    range_variance = near_variance * range_mm**4 + seeds.pattern_variance
    amplitude = np.exp(np.minimum(light - 3.0 * np.log(range_mm), _MOST_LOG))
    radial = light_variance + seeds.texture_variance + 9.0 * range_variance / range_mm**2
    return Predictions(
        phasor=amplitude * np.exp(1j * range_mm / image.scale_mm),
        tangential=amplitude**2 * range_variance / image.scale_mm**2, radial=amplitude**2 * radial,
        range_mm=range_mm, range_variance=range_variance,
    )  # fmt: skip


_LEAST_NEAR = 1.0e-7
"""1 / mm: no surface is farther than 10 km."""

_MOST_LOG = 10.0
"""Logarithm of the largest amplitude, in units of the image's median: an extrapolation must not overflow."""


def predict(
    surfaces: NeighbourSurfaces, number: int, rows: FloatArray, cols: FloatArray, *, image: PhasorImage, seeds: Seeds
) -> Predictions:
    """What the surfaces of a number would return from places (n,) that lie `rows` and `cols` beside the pixels."""
    at = np.stack([np.ones_like(rows), cols, rows], axis=-1)

    def value(coefficients: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        mean = (coefficients[:, number] * at).sum(axis=-1)
        return mean, np.einsum("ni,nik,nk->n", at, covariance[:, number], at)

    near, near_variance = value(surfaces.near, surfaces.near_covariance)
    light, light_variance = value(surfaces.light, surfaces.light_covariance)
    return phasor_of(near, near_variance, light, light_variance, image=image, seeds=seeds)


def find_neighbours(image: PhasorImage, pixels: IntArray, members: Members, seeds: Seeds) -> NeighbourSurfaces:
    """Find the surfaces beside pixels (n,)."""
    around = window(_REACH)
    others, inside = places(pixels, image.shape, around)
    inside &= members.is_member[others]
    coordinates = local_coordinates(image, pixels, others)
    near = 1.0 / image.range_mm[others]
    variance = (image.range_variance[others] + seeds.pattern_variance) * near**4
    group = _groups(image, pixels, others, inside, near / coordinates[0], variance, members)
    chosen, found = _largest(group, inside & (around.ring <= _NEAR))
    empty = (len(pixels), MOST_SURFACES)
    out = NeighbourSurfaces(
        found=found, near=np.zeros((*empty, 3)), near_covariance=np.zeros((*empty, 3, 3)), light=np.zeros((*empty, 3)),
        light_covariance=np.zeros((*empty, 3, 3)), is_known=np.zeros(empty, bool),
        is_trusted=np.zeros(empty, bool), is_fresh=np.zeros(empty, bool), row=np.zeros(empty),
        col=np.zeros(empty), noise_radial=np.zeros(empty), noise_tangential=np.zeros(empty),
        scatter_radial=np.zeros(empty), scatter_tangential=np.zeros(empty),
    )  # fmt: skip
    for number in range(MOST_SURFACES):
        some = np.flatnonzero(found[:, number])
        if some.size:
            mask = group[some] == chosen[some, number, np.newaxis]
            parts = tuple(part[some] for part in (*coordinates, near, variance))
            _fit_surface(out, number, some, mask, others[some], parts, image, pixels[some], members, seeds)
    return out


def _groups(
    image: PhasorImage, pixels: IntArray, others: IntArray, inside: BoolArray, head_on: FloatArray,
    variance: FloatArray, members: Members,
) -> IntArray:  # fmt: skip
    """Number (n, place) of the surface that each place belongs to, from far to near; -1 where there is no member.

    Predictions are put in order; where the step to the next is larger than their errors, a new surface begins.
    """
    around = window(_REACH)
    has_plane = members.has_plane[others]
    by_plane = dot(members.plane, others, image.directions[pixels])
    row, col = np.divmod(members.middle[others], image.shape[1])
    own_row, own_col = np.divmod(pixels, image.shape[1])
    away = (row - own_row[:, np.newaxis]) ** 2 + (col - own_col[:, np.newaxis]) ** 2
    # A plane through 3 x 3 points has the variance 1 / 9 in its middle, and a slope the variance 1 / 6.
    error = variance * (1.0 / 9.0 + away / 6.0)
    slope = (_FREE_SLOPE * image.pitch[pixels])[:, np.newaxis] / image.range_mm[others]
    value = np.where(has_plane, by_plane, head_on)
    error = np.where(has_plane, error, variance + around.distance_squared * slope**2)
    value = np.where(inside, value, np.inf)
    order = np.argsort(value, axis=1, kind="stable")
    value, error, member = (np.take_along_axis(part, order, axis=1) for part in (value, error, inside))
    with np.errstate(invalid="ignore"):  # inf - inf, past the last member
        step = value[:, 1:] - value[:, :-1]
        apart = _APART_SIGMAS * np.sqrt(2.0 * np.minimum(error[:, 1:], error[:, :-1]))
        begins = (step > np.maximum(apart, _APART * np.abs(value[:, :-1]))) & member[:, 1:]
    number = np.concatenate([np.zeros((len(pixels), 1), np.int64), np.cumsum(begins, axis=1)], axis=1)
    out = np.empty_like(number)
    np.put_along_axis(out, order, number, axis=1)
    return np.where(inside, out, -1)


def _largest(group: IntArray, near: BoolArray) -> tuple[IntArray, BoolArray]:
    """Numbers (n, surface) of the groups with most pixels nearby, and whether there is one."""
    count = int(group.max(initial=-1)) + 1
    size = np.stack([(group == k).sum(axis=1) for k in range(count)] or [np.zeros(len(group), int)], axis=1)
    close = np.stack([((group == k) & near).sum(axis=1) for k in range(count)] or [size[:, 0]], axis=1)
    # More pixels nearby come first, then more pixels.
    rank = np.where((close > 0) & (size > 1), close * group.shape[1] + size, 0)
    order = np.argsort(-rank, axis=1, kind="stable")[:, :MOST_SURFACES]
    found = np.take_along_axis(rank, order, axis=1) > 0
    short = ((0, 0), (0, MOST_SURFACES - order.shape[1]))
    return np.pad(order, short), np.pad(found, short)


def _fit_surface(
    out: NeighbourSurfaces, number: int, some: IntArray, mask: BoolArray, others: IntArray,
    parts: tuple[FloatArray, ...], image: PhasorImage, pixels: IntArray, members: Members, seeds: Seeds,
) -> None:  # fmt: skip
    """Fit the surface of a number beside `pixels` to its places `mask` (n, place), into the rows `some` of `out`."""
    cosine, x, y, near, variance = parts
    size = mask.sum(axis=1)
    known = mask & members.has_plane[others]
    with_plane = known.sum(axis=1)
    level = (np.where(mask, near, 0.0).sum(axis=1) / size)[:, np.newaxis]
    plane = np.stack([np.where(known, members.plane[:, axis][others], 0.0).sum(axis=1) for axis in range(3)], axis=-1)
    plane = np.where(
        with_plane[:, np.newaxis] > 0, plane / np.maximum(with_plane, 1)[:, np.newaxis],
        level * image.directions[pixels],
    )  # fmt: skip
    expected = dot(image.directions, others, plane)
    slope = np.where(with_plane > 0, _KNOWN_SLOPE, _FREE_SLOPE) * image.pitch[pixels] * level[:, 0]
    weights = np.where(mask, 1.0 / np.where(mask, variance, 1.0), 0.0)
    values, slope_weight = (near - expected) / cosine, 1.0 / slope**2
    first = fit_planes(x, y, values, weights, slope_weight)
    fewer = np.where(first.residuals**2 * weights > _OUTLIER, 0.0, weights)
    enough = 2 * (fewer > 0).sum(axis=1) >= size
    weights = np.where(enough[:, np.newaxis], fewer, weights)
    fits = fit_planes(x, y, values, weights, slope_weight)
    out.near[some, number] = fits.coefficients + plane_coefficients(image, pixels, plane)
    out.near_covariance[some, number] = fits.covariance * _inflation(fits.residuals, weights)
    out.near_covariance[some, number, 0, 0] += _bent(fits.residuals, weights, variance)
    noise = image.light_variance[others] + 9.0 * image.range_variance[others] * near**2 + seeds.texture_variance
    fade = np.exp(-window(_REACH).distance_squared / (2.0 * _LIGHT_REACH**2))
    used = weights > 0
    lit = used & members.has_light[others]
    used = np.where(lit.any(axis=1, keepdims=True), lit, used)
    weights = np.where(used, fade / np.where(used, noise, 1.0), 0.0)
    light = image.log_light[others]
    level = (light * weights).sum(axis=1) / weights.sum(axis=1)
    slope = _LIGHT_SLOPE * image.pitch[pixels] + _LIGHT_SLOPE_LEAST
    fits = fit_planes(x, y, np.where(weights > 0, light - level[:, np.newaxis], 0.0), weights, 1.0 / slope**2)
    fits.coefficients[:, 0] += level
    out.light[some, number] = fits.coefficients
    out.light_covariance[some, number] = fits.covariance * _inflation(fits.residuals, weights)
    out.light_covariance[some, number, 0, 0] += _bent(fits.residuals, weights, noise)
    for name in ("is_known", "is_trusted", "is_fresh"):
        getattr(out, name)[some, number] = 2 * (mask & getattr(members, name)[others]).sum(axis=1) >= size

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.where(mask, values, 0.0).sum(axis=1) / size)

    around = window(_REACH)
    out.row[some, number] = mean(np.broadcast_to(around.row, mask.shape))
    out.col[some, number] = mean(np.broadcast_to(around.col, mask.shape))
    for name in ("noise_radial", "noise_tangential", "scatter_radial", "scatter_tangential"):
        getattr(out, name)[some, number] = mean(getattr(image, name)[others])


def _inflation(residuals: FloatArray, weights: FloatArray) -> FloatArray:
    """Factor (n, 1, 1) on a fit's covariance: how much more than expected its residuals scatter, at least 1."""
    free = np.maximum((weights > 0).sum(axis=1) - 3, 1)
    excess = (residuals**2 * weights).sum(axis=1) / free
    return np.asarray(np.maximum(1.0, excess)[:, np.newaxis, np.newaxis])


def _bent(residuals: FloatArray, weights: FloatArray, variance: FloatArray) -> FloatArray:
    """Variance (n,) of what a surface is, beside its plane: of a crease, or of one that is curved.

    It is what residuals scatter beyond noise and more than by chance. More pixels do not lessen it.
    """
    chances = weights * np.where(weights > 0, variance, 0.0)  # 1, or less where a pixel counts less
    total = np.maximum(chances.sum(axis=1), _TINY)
    free = np.maximum(total**2 / np.maximum((chances**2).sum(axis=1), _TINY) - 3.0, 1.0)
    excess = (residuals**2 * weights).sum(axis=1) / total - 1.0 - _CHANCE * np.sqrt(2.0 / free)
    level = (chances * np.where(weights > 0, variance, 0.0)).sum(axis=1) / total
    return np.asarray(np.maximum(excess, 0.0) * level)


_CHANCE = 2.0
"""Standard deviations of a mean square of residuals that are chance."""

_TINY = 1.0e-30
"""Least divisor."""
