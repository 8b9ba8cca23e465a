"""Slow and obvious twins of the kernels of reconcile, whole arrays at a time, in NumPy and SciPy.

`test_kernel.py` holds the kernels against them. Where kernels run as plain Python, where a search would take hours,
the searches in the tests use the twins (`conftest.py`).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tofmix.noise_shape import NoiseShape
from tofmix.reconciliation.likelihood.error_shape import ShapeTable
from tofmix.reconciliation.likelihood.kernel import Sorted
from tofmix.reconciliation.likelihood.smooth_kernel import LatentEvents

Array = NDArray[np.float64]
Any_ = NDArray[Any]

FLOOR, INVALID_FLOOR = 1e-12, 1e-6


def _cells(values: Array, step: float) -> tuple[Array, Array]:
    """Ranges that are stored as `values`: those of all multiples of the step that round to them."""
    if step <= 0:
        return values - 0.5, values + 0.5
    nearest = np.rint(values / step)
    lower, upper = np.full(values.shape, np.inf), np.full(values.shape, -np.inf)
    reach = int(np.ceil(0.5 / step)) + 1
    for k in range(-reach, reach + 1):
        place = (nearest + k) * step
        stored = np.rint(place) == values
        lower = np.where(stored, np.minimum(lower, place - step / 2), lower)
        upper = np.where(stored, np.maximum(upper, place + step / 2), upper)
    return lower, upper


def _between(lower: Array, upper: Array) -> Array:
    """Probability of a standard normal value between two, precise in both tails."""
    flip = lower > 0
    return np.asarray(ndtr(np.where(flip, -lower, upper)) - ndtr(np.where(flip, -upper, lower)))


def _normal_height(x: Array) -> Array:
    return np.asarray(np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi))


def _points(table: ShapeTable) -> Array:
    return np.asarray(table[0] + table[1] * np.arange(table[2].size), dtype=np.float64)


def _pdf_of(table: ShapeTable) -> Callable[[Array], Array]:
    """Density of a table, linear between its points."""
    return lambda x: np.asarray(np.interp(x, _points(table), table[2], left=0.0, right=0.0))


def _cdf_of(table: ShapeTable) -> Callable[[Array], Array]:
    """Chance below x: of a table, `NoiseShape`'s, which searches its points and knows no even steps."""
    if table[2].size == 0:
        return lambda x: np.asarray(ndtr(x))
    return NoiseShape(_points(table), table[2]).cdf


def log_likelihood(
    samples: NDArray[np.uint16],
    pixels: Any_,
    frames: Any_,
    events: LatentEvents,
    invalid: Array,
    random_density: Array,
    step: float,
    period: float,
    table: ShapeTable,
    by_pixel: Array,
    by_frame: Array,
) -> None:
    """Twin of `tofmix.reconciliation.likelihood.kernel.log_likelihood`."""
    key, since, frame_bias, extra_variance, pixel_bias, weight, mean, sigma, rate, lit = events
    value = samples[np.ix_(frames, pixels)].astype(np.float64)
    if value.size == 0:
        return
    some = np.ix_(key[frames], np.arange(weight.shape[1]), pixels)
    w, m, s, glows = weight[some], mean[some], sigma[some], lit[some]
    bias = (rate[some] * since[frames, None, None] + frame_bias[frames, None, None]) + pixel_bias[pixels]
    m = m + glows * bias
    s = np.sqrt(s**2 + glows * extra_variance[frames, None, None])
    lower, upper = _cells(value, step)
    there = lower < upper
    lower, upper = np.where(there, lower, 0.0)[:, None], np.where(there, upper, 0.0)[:, None]
    turn = glows * np.rint((m - 0.5 * (lower + upper)) / period) * period if period > 0 else 0.0
    w = np.where((period > 0) & glows & (lower >= period), 0.0, w)
    below, above = (lower + turn - m) / s, (upper + turn - m) / s
    gaussian = table[2].size == 0
    between = _between(below, above) if gaussian else _cdf_of(table)(above) - _cdf_of(table)(below)
    inside = np.where(w > 0, w, 0.0) * between
    total = inside.sum(axis=1) + random_density[pixels] * (upper - lower)[:, 0] + FLOOR
    precision = glows / (s**2 + (upper - lower) ** 2 / 12)
    height = _normal_height if gaussian else _pdf_of(table)
    pull = glows * np.where(w > 0, w, 0.0) * (height(below) - height(above)) / s
    slope = pull.sum(axis=1) / total
    information = table[4] * (inside * precision).sum(axis=1) / total
    valid = value > 0
    ruled = np.log(np.maximum(invalid[np.ix_(key[frames], pixels)], INVALID_FLOOR))
    terms = np.stack([np.where(valid, np.log(total), ruled), valid * slope, valid * information, valid], axis=-1)
    by_pixel[pixels] += terms.sum(axis=0)
    by_frame[frames] += terms.sum(axis=1)


def sorted_log_likelihood(samples: NDArray[np.uint16], pixels: Sorted, *rest: Any) -> None:  # noqa: ANN401  the kernel's own
    """The twin, as the kernel is called."""
    log_likelihood(samples, pixels.all, *rest)


def uniform(seed: int, frames: Any_, pixels: Any_) -> Array:
    """One deviate a sample, by its frame and pixel (SplitMix64)."""
    mask = (1 << 64) - 1
    of_frame = [int(t) * 0xBF58476D1CE4E5B9 for t in frames]
    of_pixel = [int(p) * 0x94D049BB133111EB for p in pixels]
    first = seed * 0x9E3779B97F4A7C15
    start = np.array([[(first + a + b) & mask for b in of_pixel] for a in of_frame], dtype=np.uint64)
    x = (start ^ (start >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return ((x >> np.uint64(11)).astype(np.float64) + 0.5) / 2.0**53


def transform(
    samples: NDArray[np.uint16],
    pixels: Any_,
    frames: Any_,
    events: LatentEvents,
    random_share: Array,
    low: float,
    high: float,
    step: float,
    period: float,
    table: ShapeTable,
    seed: int,
    out: NDArray[np.float32],
) -> None:
    """Twin of `tofmix.reconciliation.likelihood.kernel.transform`."""
    key, since, frame_bias, extra_variance, pixel_bias, weight, mean, sigma, rate, lit = events
    value = samples[np.ix_(frames, pixels)].astype(np.float64)
    if value.size == 0:
        return
    some = np.ix_(key[frames], np.arange(weight.shape[1]), pixels)
    w, m, s, glows = np.maximum(weight[some], 0.0), mean[some], sigma[some], lit[some]
    bias = (rate[some] * since[frames, None, None] + frame_bias[frames, None, None]) + pixel_bias[pixels]
    m = m + glows * bias
    s = np.sqrt(s**2 + glows * extra_variance[frames, None, None])

    chance, share = _cdf_of(table), random_share[pixels]

    def cdf(at: Array) -> Array:
        straight = chance((at[:, None] - m) / s)
        if period > 0:
            inside, turn = np.clip(at, 0.0, period)[:, None], np.floor(m / period)
            starts = [(turn + k) * period - m for k in (-1, 0, 1)]
            folded = sum(chance((inside + start) / s) - chance(start / s) for start in starts)
            straight = np.where(glows, folded, straight)
        return np.asarray((w * straight).sum(axis=1) + share * np.clip((at - low) / (high - low), 0.0, 1.0))

    lower, upper = _cells(value, step)
    told = (value > 0) & (lower < upper)
    lower, upper = np.where(told, lower, 0.0), np.where(told, upper, 0.0)
    u = uniform(seed, frames, pixels)
    drawn = (1 - u) * cdf(lower) + u * cdf(upper)
    if period > 0:  # counted from half a turn off the heaviest lit component
        heaviest = np.where(glows, w, 0.0).argmax(axis=1)[:, None]
        at = np.take_along_axis(mean[some], heaviest, axis=1)[:, 0] + 0.5 * period
        cut = np.where((glows & (w > 0)).any(axis=1), at - period * np.floor(at / period), 0.0)
        turned = drawn - cdf(cut) + np.where(value < cut, cdf(np.full_like(cut, period)), 0.0)
        drawn = np.where((cut > 0) & (value <= period), turned, drawn)
    x = drawn / np.maximum(share + w.sum(axis=1), FLOOR)
    out[np.ix_(frames, pixels)] = np.where(told, x, np.nan)
