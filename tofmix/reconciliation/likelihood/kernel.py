"""Compiled loops over samples: the log-likelihood of a mixture over the latent event, and its normal scores.

A sample is invalid, a random value, or of one component (a surface, or no return) with a normal
distribution, or with one of the shape that a table says. Means may run with time, and every lit
component takes a bias by frame and by pixel. Arrays are documented in
`tofmix.reconciliation.likelihood.mixture`; use them through `tofmix.reconciliation.likelihood.likelihood`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.reconciliation.likelihood.error_shape import ShapeTable
from tofmix.reconciliation.likelihood.smooth_kernel import LatentEvents, smooth_log_likelihood

_FLOOR = 1.0e-12  # probability of what the model rules out: one impossible sample must not decide alone
_INVALID_FLOOR = 1.0e-6  # probability that any sample is lost, whatever the model says
_ROOT2 = math.sqrt(2.0)
_PER_ROOT_TWO_PI = 1.0 / math.sqrt(2.0 * math.pi)
_FAR = 40.0  # exp(-40) adds nothing
_NEARER_MM = 1.0e5  # of ranges that are stored as 1 mm
_FINE = 0.7  # a cell narrower than this many sigma: its probability is density times width (Sheppard's correction)


@jit
def _phi(x: float) -> float:
    return 0.5 * math.erfc(-x / _ROOT2)


@borrowing
def _below(x: float, table: ShapeTable) -> float:
    """Chance that an error of the table's shape is below x sigma."""
    first, step, density, below, _ = table
    place = (x - first) / step
    if place <= 0.0:
        return 0.0
    if place >= density.size - 1:
        return 1.0
    i = int(place)
    past = place - i
    return float(below[i] + step * past * (density[i] + 0.5 * past * (density[i + 1] - density[i])))


@borrowing
def _height(x: float, table: ShapeTable) -> float:
    """Density at x of the table's shape."""
    first, step, density, _, _ = table
    place = (x - first) / step
    if place <= 0.0 or place >= density.size - 1:
        return 0.0
    i = int(place)
    past = place - i
    return float((1.0 - past) * density[i] + past * density[i + 1])


@jit
def _inside(lower: float, upper: float, mean: float, sigma: float) -> float:
    """Probability that a normal value lies in a cell."""
    width = upper - lower
    if width < _FINE * sigma:
        variance = sigma * sigma + width * width / 12.0
        away = 0.5 * (lower + upper) - mean
        exponent = away * away / (2.0 * variance)
        if exponent > _FAR:
            return 0.0
        return width * math.exp(-exponent) / math.sqrt(2.0 * math.pi * variance)
    below, above = (lower - mean) / sigma, (upper - mean) / sigma
    if below > 0:  # in the tail that erfc resolves
        below, above = -above, -below
    return _phi(above) - _phi(below)


@jit
def _share_and_slope(lower: float, upper: float, mean: float, sigma: float) -> tuple[float, float]:
    """Probability that a normal value lies in a cell, and its derivative by the mean."""
    share, width = _inside(lower, upper, mean, sigma), upper - lower
    if width < _FINE * sigma:
        return share, share * (0.5 * (lower + upper) - mean) / (sigma * sigma + width * width / 12.0)
    below, above = (lower - mean) / sigma, (upper - mean) / sigma
    return share, _PER_ROOT_TWO_PI / sigma * (math.exp(-0.5 * below * below) - math.exp(-0.5 * above * above))


@jit
def _cell(value: float, step: float, period: float) -> tuple[float, float]:
    """The ranges that are stored as a whole number of mm; lower is above upper where there are none.

    The least valid value is 1 mm: without a fold, all that is nearer is stored as 1 mm too.
    """
    lower, upper = value - 0.5, value + 0.5
    if step > 0:
        first, last = math.ceil(lower / step), math.floor(upper / step)
        if np.rint(first * step) < value:
            first += 1
        if np.rint(last * step) > value:
            last -= 1
        lower, upper = (first - 0.5) * step, (last + 0.5) * step
    if value == 1.0 and period <= 0.0:
        lower = upper - 2.0 * _NEARER_MM
    return lower, upper


@jit
def _width(lower: float, upper: float, step: float) -> float:
    """Width of a cell, mm; of all that is nearer than 1 mm, where random values hardly are, that of one cell."""
    width = upper - lower
    return width if width < _NEARER_MM else max(step, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sorted:
    """Pixels by what their samples need, for a mixture.

    Parameters
    ----------
    narrow : (n,) int64
        Those for whose components whole mm are narrow, with many components first.
    ends : (rank,) int64
        How many of them have at least 1, 2, ... components.
    others : (m,) int64
        The rest.
    log_invalid : (time, pixel) float64
        Log probability of an invalid sample.
    """

    narrow: IntArray
    ends: IntArray
    others: IntArray
    log_invalid: FloatArray

    @property
    def all(self) -> IntArray:
        """All of them."""
        return np.concatenate([self.narrow, self.others])


def sort_pixels(
    pixels: IntArray,
    weight: FloatArray,
    sigma: FloatArray,
    invalid: FloatArray,
    step: float,
    period: float,
    nearest: BoolArray,
    *,
    gaussian: bool = True,
) -> Sorted:
    """Sort pixels for `log_likelihood`.

    Parameters as there; `nearest` are the pixels (pixel,) with samples of 1 mm, whose cell is not narrow; and whether
    errors are normal.
    """
    log_invalid = np.log(np.maximum(invalid, _INVALID_FLOOR))
    there = weight > 0
    if step > 0 or period > 0 or not gaussian:
        return Sorted(pixels[:0], np.zeros(0, dtype=np.int64), pixels, log_invalid)
    wide = np.asarray((~there | (sigma > 1.0 / _FINE)).all(axis=(0, 1)) & ~nearest)[pixels]
    count = there.sum(axis=1).max(axis=0)[pixels[wide]]
    order = np.argsort(-count, kind="stable")
    ends = np.array([int((count > rank).sum()) for rank in range(int(count.max(initial=0)))], dtype=np.int64)
    return Sorted(pixels[wide][order], ends, pixels[~wide], log_invalid)


def log_likelihood(
    samples: NDArray[np.uint16],
    pixels: Sorted,
    frames: IntArray,
    events: LatentEvents,
    invalid: FloatArray,
    random_density: FloatArray,
    step: float,
    period: float,
    table: ShapeTable,
    by_pixel: FloatArray,
    by_frame: FloatArray,
) -> None:
    """Add up log-likelihoods and their slopes against a bias.

    Parameters
    ----------
    samples : (frame, pixel) uint16
        Whole mm; 0 is invalid.
    pixels : Sorted
        Which ones to go over.
    frames : (n,) int64
        Likewise.
    events : LatentEvents
        The mixture.
    invalid : (time, pixel) float64
        Probability of an invalid sample.
    random_density : (pixel,) float64
        Density of random values, 1/mm.
    step, period : float
        Lattice and fold, mm, 0 for none.
    table : ShapeTable
        Shape of the errors.
    by_pixel, by_frame : (pixel, 4), (frame, 4) float64
        Results, added to: log-likelihood, its slope against a bias (1/mm), its information (1/mm2), samples. The
        information takes a cell as noise, so that it is never negative.
    """
    density = random_density + _FLOOR
    if pixels.narrow.size:
        smooth_log_likelihood(
            samples, pixels.narrow, frames, events, pixels.log_invalid, density, pixels.ends, by_pixel, by_frame
        )
    if pixels.others.size:
        any_log_likelihood(
            samples, pixels.others, frames, events, invalid, random_density, step, period, table, by_pixel, by_frame
        )


@jit
def any_log_likelihood(  # noqa: C901, PLR0915  one pass, kept in one place
    samples: NDArray[np.uint16],
    pixels: IntArray,
    frames: IntArray,
    events: LatentEvents,
    invalid: FloatArray,
    random_density: FloatArray,
    step: float,
    period: float,
    table: ShapeTable,
    by_pixel: FloatArray,
    by_frame: FloatArray,
) -> None:
    """As `log_likelihood`, sample by sample, for cells and sigmas of any size."""
    key, since, frame_bias, extra_variance, pixel_bias, weight, mean, sigma, rate, lit = events
    components = weight.shape[1]
    for t in frames:
        g = key[t]
        for p in pixels:
            value = samples[t, p]
            if value == 0:
                ll = math.log(max(invalid[g, p], _INVALID_FLOOR))
                by_pixel[p, 0] += ll
                by_frame[t, 0] += ll
                continue
            lower, upper = _cell(float(value), step, period)
            total, slope, information = 0.0, 0.0, 0.0
            if lower < upper:
                width = _width(lower, upper, step)
                total = random_density[p] * width
                centre = 0.5 * (lower + upper)
                for k in range(components):
                    w = weight[g, k, p]
                    if w <= 0.0 or (lit[g, k, p] and 0.0 < period <= lower):  # beyond the fold is no phase
                        continue
                    m, s = mean[g, k, p], sigma[g, k, p]
                    turn = 0.0
                    if lit[g, k, p]:
                        m += rate[g, k, p] * since[t] + frame_bias[t] + pixel_bias[p]
                        if extra_variance[t] > 0.0:
                            s = math.sqrt(s * s + extra_variance[t])
                        if period > 0.0:
                            turn = np.rint((m - centre) / period) * period
                    precision = 1.0 / (s * s + width**2 / 12.0)
                    if table[2].size == 0:
                        share, slope_of_share = _share_and_slope(lower + turn, upper + turn, m, s)
                        inside, pull = w * share, w * slope_of_share
                    else:
                        below, above = (lower + turn - m) / s, (upper + turn - m) / s
                        inside = w * (_below(above, table) - _below(below, table))
                        pull = w * (_height(below, table) - _height(above, table)) / s
                    total += inside
                    if lit[g, k, p]:
                        slope += pull
                        information += inside * precision * table[4]
            total += _FLOOR
            ll = math.log(total)
            by_pixel[p, 0] += ll
            by_frame[t, 0] += ll
            slope /= total
            information /= total
            by_pixel[p, 1] += slope
            by_frame[t, 1] += slope
            by_pixel[p, 2] += information
            by_frame[t, 2] += information
            by_pixel[p, 3] += 1.0
            by_frame[t, 3] += 1.0


@jit
def _uniform(seed: int, t: int, p: int) -> float:
    """A uniform deviate of this sample alone (SplitMix64), the same in any order of the loops."""
    x = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(t) * np.uint64(0xBF58476D1CE4E5B9)
    x += np.uint64(p) * np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(30)
    x *= np.uint64(0xBF58476D1CE4E5B9)
    x ^= x >> np.uint64(27)
    x *= np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return (float(x >> np.uint64(11)) + 0.5) / 9007199254740992.0


@jit
def _component_cdf(x: float, m: float, s: float, folds: bool, period: float) -> float:
    if not folds:
        return _phi((x - m) / s)
    inside = min(max(x, 0.0), period)
    turn = np.floor(m / period)
    total = 0.0
    for k in range(-1, 2):
        start = (turn + k) * period - m
        total += _phi((inside + start) / s) - _phi(start / s)
    return total


@borrowing
def _shaped_cdf(x: float, m: float, s: float, folds: bool, period: float, table: ShapeTable) -> float:
    """As `_component_cdf`, of the table's shape."""
    if not folds:
        return _below((x - m) / s, table)
    inside = min(max(x, 0.0), period)
    turn = np.floor(m / period)
    total = 0.0
    for k in range(-1, 2):
        start = (turn + k) * period - m
        total += _below((inside + start) / s, table) - _below(start / s, table)
    return total


@borrowing
def _opposite(g: int, p: int, weight: FloatArray, mean: FloatArray, lit: BoolArray, period: float) -> float:
    """The place on a folded axis half a turn from the heaviest lit component; 0 without one.

    Counted from there, the transform has no jump near the surface, wherever its range folds.
    """
    heaviest, cut = 0.0, 0.0
    for k in range(weight.shape[1]):
        if lit[g, k, p] and weight[g, k, p] > heaviest:
            heaviest = weight[g, k, p]
            cut = mean[g, k, p] + 0.5 * period
    return cut - period * math.floor(cut / period)


@jit
def transform(  # noqa: C901  as above
    samples: NDArray[np.uint16],
    pixels: IntArray,
    frames: IntArray,
    events: LatentEvents,
    random_share: FloatArray,
    low: float,
    high: float,
    step: float,
    period: float,
    table: ShapeTable,
    seed: int,
    out: Float32Array,
) -> None:
    """Probability integral transform of each sample, drawn within its cell, given that it is valid; NaN where not.

    Parameters as for `log_likelihood`; random values have the share `random_share` (pixel,) between `low` and
    `high`, and `out` (frame, pixel) float32 takes the results.
    """
    key, since, frame_bias, extra_variance, pixel_bias, weight, mean, sigma, rate, lit = events
    components, gaussian = weight.shape[1], table[2].size == 0
    for t in frames:
        g = key[t]
        for p in pixels:
            value = samples[t, p]
            out[t, p] = np.nan
            if value == 0:
                continue
            lower, upper = _cell(float(value), step, period)
            if not lower < upper:
                continue
            u = _uniform(seed, t, p)
            x = 0.0
            whole = random_share[p]
            cut = -1.0
            if period > 0.0 and value <= period:
                cut = _opposite(g, p, weight, mean, lit, period)
            # F at both ends of the cell as drawn; counted from the cut: less F(cut), more F(period) below it
            ends = (lower, upper, cut, period)
            parts = (1.0 - u, u, -1.0, 1.0)
            for end in range(2 if cut <= 0.0 else 4 if value < cut else 3):
                at, part = ends[end], parts[end]
                total = random_share[p] * min(max((at - low) / (high - low), 0.0), 1.0)
                for k in range(components):
                    w = weight[g, k, p]
                    if w <= 0.0:
                        continue
                    m, s = mean[g, k, p], sigma[g, k, p]
                    glows = lit[g, k, p]
                    if glows:
                        m += rate[g, k, p] * since[t] + frame_bias[t] + pixel_bias[p]
                        s = math.sqrt(s * s + extra_variance[t])
                    if gaussian:
                        total += w * _component_cdf(at, m, s, glows and period > 0.0, period)
                    else:
                        total += w * _shaped_cdf(at, m, s, glows and period > 0.0, period, table)
                    if end == 0:
                        whole += w
                x += part * total
            out[t, p] = x / max(whole, _FLOOR)


def empty_sums(frames: int, pixels: int) -> tuple[FloatArray, FloatArray]:
    """Room for the results of `log_likelihood`."""
    return np.zeros((pixels, 4)), np.zeros((frames, 4))
