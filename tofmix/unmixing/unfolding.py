"""Ranges that fold: which surfaces lie beyond the fold, one turn farther than their folded ranges.

On a folded axis a surface beyond the fold is no plane: 1 / r is linear in the beam for the true range alone, and so is
ln A + 3 ln r a constant. Use `unfolded` before planes are fitted. Only the first and second turn are distinguished;
ranges in the farther half of a turn stay as they are.
"""

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.image.masks import components
from tofmix.unmixing.image import PhasorImage
from tofmix.unmixing.settings import DEFAULT_SETTINGS, UnfoldingSettings


def unfolded(
    image: PhasorImage, circle_mm: float, settings: UnfoldingSettings = DEFAULT_SETTINGS.unfolding
) -> FloatArray:
    """Ranges (pixel,), mm, with a turn more for the surfaces beyond the fold.

    Parameters
    ----------
    image : PhasorImage
        Of folded ranges.
    circle_mm : float
        Length of the circle that they are on, mm.
    settings : UnfoldingSettings
        Thresholds.
    """
    near = image.valid & (image.range_mm < 0.5 * circle_mm)
    one, other = _neighbours(image, 1)
    reach = settings.link_sigmas * np.sqrt(image.range_variance[one] + image.range_variance[other])
    reach = reach + settings.link_pitches * image.pitch[one] * (image.range_mm[one] + circle_mm)
    gap = image.range_mm[other] - image.range_mm[one]
    both = image.valid[one] & image.valid[other]
    linked = both & near[one] & near[other] & (np.abs(gap) < reach)
    number = components(one[linked], other[linked], image.count)
    size = np.bincount(number[near], minlength=int(number.max()) + 1)
    across = both & (near[one] != near[other]) & (np.abs(circle_mm - np.abs(gap)) < reach)
    at = np.where(near[one], one, other)[across]
    crossings = np.bincount(number[at], minlength=len(size))
    farther = crossings > settings.crossed * np.sqrt(np.maximum(size, 1.0))
    farther |= _is_smoother(image, number, near, circle_mm, settings)
    farther &= size >= settings.least_pixels
    return np.asarray(image.range_mm + circle_mm * (near & farther[number]))


def _neighbours(image: PhasorImage, step: int) -> tuple[IntArray, IntArray]:
    """Pixels (pair,) some steps to the left of others and above them, and these."""
    index = np.arange(image.count).reshape(image.shape)
    return (
        np.concatenate([index[:, :-step].ravel(), index[:-step].ravel()]),
        np.concatenate([index[:, step:].ravel(), index[step:].ravel()]),
    )


def _is_smoother(
    image: PhasorImage, number: IntArray, near: BoolArray, circle_mm: float, settings: UnfoldingSettings
) -> BoolArray:
    """Surfaces (number,) over which ln A + 3 ln r varies less with a turn more, in units of its errors."""
    over = [_is_smoother_over(image, number, near, circle_mm, stride, settings) for stride in settings.strides]
    return np.asarray(np.any(over, axis=0))


def _is_smoother_over(
    image: PhasorImage,
    number: IntArray,
    near: BoolArray,
    circle_mm: float,
    stride: int,
    settings: UnfoldingSettings,
) -> BoolArray:
    """Likewise, between pixels that are `stride` apart."""
    one, other = _neighbours(image, stride)
    same = near[one] & near[other] & (number[one] == number[other])
    one, other = one[same], other[same]
    noise = image.light_variance[one] + image.light_variance[other]
    step = np.log(image.amplitude[other]) - np.log(image.amplitude[one])
    count, total = int(number.max()) + 1, []
    for turn in (0.0, circle_mm):
        first, second = image.range_mm[one] + turn, image.range_mm[other] + turn
        error = noise + 9.0 * (image.range_variance[one] / first**2 + image.range_variance[other] / second**2)
        square = (step + 3.0 * np.log(second / first)) ** 2 / np.maximum(error, np.finfo(float).tiny)
        # The logarithm: a large misfit is an edge of reflectance, and tells nothing.
        total.append(np.bincount(number[one], np.log1p(square), minlength=count))
    pairs = np.bincount(number[one], minlength=count)
    better = (total[1] - total[0]) / np.maximum(pairs, 1) < np.log(settings.better)
    return np.asarray(better & (pairs >= settings.least_pixels))
