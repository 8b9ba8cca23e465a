"""Step 1: the kernel density of a pixel's samples, equation (4), and its peaks, test (5).

Use `density` to draw or test p(r). The search for its peaks (`find_modes`) evaluates the same sums along its own walk.
The bandwidth follows the sensor's resolution, h(r) = sigma(r) / 2, with r the place where the density is taken, so p(r)
integrates to one only as far as sigma(r) is flat over a kernel's width.

A peak is a run of places with p > gamma, |dp/dr| < epsilon and d2p/dr2 < 0. The walk goes over the samples in steps of
sigma / 8, twice that where the density is steep; where dp/dr changes its sign between two steps, the run includes that
place, so strict peaks are found for any epsilon. Peaks are where surfaces are looked for: close surfaces share one, few
samples make some too many, and neighbours displace them. `mixture` and `counting` go on from them.

In the derivatives the bandwidth is held at its local value. The full derivative
of (4) jumps at the corners of a noise curve, which can split one peak in two.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import exp_minus, least_of, sums_of
from tofmix.estimation.beam import sigma_at
from tofmix.estimation.samples import Readings, readings_of, whole_lanes, within_reach
from tofmix.sensor import NoiseCurve

BANDWIDTH = 0.5
"""h(r) in units of sigma(r): half the resolution (paper, section IV c)."""

REACH = 5.0
"""A kernel extends to this many h: beyond, it is below 4e-6 of its height."""


@borrowing
def kernel_sums(
    data: Readings, first: int, stop: int, range_mm: float, h: float, scratch: FloatArray
) -> tuple[float, float]:
    """Sums over the values [first, stop) of e and e z, with z = (r - r_j) / h and e = exp(-z^2 / 2).

    They are p and -p' of equation (4) with h held at its local value, in units of 1 / (N h sqrt(2 pi)) and of h.
    `scratch` is left with the e, by which `kernel_bend` goes on.
    """
    value, count, e = data.value[first:stop], data.times[first:stop], scratch[: stop - first]
    scale = 1.0 / h
    for j in range(len(value)):
        z = (range_mm - value[j]) * scale
        e[j] = count[j] * exp_minus(0.5 * z * z)
    total, moment = sums_of(e, value)
    return total, (range_mm * total - moment) * scale


@borrowing
def kernel_bend(data: Readings, first: int, stop: int, range_mm: float, h: float, scratch: FloatArray) -> float:
    """Sum of e (z^2 - 1) over the same values: p'' of equation (4), after `kernel_sums`."""
    bend = 0.0
    for j in range(stop - first):
        z = (range_mm - data.value[first + j]) / h
        bend += scratch[j] * (z * z - 1.0)
    return bend


@jit
def _density(data: Readings, at: FloatArray, curve_range: FloatArray, curve_sigma: FloatArray) -> FloatArray:
    out, scratch = np.zeros(len(at)), np.zeros(len(data.value))
    first, stop = 0, 0
    for k in range(len(at)):
        h = BANDWIDTH * sigma_at(at[k], curve_range, curve_sigma)
        first, stop = within_reach(data.value, first, stop, at[k] - REACH * h, at[k] + REACH * h)
        total, _ = kernel_sums(data, first, stop, at[k], h, scratch)
        out[k] = total / (data.total * h * math.sqrt(2.0 * math.pi))  # eq. (4)
    return out


def density(samples_mm: ArrayLike, at_mm: ArrayLike, noise: NoiseCurve) -> FloatArray:
    """Kernel density p(r) of one pixel's samples, equation (4).

    Parameters
    ----------
    samples_mm : (n,) array_like
        Samples, mm; values that are not finite are left out.
    at_mm : (m,) array_like
        Ranges at which p(r) is wanted, mm.
    noise : NoiseCurve
        sigma(r); the bandwidth is half of it.

    Returns
    -------
    (m,) float64
        p(r), 1/mm.

    Raises
    ------
    ValueError
        If there is no finite sample.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, equation (4).
    """
    data = readings_of(samples_mm)
    at = np.ascontiguousarray(at_mm, dtype=np.float64).ravel()
    return _density(data, at, np.array(noise.range_mm), np.array(noise.sigma_mm))


STEP = 0.125
"""Step of the walk in units of sigma(r): a quarter of the bandwidth."""


PEAK_OF_SHARE = 1.0 / math.sqrt(1.0 + 1.0 / BANDWIDTH**2)
"""Height of the smoothed peak of a surface of share 1, in units of one kernel's peak."""

LONE_SAMPLES = 3.0
"""A peak must be as high as that of a surface of 3 samples: one sample alone is as high as a surface of 2.2, and is not
a peak."""


@borrowing
def find_peaks(
    data: Readings,
    curve_range: FloatArray,
    curve_sigma: FloatArray,
    gamma: float,
    epsilon: float,
    scratch: FloatArray,
    places: FloatArray,
    heights: FloatArray,
) -> int:
    """Fill `places` (mm) and `heights` (share) with the peaks, ascending; return how many.

    The highest place is kept even where no peak passes gamma, with the count 0, as the start of a fit: few samples
    may not pile up. `scratch` holds as many numbers as there are values.
    """
    n, values = data.total, data.value
    threshold = max(gamma * n, LONE_SAMPLES) * PEAK_OF_SHARE
    count, in_run = 0, False
    place, height, flattest = 0.0, 0.0, math.inf
    best_place, best_height = values[0], 0.0
    first, stop, before, last = 0, 0, math.nan, 0.0
    # p rises up to the first sample and falls from the last one on: a step beyond each is enough.
    r = values[0] - STEP * sigma_at(values[0], curve_range, curve_sigma)
    end = values[-1] + STEP * sigma_at(values[-1], curve_range, curve_sigma)
    # Where |dp/dr| is above this, in units of p / h, the walk takes double steps: two turns do not fit into one.
    steep = 0.3
    while r <= end:
        sigma = sigma_at(r, curve_range, curve_sigma)
        h = BANDWIDTH * sigma
        first, stop = within_reach(values, first, stop, r - REACH * h, r + REACH * h)
        turns, flat, slope, total, step = False, False, math.nan, 0.0, STEP * sigma
        if first < stop:
            low, high = whole_lanes(first, stop, len(values))
            total, moment = kernel_sums(data, low, high, r, h, scratch)
            slope = -moment / total  # dp/dr in units of p / h
            turns = before > 0.0 >= slope
            if abs(slope) < epsilon:  # |dp/dr| < epsilon and d2p/dr2 < 0
                flat = kernel_bend(data, low, high, r, h, scratch) < 0.0
            if abs(slope) > steep:
                step *= 2.0
        elif first < len(values):
            step = max(step, values[first] - REACH * h - r)  # nothing near: go to the next sample
        if turns or flat:
            if not in_run:
                in_run, height, flattest = True, 0.0, math.inf
            if turns:
                place, flattest = r - last * slope / (slope - before), 0.0
            elif abs(slope) < flattest:
                place, flattest = r, abs(slope)
            height = max(height, total)
        if total > best_height:
            best_place, best_height = r, total
        if in_run and not flat:
            in_run = False
            if height > threshold:  # p > gamma
                count = keep_peak(places, heights, count, place, height / (n * PEAK_OF_SHARE))
        before, last, r = slope, step, r + step
    if in_run and height > threshold:
        count = keep_peak(places, heights, count, place, height / (n * PEAK_OF_SHARE))
    if count == 0:
        places[0], heights[0] = best_place, best_height / (n * PEAK_OF_SHARE)
    return count


@borrowing
def keep_peak(places: FloatArray, heights: FloatArray, count: int, place: float, height: float) -> int:
    """Append a peak; where there is no room, the lowest one gives way."""
    if count < len(places):
        places[count], heights[count] = place, height
        return count + 1
    lowest = least_of(heights)
    if height > heights[lowest]:
        for i in range(lowest, len(places) - 1):
            places[i], heights[i] = places[i + 1], heights[i + 1]
        places[-1], heights[-1] = place, height
    return count


def find_modes(
    samples_mm: ArrayLike, noise: NoiseCurve, *, gamma: float = 0.02, epsilon: float = 0.01, most: int = 64
) -> FloatArray:
    """Peaks of one pixel's density, test (5).

    Parameters
    ----------
    samples_mm : (n,) array_like
        Samples, mm; values that are not finite are left out.
    noise : NoiseCurve
        sigma(r).
    gamma, epsilon : float
        As for `tofmix.estimation.peaks.counters.Kde`.
    most : int
        Most peaks; the highest are kept.

    Returns
    -------
    (k,) float64
        Places of the peaks, mm, near to far; k may be 0.

    Raises
    ------
    ValueError
        If there is no finite sample.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, equation (5).
    """
    data = readings_of(samples_mm)
    places, heights, scratch = np.empty(most), np.empty(most), np.empty(len(data.value))
    curve = np.array(noise.range_mm), np.array(noise.sigma_mm)
    count = find_peaks(data, *curve, gamma, epsilon, scratch, places, heights)
    return places[:count].copy()
