"""Layers as an estimator would find them that knows the surface of each sample."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.layers import Layers


def counted_layers(
    share: FloatArray,
    range_mm: FloatArray,
    nothing: FloatArray,
    sigma_mm: Callable[[FloatArray], ArrayLike],
    *,
    samples: int,
    rng: np.random.Generator,
    most: int | None = None,
) -> Layers:
    """Counts and mean ranges, with their errors, of shares and ranges (surface, row, col); `nothing` is the rest."""
    chances = np.moveaxis(np.concatenate([share, nothing[np.newaxis]]), 0, -1)
    count = rng.multinomial(samples, chances / chances.sum(axis=-1, keepdims=True))
    ranges = np.where(count[..., :-1] > 0, np.moveaxis(range_mm, 0, -1), np.inf)
    order = np.argsort(ranges, axis=-1, kind="stable")[..., :most]
    number = np.take_along_axis(count[..., :-1], order, -1).astype(float)
    there = number > 0
    number[~there] = np.nan
    mean = np.where(there, np.take_along_axis(ranges, order, -1), np.nan)
    weight = number / samples
    out = Layers.empty(mean.shape[:2], mean.shape[2])
    out.n_modes[...] = out.n_peaks[...] = there.sum(axis=-1)
    out.sigma[...] = sigma_mm(mean)
    out.range_stderr[...] = sigma_mm(mean) / np.sqrt(number)
    out.range[...] = mean + rng.standard_normal(mean.shape) * out.range_stderr
    out.weight[...] = weight
    # As for one count in all frames where all are of one surface: a share is never known exactly.
    out.weight_stderr[...] = np.sqrt(np.maximum(weight * (1 - weight), 1 / samples) / samples)
    out.probability[...] = np.where(there, 1.0, np.nan)
    out.weight_no_return[...] = count[..., -1] / samples
    out.weight_outlier[...] = out.log_likelihood[...] = 0.0
    out.n_samples[...] = samples - count[..., -1]
    return out
