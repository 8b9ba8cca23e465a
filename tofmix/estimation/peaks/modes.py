"""Step 1, second half: the peaks of the density, test (5).

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
from tofmix.compiled.jit import borrowing
from tofmix.compiled.vector import least_of
from tofmix.estimation.beam import sigma_at
from tofmix.estimation.peaks.density import BANDWIDTH, REACH, kernel_bend, kernel_sums
from tofmix.estimation.samples import Readings, readings_of, whole_lanes, within_reach
from tofmix.sensor import NoiseCurve

STEP = 0.125
"""Step of the walk in units of sigma(r): a quarter of the bandwidth."""

STEEP = 0.3
"""Where |dp/dr| is above this, in units of p / h, the walk takes double steps: two turns do not fit into one."""

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
            if abs(slope) > STEEP:
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
