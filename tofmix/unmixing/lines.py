"""Narrow surfaces: pixels that see one surface, of surfaces that only one or two columns or rows of pixels see alone.

No window of 3 x 3 pixels lies on a narrow surface, such as a slat two to three pixels wide. A surface is connected:
along a row, and along a column, its pixels follow each other. So a pixel whose neighbours on both sides see some of its
surface is filled by the surface, between these two. A neighbour sees some of it if it agrees with the pixel, or if it
is a mixture of the pixel's surface with the one beyond the neighbour: its phasor lies on the chord between both.

Pixels for which this holds along the row and along the column see one surface. Connected ones that agree are a surface,
of which a line of pixels is enough: the line determines the slope along itself, and across it the slope has its prior
(`tofmix.unmixing.surface_fit`). Use `find_lines` after `find_seeds`, which finds wider surfaces.
"""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.segments import components, near, neighbour_pairs
from tofmix.unmixing.image import TINY, ComplexArray, PhasorImage, inverse_form, polar_covariance
from tofmix.unmixing.seeds import Seeds
from tofmix.unmixing.settings import DEFAULT_SETTINGS, LabelSettings

_BEYOND = (2, 3)
"""Distances, pixels, of the surface beyond a neighbour. An edge that is not upright in the image crosses two pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mixtures:
    """The surfaces of the pixels that are judged to see several. Arrays are (pixel, end), as in `Findings`.

    Parameters
    ----------
    is_mixed : (pixel,) bool
        Whether the pixel sees several.
    range_mm, range_variance, share, share_variance : float64
        Its surfaces.
    """

    is_mixed: BoolArray
    range_mm: FloatArray
    range_variance: FloatArray
    share: FloatArray
    share_variance: FloatArray


def find_lines(
    image: PhasorImage,
    seeds: Seeds,
    mixtures: Mixtures | None = None,
    settings: LabelSettings = DEFAULT_SETTINGS.labels,
    reach: int = DEFAULT_SETTINGS.neighbours.reach,
) -> IntArray:
    """Find narrow surfaces.

    Parameters
    ----------
    image : PhasorImage
        The window.
    seeds : Seeds
        Pixels of wider surfaces, and the scatter beyond noise.
    mixtures : Mixtures, optional
        What pixels were judged to see by then: they see some of the surfaces in them.
    settings : LabelSettings
        Which neighbours agree.
    reach : int
        Distance, pixels, to which the planes of wider surfaces are continued.

    Returns
    -------
    (pixel,) int64
        Number of the pixel's narrow surface, that of its first pixel; -1 where it has none.
    """
    number = np.full(image.count, -1)
    is_doubtful = image.valid & ~seeds.has_plane
    pixels = np.flatnonzero(is_doubtful if mixtures is None else is_doubtful & ~mixtures.is_mixed)
    for axis in (0, 1):
        pixels = pixels[_is_between(image, seeds, mixtures, pixels, axis, settings)]
    if not pixels.size:
        return number
    is_line = np.zeros(image.count, bool)
    is_line[pixels] = True
    one, other = neighbour_pairs(image.shape)
    agreeing = agree(image, seeds, one, other, settings)
    linked = agreeing & is_line[one] & is_line[other]
    surface = components(one[linked], other[linked], image.count)
    size = np.bincount(surface, minlength=image.count)
    # Where the planes of a wider surface reach, its pixels are continued by these.
    beside = agreeing & ((is_line[one] & seeds.has_plane[other]) | (is_line[other] & seeds.has_plane[one]))
    wider = np.zeros(image.count, bool)
    wider[surface[np.where(is_line[one], one, other)[beside]]] = True
    known = wider[surface] & near(seeds.has_plane.reshape(image.shape), reach).ravel()
    least_pixels = 3  # pixels of a line: two of them determine it, and the third one tests it
    pixels = pixels[(size[surface[pixels]] >= least_pixels) & ~known[pixels]]
    number[pixels] = np.unique(surface, return_index=True)[1][surface[pixels]]
    return number


def is_bounded(
    image: PhasorImage,
    seeds: Seeds,
    mixtures: Mixtures,
    mask: BoolArray,
    settings: LabelSettings = DEFAULT_SETTINGS.labels,
) -> BoolArray:
    """Which pixels of a mask (pixel,) see one surface by what is beside them: they are filled, or agree with such.

    Along the row and along the column. Two columns that agree, beside pixels that see nothing of them, are as well two
    halves of a narrower thing on the border of both, with another surface behind it.
    """
    bounded = mask.copy()
    index = np.arange(image.count).reshape(image.shape)
    pixels = np.flatnonzero(near(mask.reshape(image.shape), 1).ravel() & image.valid)
    for axis in (0, 1):
        is_filled = np.zeros(image.count, bool)
        is_filled[pixels] = _is_between(image, seeds, mixtures, pixels, axis, settings)
        along = np.moveaxis(index, axis, 0)
        one, other = along[:-1].ravel(), along[1:].ravel()
        agreeing = agree(image, seeds, one, other, settings)
        beside = is_filled.copy()
        beside[one] |= agreeing & is_filled[other]
        beside[other] |= agreeing & is_filled[one]
        bounded &= beside
    return bounded


def agree(
    image: PhasorImage, seeds: Seeds, one: IntArray, other: IntArray, settings: LabelSettings = DEFAULT_SETTINGS.labels
) -> BoolArray:
    """Whether pixels (n,) and their neighbours may see the same surface: ranges and light differ by its slope."""
    step = (settings.slope * image.pitch[one] * image.range_mm[one]) ** 2
    error = image.range_variance[one] + image.range_variance[other] + 2.0 * seeds.pattern_variance + step
    light = image.light_variance[one] + image.light_variance[other] + 2.0 * seeds.texture_variance
    light = (
        light
        + (settings.light_slope * image.pitch[one] + settings.light_step) ** 2
        + 9.0 * error / image.range_mm[one] ** 2
    )
    ranges = (image.range_mm[one] - image.range_mm[other]) ** 2
    lights = (image.log_light[one] - image.log_light[other]) ** 2
    most = settings.agree_sigmas**2
    return np.asarray((ranges < most * error) & (lights < most * light))


def _is_between(
    image: PhasorImage, seeds: Seeds, mixtures: Mixtures | None, pixels: IntArray, axis: int, settings: LabelSettings
) -> BoolArray:
    """Whether both neighbours of pixels (n,) along an axis see some of the pixel's surface.

    If both are mixtures, the pixel itself must not be one of the two surfaces beyond, as on a blurred edge. At the
    image's border the one neighbour agrees with the pixel, and the next one sees some of it: else both may be halves of
    a narrower thing.
    """
    sees, agrees, exists, beyond = zip(
        *(_see_some(image, seeds, mixtures, pixels, axis, side, settings) for side in (-1, 1)), strict=True
    )
    both = sees[0] & sees[1]
    stride = image.shape[1] if axis == 0 else 1
    for side, outer, opposite in ((-1, 0, 1), (1, 1, 0)):
        last = np.flatnonzero(~exists[outer] & agrees[opposite])
        beside = pixels[last] - side * stride
        both[last] = _see_some(image, seeds, mixtures, beside, axis, -side, settings)[0]
    chord = np.flatnonzero(both & (beyond[0] >= 0) & (beyond[1] >= 0))
    share, error, fits = _on_chord(image, seeds, pixels[chord], beyond[0][chord], beyond[1][chord], settings)
    inner = settings.agree_sigmas * error
    both[chord] &= ~(fits & (share > inner) & (share < 1.0 - inner))
    return np.asarray(both)


def _see_some(
    image: PhasorImage,
    seeds: Seeds,
    mixtures: Mixtures | None,
    pixels: IntArray,
    axis: int,
    side: int,
    settings: LabelSettings,
) -> tuple[BoolArray, BoolArray, BoolArray, IntArray]:
    """Whether the neighbours of pixels (n,) on a side see some of the pixel's surface, and agree with it; and exist.

    The last array is the pixel of the surface beyond, where the neighbour is a mixture with it; else -1.
    """
    place = np.divmod(pixels, image.shape[1])[axis]
    stride = side * (image.shape[1] if axis == 0 else 1)

    def at(steps: int) -> tuple[IntArray, BoolArray]:
        inside = (place + side * steps >= 0) & (place + side * steps < image.shape[axis])
        return np.where(inside, pixels + stride * steps, pixels), np.asarray(inside)

    beside, exists = at(1)
    agrees = exists & image.valid[beside] & agree(image, seeds, pixels, beside, settings)
    sees, beyond = agrees.copy(), np.full(len(pixels), -1)
    if mixtures is not None:
        sees |= exists & _has_end(image, seeds, mixtures, beside, pixels, settings)
    for steps in _BEYOND:
        far, inside = at(steps)
        which = np.flatnonzero(~sees & inside & image.valid[beside] & (image.valid[far] | image.open_space[far]))
        share, error, fits = _on_chord(image, seeds, beside[which], pixels[which], far[which], settings)
        inner = settings.agree_sigmas * error
        mixed = which[fits & (share > inner) & (share < 1.0 + inner)]
        sees[mixed], beyond[mixed] = True, far[mixed]
    return sees, agrees, exists, beyond


def _has_end(
    image: PhasorImage, seeds: Seeds, mixtures: Mixtures, pixels: IntArray, others: IntArray, settings: LabelSettings
) -> BoolArray:
    """Whether pixels (n,) were judged to see some of the surfaces that others fill."""
    step = (settings.slope * image.pitch[others] * image.range_mm[others]) ** 2
    error = image.range_variance[others] + seeds.pattern_variance + step
    off = mixtures.range_mm[pixels] - image.range_mm[others, np.newaxis]
    most = settings.agree_sigmas**2
    is_same = off**2 < most * (mixtures.range_variance[pixels] + error[:, np.newaxis])
    is_some = mixtures.share[pixels] ** 2 > most * mixtures.share_variance[pixels]
    return np.asarray(mixtures.is_mixed[pixels] & (is_same & is_some).any(axis=1))


def _on_chord(
    image: PhasorImage, seeds: Seeds, pixels: IntArray, one: IntArray, other: IntArray, settings: LabelSettings
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Share (n,) of the surface of `one` in pixels, beside that of `other`; its error; and whether the chord fits.

    z - z_other = w (z_one - z_other), by generalised least squares. The surfaces' phasors are taken a pixel away from
    where they are seen, and have the errors of a slope.
    """
    (first, first_error), (second, second_error) = (
        _end(image, seeds, one, settings),
        _end(image, seeds, other, settings),
    )
    chord, offset = first - second, image.phasor[pixels] - second
    square = np.maximum(np.abs(chord) ** 2, TINY)
    share = (offset * np.conj(chord)).real / square
    part = np.clip(share, 0.0, 1.0)[:, np.newaxis]
    covariance = image.mean_covariance[pixels] + part**2 * first_error + (1.0 - part) ** 2 * second_error
    variance = 1.0 / np.maximum(inverse_form(covariance, chord, chord), TINY)
    share = inverse_form(covariance, chord, offset) * variance
    across = offset - share * chord
    return share, np.sqrt(variance), inverse_form(covariance, across, across) < settings.agree_sigmas**2


def _end(
    image: PhasorImage, seeds: Seeds, pixels: IntArray, settings: LabelSettings
) -> tuple[ComplexArray, FloatArray]:
    """Phasors (n,) of the surfaces that pixels see, and their covariance (n, 3) one pixel away."""
    pitch, range_mm, square = image.pitch[pixels], image.range_mm[pixels], image.amplitude[pixels] ** 2
    ranges = seeds.pattern_variance + (settings.slope * pitch * range_mm) ** 2
    light = seeds.texture_variance + (settings.light_slope * pitch + settings.light_step) ** 2
    tangential, radial = square * ranges / image.scale_mm**2, square * (light + 9.0 * ranges / range_mm**2)
    own = polar_covariance(image.phasor[pixels], tangential, radial) + image.mean_covariance[pixels]
    nothing = image.open_space[pixels]
    return np.where(nothing, 0.0, image.phasor[pixels]), np.where(nothing[:, np.newaxis], 0.0, own)
