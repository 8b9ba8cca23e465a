"""The samples of a block of pixels, in the order in which every step reads them.

Sorted once, one pixel after the other in memory. The steps then neither skip invalid values nor depend on the order of
the frames. They read a pixel as `Readings`: values that are equal are one value with a count, and where a window is
long, so are values that differ by a small part of sigma. The time of a pixel then no longer grows with its samples, and
beyond 10,000 by their fourth root.

Which of a pixel's sorted samples lie near a range: the part of them that a sum over a narrow kernel needs.

Random values spread over the working range. Where its end is not known, they spread between the extreme valid samples:
use `sensor_with_span` before an estimate. The whole recording is read, so the result does not depend on the estimated
part or on the blocks.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import LANES
from tofmix.estimation.beam import sigma_at
from tofmix.recording import DECODED_SAMPLES, SampleSource
from tofmix.sensor import Sensor


@borrowing
def whole_lanes(first: int, stop: int, n: int) -> tuple[int, int]:
    """Widen [first, stop) of n values to whole `LANES`, within n: a few more values cost less than a partial lane."""
    return first // LANES * LANES, min((stop + LANES - 1) // LANES * LANES, n)


@borrowing
def within_reach(values: FloatArray, first: int, stop: int, low: float, high: float) -> tuple[int, int]:
    """Move [first, stop) to the ascending values in [low, high]; cheap when it moves little."""
    n = len(values)
    while first > 0 and values[first - 1] >= low:
        first -= 1
    while first < n and values[first] < low:
        first += 1
    stop = max(stop, first)
    while stop > first and values[stop - 1] > high:
        stop -= 1
    while stop < n and values[stop] <= high:
        stop += 1
    return first, stop


FARTHEST_MM = 1.0e9
"""A value beyond this is no range of any camera, and is skipped as invalid."""

LONG_WINDOW = 1000
"""From this many samples on, values closer than `BIN` sigma become one, their mean."""

BIN = 1.0 / 16.0
"""Width of a bin in sigmas. Its values are replaced by their mean, which loses their spread, 0.03 % of sigma^2."""


class SortedSamples(NamedTuple):
    """Samples of many pixels: `values` (pixel, frame) float64 in mm, of which the first `valid` (pixel,) ascend."""

    values: FloatArray
    valid: IntArray


class Readings(NamedTuple):
    """The samples of one pixel: ascending values (m,) float64 in mm, how often each came (m,), and all together.

    A value may have come 0 times: it fills up a last group of `vector.LANES`.
    """

    value: FloatArray
    times: FloatArray
    total: float


def sort_samples(block: NDArray[np.floating]) -> SortedSamples:
    """Sort the valid samples of each pixel of a block (frame, pixel)."""
    values = np.array(block.T, dtype=np.float32, order="C", copy=True)
    with np.errstate(invalid="ignore"):
        values[~(np.abs(values) <= FARTHEST_MM)] = np.nan
    values.sort(axis=1)  # NaN last
    valid = np.count_nonzero(~np.isnan(values), axis=1).astype(np.int64)
    return SortedSamples(values.astype(np.float64), valid)


def invalid_share(block: NDArray[np.floating], *, samples_a_frame: int = 1, is_filtered: bool = False) -> Float32Array:
    """Share of the frames in which each pixel has no valid sample.

    Parameters
    ----------
    block : (frame, ...) array of float
        Samples, mm; where a frame has several targets, they follow each other. A missing target is no lost sample, so
        a frame is lost if none of its targets is valid.
    samples_a_frame : int
        Targets of a frame, at least 1.
    is_filtered : bool
        Whether the samples are of `tofmix.recording`: infinite ones add none to those before, and do not
        count.

    Returns
    -------
    (...) float32
        In [0, 1].
    """
    with np.errstate(invalid="ignore"):
        valid = np.abs(block) <= FARTHEST_MM  # false for NaN
    if samples_a_frame > 1:
        valid = valid.reshape(-1, samples_a_frame, *block.shape[1:]).any(axis=1)
    some, add_none = np.count_nonzero(valid, axis=0), 0
    if is_filtered:
        add_none = np.count_nonzero(np.isposinf(block), axis=0) // samples_a_frame
    counted = len(valid) - add_none
    # Without any sample, frames that add none are still no lost ones.
    lost = np.where(some > 0, 1.0 - some / np.maximum(counted, 1), counted / len(valid))
    return np.asarray(lost, dtype=np.float32)


@borrowing
def padded(n: int) -> int:
    """Least multiple of `LANES` that is not below n."""
    return (n + LANES - 1) // LANES * LANES


@jit
def gather(
    values: FloatArray, n: int, curve_range: FloatArray, curve_sigma: FloatArray, value: FloatArray, count: FloatArray
) -> Readings:
    """Make `Readings` of the first `n` of ascending values, n > 0.

    The last value is repeated, with the count 0, up to a multiple of `LANES`. `value` and `count` are room for
    `padded` of n.
    """
    m, width, first, last, inside, pulled = -1, -1.0, 0.0, 0.0, 0.0, 0.0
    # Up to this many samples. Beyond, bins narrow with the fourth root of the number: standard errors shrink with the
    # square root, and the shift by binning, which follows the square of the width, stays the same part of them.
    wide_bins = 10_000.0
    bin_sigmas = BIN * math.sqrt(math.sqrt(min(1.0, wide_bins / n)))
    for j in range(n):
        x = values[j]
        if m >= 0 and (x == last or x - first <= width):
            inside += 1.0
            pulled += x - first
        else:
            if m >= 0:
                value[m], count[m] = first + pulled / inside, inside
            m, first, inside, pulled = m + 1, x, 1.0, 0.0
            if n >= LONG_WINDOW:
                width = bin_sigmas * sigma_at(x, curve_range, curve_sigma)
        last = x
    value[m], count[m] = first + pulled / inside, inside
    stop = padded(m + 1)
    for j in range(m + 1, stop):
        value[j], count[j] = value[m], 0.0
    return Readings(value[:stop], count[:stop], float(n))


def readings_of(samples_mm: ArrayLike) -> Readings:
    """Sort one pixel's finite samples.

    Parameters
    ----------
    samples_mm : array_like
        Samples, mm, of any shape.

    Returns
    -------
    Readings
        Every sample by itself.

    Raises
    ------
    ValueError
        If there is none.
    """
    samples = np.asarray(samples_mm, dtype=np.float64).ravel()
    samples = np.sort(samples[np.isfinite(samples)])
    if samples.size == 0:
        raise ValueError("samples: none is finite")
    return Readings(samples, np.ones_like(samples), float(samples.size))


def sample_span(source: SampleSource) -> tuple[float, float] | None:
    """Find the extreme valid samples of a recording.

    Parameters
    ----------
    source : SampleSource
        The recording. All of it is read once, about 2^20 samples at a time, or a stored chunk where that is larger.

    Returns
    -------
    tuple of float or None
        The least and the largest sample, mm; None where no sample is valid.
    """
    low, high = np.inf, -np.inf
    for frames, rows in _blocks(source):
        samples = source.read_range(frames, rows)
        with np.errstate(invalid="ignore"):
            valid = samples[np.abs(samples) <= FARTHEST_MM]  # false for NaN
        if valid.size:
            low, high = min(low, float(valid.min())), max(high, float(valid.max()))
    return (low, high) if low <= high else None


def sensor_with_span(source: SampleSource, unambiguous_range_mm: float | None = None) -> Sensor:
    """The recording's camera, with the extreme samples where random values need them.

    Parameters
    ----------
    source : SampleSource
        The recording. It is read where its camera has no `range_max_mm` and ranges are on a line.
    unambiguous_range_mm : float, optional
        Length of the circle that ranges are on, mm; a line without it.

    Returns
    -------
    Sensor
        With `sample_min_mm` and `sample_max_mm`, or without them if the working range, or the circle, is the interval
        of random values.
    """
    sensor, span = source.sensor, None
    if sensor.range_max_mm is None and unambiguous_range_mm is None:
        span = sample_span(source)
    low, high = span or (None, None)
    return replace(sensor, sample_min_mm=low, sample_max_mm=high)


def _blocks(source: SampleSource) -> Iterator[tuple[slice, slice]]:
    """Cut a recording into blocks (frames, rows) of whole stored chunks, which cover it once."""
    frames, rows, cols = source.shape
    high, deep = min(source.row_step, rows), min(source.frame_step, frames)
    more = max(1, DECODED_SAMPLES // (deep * high * cols))
    high = min(rows, high * more)
    deep *= max(1, DECODED_SAMPLES // (deep * high * cols))
    for first in range(0, frames, deep):
        for top in range(0, rows, high):
            yield slice(first, min(first + deep, frames)), slice(top, min(top + high, rows))
