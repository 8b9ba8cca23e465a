"""Frames of two or more kinds: nearly all pixels read farther, or nearer, in the same frames of a window.

A camera that alternates exposure times or frequencies, or that is moved, displaces whole frames. Each pixel then has
another layer for each surface, which no surface makes. Pixels of several surfaces change from one to another
independently, so no frame differs from the others in nearly all of them. What passes in a part of the image changes
that part alone, and what all pixels see at times, such as a net before a wall, is not displaced alike in all of them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.layers import Layers

LEAST_SHARE = 0.8
"""Nearly every pixel: of those with a layer, this share shows the same. Few samples of a window may miss it."""


NOISE_SIGMAS = 3.0
"""Ranges of one surface differ by noise by so many standard deviations at most."""


class FrameKind(NamedTuple):
    """Frames of one kind.

    Parameters
    ----------
    displacement_mm : float
        How much farther than in the frames of the main kind nearly all pixels read; 0 for the main kind.
    frames : (n,) int64
        The frames, from the window's first.
    """

    displacement_mm: float
    frames: IntArray


def is_sampled(image: tuple[int, int], row: IntArray, col: IntArray, *, about: int = 256) -> BoolArray:
    """Which pixels of an image are among `about` so many, spread over it, that tell the kinds of frames."""
    step = int(np.ceil(np.sqrt(image[0] * image[1] / about)))
    first_row, first_col = (min(step, size) // 2 for size in image)
    return np.asarray((row % step == first_row) & (col % step == first_col))


def find_frame_kinds(
    layers: Layers, sampled: Float32Array, *, least_pixels: int, circle_mm: float | None = None
) -> tuple[FrameKind, ...]:
    """The kinds of frames of a window, the main one first; empty where all frames are of one kind.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    sampled : (n, 2 + frame) float32
        Row, column, and samples, mm, of the sampled pixels with more than one layer.
    least_pixels : int
        Fewest pixels that tell: fewer agree by chance.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    """
    place = tuple(sampled[:, :2].astype(int).T)
    seen = np.nonzero(layers.n_modes > 0)
    shown = int(is_sampled((layers.shape[0], layers.shape[1]), *seen).sum())
    least = max(LEAST_SHARE * shown, least_pixels)
    if len(sampled) < least:
        return ()
    samples = sampled[:, 2:].astype(np.float64)
    range_mm, sigma_mm = (values[place].astype(np.float64) for values in (layers.range, layers.sigma))
    used = np.flatnonzero(np.isfinite(samples).sum(axis=0) >= least_pixels)
    samples = samples[:, used]
    displacement = _frame_displacements(samples, circle_mm)
    nearest = _nearest(samples, range_mm, circle_mm)
    for count in range(layers.max_layers, 1, -1):
        label = _split(displacement, count)
        if label is None:
            continue
        kinds = [FrameKind(float(np.median(displacement[label == k])), used[label == k]) for k in range(count)]
        main = max(kinds, key=lambda kind: (len(kind.frames), -kind.frames[0]))
        kinds = [kind._replace(displacement_mm=kind.displacement_mm - main.displacement_mm) for kind in kinds]
        if _agreeing(range_mm, sigma_mm, nearest, label, kinds, circle_mm) >= least:
            return tuple(sorted(kinds, key=lambda kind: (kind.displacement_mm != 0.0, kind.displacement_mm)))
    return ()


def kinds_of_layers(
    range_mm: FloatArray,
    sigma_mm: FloatArray,
    weight: FloatArray,
    kinds: tuple[FrameKind, ...],
    *,
    circle_mm: float | None = None,
) -> IntArray:
    """Kind (row, col, layer) of the frames that show each layer: its place in `kinds`, -1 where it is not known.

    A layer of another than the main kind is displaced by that of the kind from a layer of the main kind, and their
    shares are as the numbers of frames: `NOISE_SIGMAS` of their standard errors are allowed.
    """
    out = np.full(range_mm.shape, -1)
    if not kinds:
        return out
    main = len(kinds[0].frames)
    for number, kind in enumerate(kinds[1:], start=1):
        expected = len(kind.frames) / (main + len(kind.frames))
        for layer in range(range_mm.shape[-1]):
            apart, noise = (
                range_mm[..., layer : layer + 1] - range_mm,
                np.hypot(sigma_mm[..., layer : layer + 1], sigma_mm),
            )
            off = _off_kind(apart, noise, kind, kinds, circle_mm)
            both = weight[..., layer : layer + 1] + weight
            with np.errstate(invalid="ignore", divide="ignore"):
                error = np.sqrt(expected * (1.0 - expected) / (both * (main + len(kind.frames))))
                fits = np.abs(weight[..., layer : layer + 1] / both - expected) <= NOISE_SIGMAS * error
                off = np.where(fits, off, np.inf)
            found = np.isfinite(off).any(axis=-1)
            row, col = np.nonzero(found)
            out[row, col, layer] = number
            of_main = off.argmin(axis=-1)[row, col]
            out[row, col, of_main] = np.maximum(out[row, col, of_main], 0)
    return out


def _off_kind(
    apart_mm: FloatArray, noise_mm: FloatArray, kind: FrameKind, kinds: Sequence[FrameKind], circle_mm: float | None
) -> FloatArray:
    """How far two layers are from being displaced as the frames of a kind, mm.

    Infinite where noise does not explain it, or another kind does better.
    """
    half_gap = 0.5 * min(abs(kind.displacement_mm - other.displacement_mm) for other in kinds if other is not kind)
    off = np.abs(_wrapped(apart_mm - kind.displacement_mm, circle_mm))
    with np.errstate(invalid="ignore"):
        return np.where(off <= np.minimum(half_gap, NOISE_SIGMAS * noise_mm), off, np.inf)


def _wrapped(away_mm: FloatArray, circle_mm: float | None) -> FloatArray:
    """Differences of ranges, the short way round on a circle."""
    return away_mm if circle_mm is None else away_mm - circle_mm * np.round(away_mm / circle_mm)


def _median(values: FloatArray, axis: int) -> FloatArray:
    """Median of the numbers along an axis; NaN where there is none."""
    ordered = np.sort(values, axis=axis)  # NaN last
    count = np.isfinite(values).sum(axis=axis, keepdims=True)
    low, high = (np.maximum(middle, 0) for middle in ((count - 1) // 2, count // 2))
    high = np.minimum(high, values.shape[axis] - 1)
    two = (np.take_along_axis(ordered, index, axis=axis) for index in (low, high))
    return np.asarray(np.squeeze(0.5 * sum(two), axis=axis))


def _frame_displacements(samples: FloatArray, circle_mm: float | None, *, most: int = 15) -> FloatArray:
    """How much farther each frame (frame,) of samples (pixel, frame) reads than the others, but for a constant.

    The median over pixels of the differences of two frames is that of their displacements, as a pixel of several
    surfaces changes to and fro as often. `most` frames are each compared with all others.
    """
    chosen = np.linspace(0, samples.shape[1] - 1, min(samples.shape[1], most)).astype(int)
    apart = np.array([_median(_wrapped(samples - samples[:, frame, None], circle_mm), axis=0) for frame in chosen])
    return _median(apart + apart[0, chosen, None], axis=0)


def _split(middle: FloatArray, count: int) -> IntArray | None:
    """Group of each frame (frame,), by range, from their median displacements; None where they are no `count` groups.

    Groups are parted at the largest gaps, each as wide as half the distance between their medians at least: frames that
    drift or jitter leave no such gap.
    """
    if len(middle) < count:
        return None
    order = np.argsort(middle, kind="stable")
    gaps = np.diff(middle[order])
    cuts = np.sort(np.argsort(-gaps, kind="stable")[: count - 1])
    groups = np.split(order, cuts + 1)
    apart = np.diff([np.median(middle[group]) for group in groups])
    if not (gaps[cuts] >= 0.5 * apart).all() or not (apart > 0.0).all():
        return None
    label = np.empty(len(middle), np.int64)
    for number, group in enumerate(groups):
        label[group] = number
    return label


def _nearest(samples: FloatArray, range_mm: FloatArray, circle_mm: float | None) -> IntArray:
    """The layer (pixel, frame) of a pixel's ranges (pixel, layer) that each sample is nearest to; -1 for no sample."""
    out, least = np.full(samples.shape, -1), np.full(samples.shape, np.inf)
    for layer in range(range_mm.shape[1]):
        away = np.abs(_wrapped(samples - range_mm[:, layer, None], circle_mm))
        nearer = away < least
        out[nearer], least[nearer] = layer, away[nearer]
    return out


def _agreeing(
    range_mm: FloatArray,
    sigma_mm: FloatArray,
    nearest: IntArray,
    label: IntArray,
    kinds: list[FrameKind],
    circle_mm: float | None,
) -> int:
    """Pixels whose layers are displaced as the kinds of frames are.

    Nearly all samples of a layer are of frames of one kind, and each kind has a layer that is displaced as it should be
    from one of the main kind.
    """
    layers = np.arange(range_mm.shape[1])
    shown = np.stack([(nearest[:, label == k, None] == layers).sum(axis=1) for k in range(len(kinds))], axis=-1)
    total = shown.sum(axis=-1)
    of_layer = np.where(shown.max(axis=-1) >= np.maximum(LEAST_SHARE * total, 1), shown.argmax(axis=-1), -1)
    agrees = np.where(of_layer >= 0, total, 0).sum(axis=1) >= np.maximum(LEAST_SHARE * total.sum(axis=1), 1)
    main = next(number for number, kind in enumerate(kinds) if kind.displacement_mm == 0.0)
    apart, noise = range_mm[:, :, None] - range_mm[:, None, :], np.hypot(sigma_mm[:, :, None], sigma_mm[:, None, :])
    for number, kind in enumerate(kinds):
        if number != main:
            both = (of_layer == number)[:, :, None] & (of_layer == main)[:, None, :]
            agrees &= (both & np.isfinite(_off_kind(apart, noise, kind, kinds, circle_mm))).any(axis=(1, 2))
    return int(agrees.sum())
