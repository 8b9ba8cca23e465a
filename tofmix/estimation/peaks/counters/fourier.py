"""The paper's second attempt (section IV b): maxima of a truncated Fourier series of the density.

Kept for comparison; docs/explanation/counters.md shows why `Kde` is the default. Nothing in it
knows the noise curve, and each surface has side lobes that look like weak surfaces.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.peaks.counters.base import SIGMAS_BEYOND, Peaks, no_peaks
from tofmix.estimation.samples import SortedSamples
from tofmix.options import FOURIER, check_options

GRID = 16
"""Points of the grid to the shortest wavelength of the series."""


@jit
def _coefficients(angles: FloatArray, n: int, a: FloatArray, b: FloatArray) -> None:
    """a_j and b_j for j from 1, equation (3), of the angles of `n` samples."""
    a[:], b[:] = 0.0, 0.0
    for angle in angles:
        cos1, sin1 = math.cos(angle), math.sin(angle)
        cos_j, sin_j = 1.0, 0.0
        for j in range(len(a)):
            cos_j, sin_j = cos_j * cos1 - sin_j * sin1, sin_j * cos1 + cos_j * sin1
            a[j] += cos_j
            b[j] += sin_j
    a /= n * math.pi  # eq. (3)
    b /= n * math.pi


@jit
def _series(a: FloatArray, b: FloatArray, a_0: float, cosines: FloatArray, sines: FloatArray, p: FloatArray) -> None:
    """Equation (2) on the grid."""
    for g in range(len(p)):
        total = 0.5 * a_0
        for j in range(len(a)):
            total += a[j] * cosines[g, j] + b[j] * sines[g, j]
        p[g] = total


@jit
def _off_grid(p: FloatArray, g: int) -> float:
    """Where the parabola through g - 1, g and g + 1 is highest, in steps from g; the series is periodic."""
    left, right = p[g - 1], p[(g + 1) % len(p)]
    bend = left - 2.0 * p[g] + right
    return 0.5 * (left - right) / bend if bend < 0.0 else 0.0


@jit
def _unwrapped(r: float, period: float, samples: FloatArray) -> float:
    """Of the two ranges that are equal to the series, r and r + period, the one nearer to a sample."""
    nearest, further = math.inf, math.inf
    for sample in samples:
        nearest = min(nearest, abs(sample - r))
        further = min(further, abs(sample - r - period))
    return r + period if further < nearest else r


@jit
def _insert(place: FloatArray, height: FloatArray, count: int, r: float, share: float) -> int:
    """Add a peak in order of range; there is always room, for a series of order m has at most m maxima."""
    i = count
    while i > 0 and place[i - 1] > r:
        place[i], height[i] = place[i - 1], height[i - 1]
        i -= 1
    place[i], height[i] = r, share
    return count + 1


@jit
def _fill(
    samples: SortedSamples,
    ends: tuple[float, float, float],
    tables: tuple[FloatArray, FloatArray],
    level: float,
    out: Peaks,
) -> None:
    low, high, reach = ends
    cosines, sines = tables
    points, order = cosines.shape
    period, peak = high - low, (2 * order + 1) / (2.0 * math.pi)
    a, b, p = np.zeros(order), np.zeros(order), np.zeros(points)
    for pixel in range(len(samples.valid)):
        n = samples.valid[pixel]
        if n == 0:
            continue
        values = samples.values[pixel, :n]
        inside = values[(values >= low) & (values <= high + reach)]
        place, height = out.place[pixel], out.height[pixel]
        if len(inside) == 0:
            place[0], height[0] = values[n // 2], 1.0 / n
            continue
        _coefficients(-math.pi + 2.0 * math.pi * (inside - low) / period, n, a, b)
        _series(a, b, len(inside) / (n * math.pi), cosines, sines, p)
        count, best = 0, 0
        for g in range(points):
            if p[g] > p[best]:
                best = g
            if p[g] > level * peak and p[g - 1] < p[g] >= p[(g + 1) % points]:
                r = low + period * (g + _off_grid(p, g)) / points
                count = _insert(place, height, count, _unwrapped(r, period, inside), p[g] / peak)
        if count == 0:
            r = low + period * (best + _off_grid(p, best)) / points
            place[0], height[0] = _unwrapped(r, period, inside), p[best] / peak
        out.found[pixel] = count


@dataclass(frozen=True, slots=True, kw_only=True)
class Fourier:
    """Maxima of the Fourier series of p(r) over the working range, equations (2) and (3), cut off at `order`.

    The working range r_min to r_max is mapped to -pi to pi, and the series is periodic there: a range just beyond
    r_max and one just beyond r_min are the same to it. Of the two, a peak is put where samples are. Samples
    below r_min, or farther beyond r_max than samples without a return reach, are left out.

    Cut off at order m, a surface becomes a main lobe of width 2 (r_max - r_min) / (m + 1/2) from zero to zero,
    and side lobes, the first ones -0.22 and 0.13 of its height. The negative ones are no modes.

    Parameters
    ----------
    order : int
        Last term of the series, 1 to 64. The paper compares a low order and twice that and states neither.
        With its camera 8 has lobes of 0.8 m to the first zero, and 16 of 0.4 m, which its boards 1.2 m apart need.
    level : float
        Least height of a mode, in [0, 1), as the share of a surface, far narrower than the main lobe, whose peak
        would just reach it. The paper does not state one. 0.1 is above the second side lobe of a lone surface and
        below the first; a higher one hides weak surfaces.

    Raises
    ------
    ValueError
        If a value is out of these bounds.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, section IV b, equations (2) and (3).
    """

    order: int = FOURIER["order"].default
    level: float = FOURIER["level"].default

    def __post_init__(self) -> None:
        check_options(self, FOURIER)

    def as_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return asdict(self)

    def peaks(self, samples: SortedSamples, beam: Beam) -> Peaks:
        """Find the peaks of each pixel; see `Peaks`."""
        out = no_peaks(len(samples.valid))
        points = GRID * self.order
        phase = np.outer(-np.pi + 2.0 * np.pi * np.arange(points) / points, np.arange(1, self.order + 1))
        ends = beam.range_min, beam.range_top, SIGMAS_BEYOND * beam.sigma_max
        _fill(samples, ends, (np.cos(phase), np.sin(phase)), float(self.level), out)
        return out
