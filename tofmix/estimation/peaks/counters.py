"""Step 1 as the paper tried it: three ways to count the surfaces of a pixel.

A counter is a class and a line of `COUNTERS`: each is a frozen dataclass of its
parameters with the paper's values as defaults; their names are the options of the
command line.

The paper's first attempt (section IV a): maxima of a difference of the cumulative distribution.

Kept for comparison; docs/explanation/counters.md shows why `Kde` is the default. It does not use the noise curve: its
bins set the resolution.

The paper's second attempt (section IV b): maxima of a truncated Fourier series of the density.

Kept for comparison; docs/explanation/counters.md shows why `Kde` is the default. Nothing in it
knows the noise curve, and each surface has side lobes that look like weak surfaces.

The paper's choice (section IV c): peaks of a kernel density whose bandwidth follows the noise curve.

See `tofmix.estimation.peaks.modes` for equation (4) and `tofmix.estimation.peaks.modes` for test (5).
"""

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple, Protocol

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.noise.amplitude import beam_of_pixel
from tofmix.estimation.peaks.modes import find_peaks
from tofmix.estimation.samples import SortedSamples, gather, padded
from tofmix.options import CPDF, FOURIER, KDE, check_options

MAX_PEAKS = 64
"""Most peaks whose places are kept; more than that in one pixel is noise."""

SIGMAS_BEYOND = 4.0
"""Samples of surfaces at the ends of the working range, and of no return, extend this many sigma beyond it."""


class Peaks(NamedTuple):
    """Peaks of many pixels.

    `place` (pixel, MAX_PEAKS) in mm, near to far; `height` (pixel, MAX_PEAKS), about the share of the samples;
    `found` (pixel,) is their number. Where it is 0, place[0] is the best guess at one, as the start of a fit.
    """

    place: FloatArray
    height: FloatArray
    found: IntArray


def no_peaks(pixels: int) -> Peaks:
    """Room for the peaks of `pixels` pixels."""
    shape = (pixels, MAX_PEAKS)
    return Peaks(np.zeros(shape), np.zeros(shape), np.zeros(pixels, dtype=np.int64))


class Counter(Protocol):
    """A way to count surfaces: a frozen dataclass of parameters."""

    def peaks(self, samples: SortedSamples, beam: Beam) -> Peaks:
        """Find the peaks of each pixel; pixels without samples have none."""

    def as_dict(self) -> dict[str, float]:
        """Return the parameters by name."""


@jit
def _count_below(samples: FloatArray, edges: FloatArray, below: FloatArray) -> None:
    """N P(b): samples at or below each edge."""
    j = 0
    for i in range(len(edges)):
        while j < len(samples) and samples[j] <= edges[i]:
            j += 1
        below[i] = j


@jit
def _rises(below: FloatArray, edges: FloatArray, ratio: float, rise: FloatArray) -> None:
    """N F(r) = N (P(k r) - P(r)) at each edge; P is linear between edges."""
    width, last = edges[1] - edges[0], len(edges) - 1
    for i in range(len(edges)):
        rise[i] = 0.0
        if edges[i] > 0.0:
            at = (ratio * edges[i] - edges[0]) / width
            whole = int(min(at, last - 1))
            part = min(at - whole, 1.0)
            rise[i] = below[whole] + part * (below[whole + 1] - below[whole]) - below[i]


@jit
def _maxima(n: int, edges: FloatArray, ratio: float, rise: FloatArray, place: FloatArray, height: FloatArray) -> int:
    """Fill places and heights with the local maxima of F, a plateau being one; return how many."""
    width = edges[1] - edges[0]
    count, first, before, best = 0, 0, -1.0, 0.0
    guess = math.nan
    rounding = 1.0e-9  # differences of F below this share of the samples are none: P(k r) lies between bins
    for i in range(len(edges)):
        after = rise[i + 1] if i + 1 < len(edges) else -1.0
        if abs(after - rise[i]) <= rounding * n:
            continue  # the plateau goes on
        if rise[i] > before and rise[i] > after:
            # F(r) is the mass between r and k r, and P is known to a bin only: the mode is in the wider of the two.
            middle = 0.5 * (edges[first] + edges[i])
            at = middle + 0.5 * max((ratio - 1.0) * middle, width)
            inside = rise[i] / min((ratio - 1.0) * middle / width, 1.0)
            if inside > 1.0 + rounding * n and count < len(place):  # one sample alone is no surface
                place[count], height[count] = at, inside / n
                count += 1
            if rise[i] > best:
                best, guess = rise[i], at
        first, before = i + 1, rise[i]
    if count == 0:
        place[0], height[0] = guess, 1.0 / n
    return count


@jit
def _fill_cpdf(samples: SortedSamples, edges: FloatArray, ratio: float, out: Peaks) -> None:
    below, rise = np.zeros(len(edges)), np.zeros(len(edges))
    for pixel in range(len(samples.valid)):
        n = samples.valid[pixel]
        if n > 0:
            values, place = samples.values[pixel, :n], out.place[pixel]
            _count_below(values, edges, below)
            _rises(below, edges, ratio, rise)
            out.found[pixel] = _maxima(n, edges, ratio, rise, place, out.height[pixel])
            if math.isnan(place[0]):
                place[0] = values[n // 2]  # no sample in any bin


@dataclass(frozen=True, slots=True, kw_only=True)
class Cpdf:
    """Maxima of F(r) = P(k r) - P(r), with the cumulative distribution P over bins of the working range.

    P(r) = #(r_j <= r) / N is taken at the edges of `bins` equal bins and is linear between them. F(r) is the
    share of the samples between r and k r. Each local maximum is a mode, a plateau being one. Its place is the
    centre of the samples that F counts there: r (1 + k) / 2, or the centre of the bin where that is wider.

    The bins go on past the working range's end as far as samples without a return reach, 4 sigma. Other samples
    outside the working range are in no bin.

    Parameters
    ----------
    bins : int
        N_bin, 2 to 100; the paper's 15.
    ratio : float
        k, above 1 and at most 10. The paper does not state it. F is highest where r to k r just holds a whole
        surface, 4 sigma(r), so k = 1 + 4 sigma(r) / r; and less than a bin is not resolved, so k = 1 + bin / r.
        With the paper's camera and 15 bins both give 1.1: sigma(r) / r is 2 to 3 % from 2 to 4 m at 1.2 ms, and
        a bin is 11 % of the middle of the range.

    Raises
    ------
    ValueError
        If a value is out of these bounds.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, section IV a.
    """

    bins: int = CPDF["bins"].default
    ratio: float = CPDF["ratio"].default

    def __post_init__(self) -> None:
        check_options(self, CPDF)

    def as_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return asdict(self)

    def edges(self, beam: Beam) -> FloatArray:
        """Edges of the bins, mm."""
        width = (beam.range_top - beam.range_min) / self.bins
        more = math.ceil(SIGMAS_BEYOND * beam.sigma_max / width)
        return np.asarray(beam.range_min + width * np.arange(self.bins + more + 1), dtype=np.float64)

    def peaks(self, samples: SortedSamples, beam: Beam) -> Peaks:
        """Find the peaks of each pixel; see `Peaks`."""
        out = no_peaks(len(samples.valid))
        _fill_cpdf(samples, self.edges(beam), float(self.ratio), out)
        return out


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
def _fill_fourier(
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
        points = 16 * self.order  # sixteen to the shortest wavelength of the series
        phase = np.outer(-np.pi + 2.0 * np.pi * np.arange(points) / points, np.arange(1, self.order + 1))
        ends = beam.range_min, beam.range_top, SIGMAS_BEYOND * beam.sigma_max
        _fill_fourier(samples, ends, (np.cos(phase), np.sin(phase)), float(self.level), out)
        return out


@jit
def _fill_kde(samples: SortedSamples, beam: Beam, gamma: float, epsilon: float, out: Peaks) -> None:
    frames = padded(samples.values.shape[1])
    value, count, scratch = np.empty(frames), np.empty(frames), np.empty(frames)
    for pixel in range(len(samples.valid)):
        n = samples.valid[pixel]
        if n > 0:
            own = beam_of_pixel(beam, pixel)
            out.found[pixel] = find_peaks(
                gather(samples.values[pixel], n, own.curve_range, own.curve_sigma, value, count),
                own.curve_range,
                own.curve_sigma,
                gamma,
                epsilon,
                scratch,
                out.place[pixel],
                out.height[pixel],
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Kde:
    """Kernel density with bandwidth sigma(r) / 2, equation (4), and test (5).

    Parameters
    ----------
    gamma : float
        Smallest share of the samples that makes a peak, in [0, 1): gamma of the test (5), as the
        share of the surface whose peak would just reach it.
    epsilon : float
        Largest slope at a peak, in units of p(r) / h(r), above 0: epsilon of the test (5).

    Raises
    ------
    ValueError
        If a value is out of these bounds.
    """

    gamma: float = KDE["gamma"].default
    epsilon: float = KDE["epsilon"].default

    def __post_init__(self) -> None:
        check_options(self, KDE)

    def as_dict(self) -> dict[str, float]:
        """Return the parameters by name."""
        return asdict(self)

    def peaks(self, samples: SortedSamples, beam: Beam) -> Peaks:
        """Find the peaks of each pixel; see `Peaks`."""
        out = no_peaks(len(samples.valid))
        _fill_kde(samples, beam, float(self.gamma), float(self.epsilon), out)
        return out


COUNTERS: dict[str, type[Counter]] = {
    "kde": Kde,
    "cpdf": Cpdf,
    "fourier": Fourier,
}

__all__ = ["COUNTERS", "Counter", "Cpdf", "Fourier", "Kde", "Peaks"]
