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
from tofmix.compiled.jit import borrowing, jit
from tofmix.compiled.vector import exp_minus, sums_of
from tofmix.estimation.beam import sigma_at
from tofmix.estimation.samples import Readings, readings_of, within_reach
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
