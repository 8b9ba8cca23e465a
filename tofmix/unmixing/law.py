"""Which law holds at the edges: samples of one surface each, as in equation (1), or phasor sums.

A pixel's mean phasor is the same under both; the scatter of its samples along the chord is not. Samples of one surface
each jump between both ends: they scatter along the chord with w (1 - w) |z_A - z_B|^2 more than the noise that the two
surfaces have where they are seen alone. With the share q of phasor sums, a part 1 - q of that is left.
"""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.masks import count_around
from tofmix.unmixing.image import PhasorImage, places, variance_along, window
from tofmix.unmixing.labels import Labels
from tofmix.unmixing.likeliest import Kind
from tofmix.unmixing.settings import LawSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixingLaw:
    """Which law holds.

    Parameters
    ----------
    phasor_share : float
        q, the share of the samples at edges that are phasor sums: of edges between surfaces, where there are some.
        Where no pixel determines it: 1 if sums are assumed, NaN if the samples contradict them or there are no edges.
    pixels : int
        Pixels that determine it.
    is_sum : (pixel,) bool
        Whether the pixel's edge has phasor sums: a share of `least_phasor_share` and more, and more than by chance.
    """

    phasor_share: float
    pixels: int
    is_sum: BoolArray


def measure_law(image: PhasorImage, labels: Labels, settings: LawSettings) -> MixingLaw:
    """Measure the share of phasor sums, of the image and of each edge.

    Edges between surfaces, and edges of a surface next to open space, are measured separately: a camera may sum at one
    kind and not at the other. Where an edge differs from the others of its kind, its own share is taken, if such edges
    have more pixels than wrong surfaces may have.
    """
    value, error = _of_pixels(image, labels, settings)
    informative = error < settings.most_error
    beside_open = np.isinf(labels.range_mm).any(axis=1)
    between = informative & ~beside_open
    main = between if between.any() else informative
    if not main.any():
        return _assumed(image, labels, settings)
    share, share_error = _median(value[main], error[main])
    at, at_error = np.full(image.count, share), np.full(image.count, share_error)
    at_open = informative & beside_open
    if at_open.any():
        at[beside_open], at_error[beside_open] = _median(value[at_open], error[at_open])
    # Where surfaces are wrong, q may seem to be known well.
    widest = np.maximum(error, _error(image, labels, at, settings))
    for edges in (~beside_open, beside_open):
        group = informative & edges
        wanted = np.asarray(edges, np.bool_)
        pixels, own, own_error = _along_edges(image, group, wanted, value, widest, settings)
        differs = np.abs(own - at[pixels]) > settings.different_sigmas * np.hypot(own_error, at_error[pixels])
        if group[pixels[differs]].sum() > settings.least_differing * group.sum():
            at[pixels[differs]], at_error[pixels[differs]] = own[differs], own_error[differs]
    is_sum = (at > settings.least_phasor_share) & (at > settings.chance_sigmas * at_error)
    return MixingLaw(phasor_share=share, pixels=int(main.sum()), is_sum=is_sum)


_SIDE = 3
"""Rows and columns of the least window of a plane."""


def _assumed(image: PhasorImage, labels: Labels, settings: LawSettings) -> MixingLaw:
    """The law where no edge tells it: sums, the physics of a lock-in camera, unless the samples contradict them.

    Samples of one surface each jump between the surfaces of a pixel, so they scatter more than the noise of pixels that
    see one surface. Those of a sum do not, whatever the surfaces are.
    """
    nothing = MixingLaw(phasor_share=float("nan"), pixels=0, is_sum=np.zeros(image.count, bool))
    edge = image.valid & ~labels.is_surface
    alone = image.valid & labels.is_surface
    if not edge.any() or min(image.shape) < _SIDE or alone.sum() <= edge.sum():
        return nothing  # an image too narrow for planes, or one of which little is understood
    x, y, both = image.covariance.T
    largest = 0.5 * (x + y) + np.sqrt(0.25 * (x - y) ** 2 + both**2)
    free = np.maximum(image.samples - 1.0, 1.0)
    chance = 1.0 + settings.different_sigmas * np.sqrt(2.0 / free)
    jumps = largest > chance * float(np.quantile(largest[alone], settings.noisiest))
    if jumps[edge].mean() > 0.5:  # noqa: PLR2004  most of them
        return nothing
    return MixingLaw(phasor_share=1.0, pixels=0, is_sum=np.ones(image.count, bool))


def _median(value: FloatArray, error: FloatArray) -> tuple[float, float]:
    """Median, and its standard error: that of a mean of Gaussian values, times sqrt(pi / 2)."""
    return float(np.median(value)), math.sqrt(0.5 * math.pi * float((error**2).mean()) / len(value))


def _of_pixels(image: PhasorImage, labels: Labels, settings: LawSettings) -> tuple[FloatArray, FloatArray]:
    """Q of each pixel and its standard error (pixel,), infinite without information."""
    pair, parallel, noise, jump = _along_chords(image, labels, settings)
    value = 1.0 - (1.0 - 1.0 / np.maximum(image.samples, 1.0)) * (parallel - noise) / jump
    error = _error_of(image, parallel, noise, jump, settings.least_error)
    return np.where(pair, value, 0.0), np.where(pair, error, np.inf)


def _error(image: PhasorImage, labels: Labels, share: FloatArray, settings: LawSettings) -> FloatArray:
    """Standard error (pixel,) of a pixel's q where the true one is `share` (pixel,)."""
    pair, _, noise, jump = _along_chords(image, labels, settings)
    parallel = noise + np.clip(1.0 - share, 0.0, 1.0) * jump
    return np.where(pair, _error_of(image, parallel, noise, jump, settings.least_error), np.inf)


def _error_of(
    image: PhasorImage, parallel: FloatArray, noise: FloatArray, jump: FloatArray, least: float
) -> FloatArray:
    free = np.maximum(image.samples - 1.0, 1.0)
    return np.asarray(np.hypot(np.sqrt(2.0 / free) * np.hypot(parallel, noise) / jump, least))


def _along_chords(
    image: PhasorImage, labels: Labels, settings: LawSettings
) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Pixels whose pair of surfaces is sure, the variance along its chord, that of noise, and that of jumps."""
    share = labels.share[:, 0]
    pair = (labels.kind == Kind.PAIR) & labels.is_known & (labels.probability >= settings.least_probability)
    pair &= (np.abs(share - 0.5) <= 0.5 - settings.least_share) & np.isfinite(labels.scatter)
    length = np.where(pair, np.abs(labels.chord), 1.0)
    jump = np.where(pair, share * (1.0 - share), 1.0) * length**2
    return pair, variance_along(image.covariance, labels.chord / length), np.where(pair, labels.scatter, 0.0), jump


def _along_edges(
    image: PhasorImage,
    group: BoolArray,
    edges: BoolArray,
    value: FloatArray,
    error: FloatArray,
    settings: LawSettings,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Pixels of `edges` with enough of a group around them, the median of q over these, and its standard error.

    A median, because some pixels have wrong surfaces: a pixel that sees only a narrow surface near a chord looks like a
    sum.
    """
    count = count_around(group.reshape(image.shape), settings.reach).ravel()
    pixels = np.flatnonzero(edges & image.valid & (count >= settings.least_along))
    others, inside = places(pixels, image.shape, window(settings.reach, middle=True))
    inside &= group[others]
    size = inside.sum(axis=1)
    ordered = np.sort(np.where(inside, value[others], np.inf), axis=1)
    middle = (np.take_along_axis(ordered, np.stack([(size - 1) // 2, size // 2], axis=1), axis=1)).mean(axis=1)
    square_sum = np.where(inside, error[others], 0.0) ** 2
    return pixels, middle, np.sqrt(0.5 * math.pi * square_sum.sum(axis=1)) / size
