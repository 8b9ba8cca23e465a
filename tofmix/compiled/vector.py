"""Exponential and logarithm that vectorise, and sums that do not wait for each other.

Use these in the loops over a pixel's samples. `math.exp` and `math.log` are calls into the C library, one number at a
time; the polynomials here are inlined, and the compiler works on 4 or 8 numbers at once; for that, a loop must count
from 0: an index that may be negative, as one from a parameter, stops it, so loops take slices. Values after the last
group of 8 are computed one by one, each at the cost of 8: `samples.gather` leaves nothing over. Sums are kept in four
or eight parts, always the same ones: a sum in one part waits for each addition, and a sum that the compiler may reorder
would differ from machine to machine. `range` with a step of 4 would cost as much as the sum.

From a median absolute deviation to a standard deviation.
"""

import math
from statistics import NormalDist

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing

MAD_TO_SIGMA = round(1.0 / NormalDist().inv_cdf(0.75), 4)
"""Sigma of Gaussian samples by their median absolute deviation, 1 / Phi^-1(3/4), to four decimals.

References
----------
Rousseeuw and Croux, Journal of the American Statistical Association 88, 1993, doi:10.1080/01621459.1993.10476408.
"""


LANES = 8
"""Loops over a multiple of this many numbers leave nothing over."""

_LOG_2 = math.log(2.0)
_ROOT_2 = math.sqrt(2.0)


@borrowing
def exp_minus(x: float) -> float:
    """exp(-x) for x >= 0, to 1e-10 of its value up to x = 20, and to 1 % up to 400.

    exp(-x / 1024) by its series, squared ten times. Never 0: values past 700 are as at it, 10^-304.
    """
    squarings = 10  # the series is taken at x / 2^10, and squared ten times
    y = min(x, 700.0) * (-1.0 / 2.0**squarings)
    p = 1.0 + y * (1.0 + y * (1.0 / 2.0 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0)))))
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    return p


@borrowing
def log_of(x: float) -> float:
    """Natural logarithm of a normal number above 0, to 1e-12: the exponent's bits, and the series of atanh."""
    bits = np.float64(x).view(np.int64)
    exponent = float(((bits >> np.int64(52)) & np.int64(0x7FF)) - np.int64(1023))
    mantissa = np.int64((bits & np.int64(0x000FFFFFFFFFFFFF)) | np.int64(0x3FF0000000000000)).view(np.float64)
    upper = mantissa > _ROOT_2
    mantissa = 0.5 * mantissa if upper else mantissa
    exponent = exponent + 1.0 if upper else exponent
    s = (mantissa - 1.0) / (mantissa + 1.0)
    z = s * s
    odd = 1.0 / 7.0 + z * (1.0 / 9.0 + z * (1.0 / 11.0 + z * (1.0 / 13.0)))
    return float(exponent * _LOG_2 + 2.0 * s * (1.0 + z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * odd))))


@borrowing
def total_of(values: FloatArray) -> float:
    """Sum of the values."""
    a, b, c, d, e, f, g, h = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n = len(values)
    for part in range(n >> 3):
        j = part << 3
        a += values[j]
        b += values[j + 1]
        c += values[j + 2]
        d += values[j + 3]
        e += values[j + 4]
        f += values[j + 5]
        g += values[j + 6]
        h += values[j + 7]
    for j in range(n - n % 8, n):
        a += values[j]
    return ((a + b) + (c + d)) + ((e + f) + (g + h))


@borrowing
def product_of(values: FloatArray, others: FloatArray) -> float:
    """Sum of the values times the others, of which there may be more."""
    a, b, c, d, e, f, g, h = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    n = len(values)
    for part in range(n >> 3):
        j = part << 3
        a += values[j] * others[j]
        b += values[j + 1] * others[j + 1]
        c += values[j + 2] * others[j + 2]
        d += values[j + 3] * others[j + 3]
        e += values[j + 4] * others[j + 4]
        f += values[j + 5] * others[j + 5]
        g += values[j + 6] * others[j + 6]
        h += values[j + 7] * others[j + 7]
    for j in range(n - n % 8, n):
        a += values[j] * others[j]
    return ((a + b) + (c + d)) + ((e + f) + (g + h))


@borrowing
def sums_of(values: FloatArray, others: FloatArray) -> tuple[float, float]:
    """Sum of the values, and of the values times the others, of which there may be more."""
    a0, b0, c0, d0 = 0.0, 0.0, 0.0, 0.0
    a1, b1, c1, d1 = 0.0, 0.0, 0.0, 0.0
    n = len(values)
    for part in range(n >> 2):
        j = part << 2
        a0 += values[j]
        b0 += values[j + 1]
        c0 += values[j + 2]
        d0 += values[j + 3]
        a1 += values[j] * others[j]
        b1 += values[j + 1] * others[j + 1]
        c1 += values[j + 2] * others[j + 2]
        d1 += values[j + 3] * others[j + 3]
    for j in range(n - n % 4, n):
        a0 += values[j]
        a1 += values[j] * others[j]
    return (a0 + b0) + (c0 + d0), (a1 + b1) + (c1 + d1)


@borrowing
def moments_of(values: FloatArray, density: FloatArray, share: FloatArray, about: float) -> tuple[float, float, float]:
    """Sums over the values of density * share, of that times (value - about), and times its square."""
    a0, b0, c0, d0 = 0.0, 0.0, 0.0, 0.0
    a1, b1, c1, d1 = 0.0, 0.0, 0.0, 0.0
    a2, b2, c2, d2 = 0.0, 0.0, 0.0, 0.0
    n = len(values)
    for part in range(n >> 2):
        j = part << 2
        weight, away = density[j] * share[j], values[j] - about
        a0 += weight
        a1 += weight * away
        a2 += weight * away * away
        weight, away = density[j + 1] * share[j + 1], values[j + 1] - about
        b0 += weight
        b1 += weight * away
        b2 += weight * away * away
        weight, away = density[j + 2] * share[j + 2], values[j + 2] - about
        c0 += weight
        c1 += weight * away
        c2 += weight * away * away
        weight, away = density[j + 3] * share[j + 3], values[j + 3] - about
        d0 += weight
        d1 += weight * away
        d2 += weight * away * away
    for j in range(n - n % 4, n):
        weight, away = density[j] * share[j], values[j] - about
        a0 += weight
        a1 += weight * away
        a2 += weight * away * away
    return (a0 + b0) + (c0 + d0), (a1 + b1) + (c1 + d1), (a2 + b2) + (c2 + d2)


@borrowing
def least_of(values: FloatArray) -> int:
    """Index of the first of the least values (n,), n > 0, none of them NaN.

    `np.argmin` would have each process that loads the caller's code import SciPy.
    """
    least = 0
    for j in range(1, len(values)):
        if values[j] < values[least]:
            least = j
    return least
