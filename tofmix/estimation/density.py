"""Step 1, first half: the kernel density of a pixel's samples, equation (4).

Use `density` to draw or test p(r). The search for its peaks (`modes`) evaluates
the same sums along its own walk and does not come through here.

The bandwidth follows the sensor's resolution, h(r) = sigma(r) / 2, with r the
place where the density is taken, so p(r) integrates to one only as far as
sigma(r) is flat over a kernel's width.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.estimation.samples import sorted_valid
from tofmix.jit import jit
from tofmix.sensor import NoiseCurve

BANDWIDTH = 0.5
"""h(r) in units of sigma(r): half the resolution (paper, section IV c)."""

REACH = 5.0
"""A kernel counts up to this many h: what is left out is below 4e-6 of its height."""


@jit
def sigma_at(range_mm: float, curve_range: FloatArray, curve_sigma: FloatArray) -> float:
    """sigma(r), linear between the curve's points and constant past its ends."""
    last = len(curve_range) - 1
    if range_mm <= curve_range[0]:
        return float(curve_sigma[0])
    if range_mm >= curve_range[last]:
        return float(curve_sigma[last])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if curve_range[middle] <= range_mm:
            low = middle
        else:
            high = middle
    share = (range_mm - curve_range[low]) / (curve_range[high] - curve_range[low])
    return float(curve_sigma[low] + share * (curve_sigma[high] - curve_sigma[low]))


@jit
def kernel_sums(samples: FloatArray, first: int, stop: int, range_mm: float, h: float) -> tuple[float, float, float]:
    """Sums over samples[first:stop] of e, e z and e z^2, with z = (r - r_j) / h and e = exp(-z^2 / 2).

    They are p, -p' and p'' + p of equation (4) with h held at its local value,
    in units of 1 / (N h sqrt(2 pi)) and of h.
    """
    total, moment1, moment2 = 0.0, 0.0, 0.0
    for j in range(first, stop):
        z = (range_mm - samples[j]) / h
        kernel = math.exp(-0.5 * z * z)
        total += kernel
        moment1 += kernel * z
        moment2 += kernel * z * z
    return total, moment1, moment2


@jit
def within_reach(samples: FloatArray, first: int, stop: int, low: float, high: float) -> tuple[int, int]:
    """Move [first, stop) to the sorted samples in [low, high]; cheap when it moves little."""
    n = len(samples)
    while first > 0 and samples[first - 1] >= low:
        first -= 1
    while first < n and samples[first] < low:
        first += 1
    stop = max(stop, first)
    while stop > first and samples[stop - 1] > high:
        stop -= 1
    while stop < n and samples[stop] <= high:
        stop += 1
    return first, stop


@jit
def _density(samples: FloatArray, at: FloatArray, curve_range: FloatArray, curve_sigma: FloatArray) -> FloatArray:
    out = np.zeros(len(at))
    first, stop = 0, 0
    for k in range(len(at)):
        h = BANDWIDTH * sigma_at(at[k], curve_range, curve_sigma)
        first, stop = within_reach(samples, first, stop, at[k] - REACH * h, at[k] + REACH * h)
        total, _, _ = kernel_sums(samples, first, stop, at[k], h)
        out[k] = total / (len(samples) * h * math.sqrt(2.0 * math.pi))  # eq. (4)
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
    samples = sorted_valid(samples_mm)
    at = np.ascontiguousarray(at_mm, dtype=np.float64).ravel()
    return _density(samples, at, np.array(noise.range_mm), np.array(noise.sigma_mm))
