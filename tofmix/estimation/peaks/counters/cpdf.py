"""The paper's first attempt (section IV a): maxima of a difference of the cumulative distribution.

Kept for comparison; docs/explanation/counters.md shows why `Kde` is the default. It does not use the noise curve: its
bins set the resolution.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.estimation.beam import Beam
from tofmix.estimation.peaks.counters.base import SIGMAS_BEYOND, Peaks, no_peaks
from tofmix.estimation.samples import SortedSamples
from tofmix.options import CPDF, check_options

LONE_SAMPLES = 1.0
"""A maximum must hold more samples than this: one alone is no surface."""

_ROUNDING = 1.0e-9
"""Differences of F below this share of the samples are none: P(k r) lies between bins."""


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
    for i in range(len(edges)):
        after = rise[i + 1] if i + 1 < len(edges) else -1.0
        if abs(after - rise[i]) <= _ROUNDING * n:
            continue  # the plateau goes on
        if rise[i] > before and rise[i] > after:
            # F(r) is the mass between r and k r, and P is known to a bin only: the mode is in the wider of the two.
            middle = 0.5 * (edges[first] + edges[i])
            at = middle + 0.5 * max((ratio - 1.0) * middle, width)
            inside = rise[i] / min((ratio - 1.0) * middle / width, 1.0)
            if inside > LONE_SAMPLES + _ROUNDING * n and count < len(place):
                place[count], height[count] = at, inside / n
                count += 1
            if rise[i] > best:
                best, guess = rise[i], at
        first, before = i + 1, rise[i]
    if count == 0:
        place[0], height[0] = guess, 1.0 / n
    return count


@jit
def _fill(samples: SortedSamples, edges: FloatArray, ratio: float, out: Peaks) -> None:
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
        _fill(samples, self.edges(beam), float(self.ratio), out)
        return out
