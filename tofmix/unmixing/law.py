"""Which law holds at the edges: samples of one surface each, as in equation (1), or phasor sums.

A pixel's mean phasor is the same under both; the scatter of its samples along the chord is not. Samples of one surface
each jump between both ends: they scatter along the chord with w (1 - w) |z_A - z_B|^2 more than the noise that the two
surfaces have where they are seen alone. With the share q of phasor sums, a part 1 - q of that is left.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.unmixing.hypotheses import Kind
from tofmix.unmixing.image import PhasorImage, places, variance_along, window
from tofmix.unmixing.labels import Labels

LEAST_PHASOR_SHARE = 0.05
"""Share of phasor sums from which on layers are unmixed: below, the samples themselves show the surfaces."""

_LEAST_PROBABILITY = 0.9
"""Smallest posterior of pairs that measure q."""

_LEAST_SHARE = 0.15
"""Least share of a pair's lesser surface: w (1 - w) is known well there."""

_TELLING = 0.5
"""Largest standard error of q of a pixel that measures q."""

_REACH, _LEAST_ALONG = 3, 5
"""Reach of the window, pixels, in which the q of an edge is measured, and the fewest pixels in it."""

_DIFFERENT = 4.0
"""Standard errors by which an edge differs from the others of the image before its own law is taken."""

_LEAST_DIFFERING = 0.05
"""Part of the pixels that measure q, which the pixels at edges of another q must exceed. By their probability, one in
100 of the certain pairs may have a wrong surface. These lie together, at a corner, or next to a surface that no pixel
sees alone."""

_BY_CHANCE = 3.0
"""Standard errors above 0 from which on a share of phasor sums is no chance."""

_LEAST_ERROR = 0.02
"""Least standard error of a pixel's q: shares and chords are known no better."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """Which law holds.

    Parameters
    ----------
    phasor_share : float
        q, the share of the samples at edges that are phasor sums: of edges between surfaces, where there are some; NaN
        if no pixel determines it. pixels : int Pixels that determine it.
    is_sum : (pixel,) bool
        Whether the pixel's edge has phasor sums: a share of `LEAST_PHASOR_SHARE` and more, and more than by chance.
    """

    phasor_share: float
    pixels: int
    is_sum: BoolArray


def measure_law(image: PhasorImage, labels: Labels) -> Law:
    """Measure the share of phasor sums, of the image and of each edge.

    Edges between surfaces, and edges of a surface next to open space, are measured separately: a camera may sum at one
    kind and not at the other. Where an edge differs from the others of its kind, its own share is taken, if such edges
    have more pixels than wrong surfaces may have.
    """
    value, error = _of_pixels(image, labels)
    telling = error < _TELLING
    beside_open = np.isinf(labels.range_mm).any(axis=1)
    between = telling & ~beside_open
    main = between if between.any() else telling
    if not main.any():
        return Law(phasor_share=float("nan"), pixels=0, is_sum=np.zeros(image.count, bool))
    share, share_error = _median(value[main], error[main])
    at, at_error = np.full(image.count, share), np.full(image.count, share_error)
    if (telling & beside_open).any():
        at[beside_open], at_error[beside_open] = _median(value[telling & beside_open], error[telling & beside_open])
    widest = np.maximum(error, _error(image, labels, at))  # where surfaces are wrong, q may seem to be known well
    for edges in (~beside_open, beside_open):
        group = telling & edges
        pixels, own, own_error = _along_edges(image, group, np.asarray(edges, np.bool_), value, widest)
        differs = np.abs(own - at[pixels]) > _DIFFERENT * np.hypot(own_error, at_error[pixels])
        if group[pixels[differs]].sum() > _LEAST_DIFFERING * group.sum():
            at[pixels[differs]], at_error[pixels[differs]] = own[differs], own_error[differs]
    return Law(
        phasor_share=share, pixels=int(main.sum()), is_sum=(at > LEAST_PHASOR_SHARE) & (at > _BY_CHANCE * at_error)
    )


def _median(value: FloatArray, error: FloatArray) -> tuple[float, float]:
    """Median, and its standard error: that of a mean of Gaussian values, times sqrt(pi / 2)."""
    return float(np.median(value)), math.sqrt(0.5 * math.pi * float((error**2).mean()) / len(value))


def _of_pixels(image: PhasorImage, labels: Labels) -> tuple[FloatArray, FloatArray]:
    """Q of each pixel and its standard error (pixel,), infinite without information."""
    pair, parallel, noise, jump = _along_chords(image, labels)
    value = 1.0 - (1.0 - 1.0 / np.maximum(image.samples, 1.0)) * (parallel - noise) / jump
    return np.where(pair, value, 0.0), np.where(pair, _error_of(image, parallel, noise, jump), np.inf)


def _error(image: PhasorImage, labels: Labels, share: FloatArray) -> FloatArray:
    """Standard error (pixel,) of a pixel's q where the true one is `share` (pixel,)."""
    pair, _, noise, jump = _along_chords(image, labels)
    return np.where(pair, _error_of(image, noise + np.clip(1.0 - share, 0.0, 1.0) * jump, noise, jump), np.inf)


def _error_of(image: PhasorImage, parallel: FloatArray, noise: FloatArray, jump: FloatArray) -> FloatArray:
    free = np.maximum(image.samples - 1.0, 1.0)
    return np.asarray(np.hypot(np.sqrt(2.0 / free) * np.hypot(parallel, noise) / jump, _LEAST_ERROR))


def _along_chords(image: PhasorImage, labels: Labels) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Pixels whose pair of surfaces is sure, the variance along its chord, that of noise, and that of jumps."""
    share = labels.share[:, 0]
    pair = (labels.kind == Kind.PAIR) & labels.is_known & (labels.probability >= _LEAST_PROBABILITY)
    pair &= (np.abs(share - 0.5) <= 0.5 - _LEAST_SHARE) & np.isfinite(labels.scatter)
    length = np.where(pair, np.abs(labels.chord), 1.0)
    jump = np.where(pair, share * (1.0 - share), 1.0) * length**2
    return pair, variance_along(image.covariance, labels.chord / length), np.where(pair, labels.scatter, 0.0), jump


def _along_edges(
    image: PhasorImage, group: BoolArray, edges: BoolArray, value: FloatArray, error: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Pixels of `edges` with enough of a group around them, the median of q over these, and its standard error.

    A median, because some pixels have wrong surfaces: a pixel that sees only a narrow surface near a chord looks like a
    sum.
    """
    square = np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.int64)
    count = ndimage.convolve(group.reshape(image.shape).astype(np.int64), square, mode="constant").ravel()
    pixels = np.flatnonzero(edges & image.valid & (count >= _LEAST_ALONG))
    others, inside = places(pixels, image.shape, window(_REACH, middle=True))
    inside &= group[others]
    size = inside.sum(axis=1)
    ordered = np.sort(np.where(inside, value[others], np.inf), axis=1)
    middle = (np.take_along_axis(ordered, np.stack([(size - 1) // 2, size // 2], axis=1), axis=1)).mean(axis=1)
    square_sum = np.where(inside, error[others], 0.0) ** 2
    return pixels, middle, np.sqrt(0.5 * math.pi * square_sum.sum(axis=1)) / size
