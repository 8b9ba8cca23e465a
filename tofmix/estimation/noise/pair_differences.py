"""sigma(r) from the differences between samples of a pixel, also where no pixel sees one surface alone.

The difference of two samples of one surface has the standard deviation sqrt(2) sigma. Differences to background or to
other surfaces are larger and spread widely. So the density of |x_i - x_j| is a peak at small differences on a level.
The level is subtracted; the median of the rest is 0.954 sigma, that of a Gaussian's difference. Surfaces that are a few
sigmas apart in every pixel widen the peak: `sigma_curve` then tries smaller sigmas too.
"""

import math
from itertools import pairwise
from statistics import NormalDist

import numpy as np

from tofmix.arrays import Float32Array, FloatArray

MEDIAN_OF_DIFFERENCE = NormalDist().inv_cdf(0.75) * math.sqrt(2.0)
"""Median of |x_i - x_j| of a Gaussian, in sigmas."""

PEAK_SIGMAS, LEVEL_SIGMAS = 5.0, 10.0
"""Differences up to the first are the peak's, those between the two the level's, in sigmas."""

PAIRS_A_SAMPLE = 16
"""Pairs of each sample, with the next valid ones of its pixel: a drift over them is small."""

MOST_PAIRS = 1_500_000
"""About the most differences of all pixels: they determine sigma to a fifth of a percent."""

LEAST_PAIRS = 1000
"""Least differences in a bin of range: those of 60 samples, which tell sigma to a tenth."""

WIDE = 0.25
"""Width of a bin by its range."""

WIDEST = 5.0
"""Largest factor between sigma in a bin and the common one, where sigma grows at most as range does (`_most_of`)."""

FLAT = 0.25
"""Largest sigma by the span of the samples: uniform samples have 0.31, those of a surface less than 0.2."""

LEAST_EXCESS = 0.02
"""Least part of the differences that the peak has over the level."""

LEAST_IN_PEAK = 10
"""Least differences of a peak."""

SIGNIFICANT_EXCESS = 5.0
"""Least excess of a peak over the level, in standard errors of the number of differences up to `LEVEL_SIGMAS`."""

_GRID_STEP = math.log(1.12)
"""Step between the logarithms of the sigmas that are tried."""


def _differences(samples: Float32Array, partners: int) -> tuple[FloatArray, FloatArray]:
    """Means and absolute differences, mm, of each valid sample and each of the `partners` next ones of its pixel."""
    pixel, frame = np.nonzero(~np.isnan(samples))  # in the order of pixels, and of frames within each
    value = samples[pixel, frame].astype(np.float64)
    places, lags = [], []
    for away in range(1, partners + 1):
        together = pixel[away:] == pixel[:-away]
        one, other = value[:-away][together], value[away:][together]
        places.append(0.5 * (one + other))
        lags.append(np.abs(one - other))
    return np.concatenate(places), np.concatenate(lags)


def sigma_from_differences(samples_mm: Float32Array) -> tuple[FloatArray, FloatArray] | None:
    """Measure sigma(r) by pairs of samples.

    Parameters
    ----------
    samples_mm : (pixel, frame) float32
        Samples in the order of frames, NaN where invalid.

    Returns
    -------
    (n,), (n,) float64 or None
        Ranges, mm, ascending, and sigma at each, mm; None where no peak of differences stands out.
    """
    partners = min(PAIRS_A_SAMPLE, max(samples_mm.shape[1] - 1, 1))
    some = samples_mm[:: 1 + samples_mm.size * partners // MOST_PAIRS]
    place, lag = _differences(some, partners)
    if place.size == 0:
        return None
    order = np.argsort(place, kind="stable")
    place, lag = place[order], lag[order]
    common = _scale(np.sort(lag), math.inf)
    if common is None or common > FLAT * (place[-1] - place[0]):
        return None
    ranges, sigmas = [], []
    middle = float(np.median(place[lag < PEAK_SIGMAS * common]))
    for first, stop in _bins(place, common):
        part, most = np.sort(lag[first:stop]), _most_of(common, middle, float(place[stop - 1]))
        part = part[: np.searchsorted(part, 2.0 * LEVEL_SIGMAS * most)]
        found = _scale(part, most) if part.size >= LEAST_PAIRS else None
        if found is not None and found >= common**2 / _most_of(common, float(place[first]), middle):
            ranges.append(float(np.median(place[first:stop][lag[first:stop] < PEAK_SIGMAS * found])))
            sigmas.append(found)
    if not ranges:
        ranges, sigmas = [middle], [common]
    return np.array(ranges), np.array(sigmas)


def _most_of(common: float, middle: float, range_mm: float) -> float:
    """Largest sigma, mm, at a range, mm, for a common one at `middle`, mm.

    The light of a surface falls with the square of range. If its own shot noise is all noise, sigma grows with range.

    References
    ----------
    Lange and Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448.
    """
    return WIDEST * common * (max(range_mm / middle, 1.0) if middle > 0.0 else 1.0)


def _bins(place: FloatArray, common: float) -> list[tuple[int, int]]:
    """Cut ascending places, mm, into bins `WIDE` of the range wide, or many sigmas: a narrow bin would cut peaks."""
    edges = [float(place[0])]
    while edges[-1] < place[-1]:
        edges.append(edges[-1] + max(WIDE * abs(edges[-1]), 4.0 * LEVEL_SIGMAS * common))
    cuts = np.searchsorted(place, edges[1:-1])
    return list(pairwise([0, *cuts.tolist(), len(place)]))


def _scale(lags: FloatArray, most: float) -> float | None:
    """Smallest sigma, mm, up to `most`, that equals the sigma of its peak in ascending lags, mm; None without one."""
    positive = lags[lags > 0]
    if positive.size < LEAST_IN_PEAK:
        return None
    low, high = 0.25 * float(np.quantile(positive, 0.001)) + 1e-6, min(float(positive[-1]), most)
    before = None
    for scale in np.exp(np.arange(math.log(low), math.log(max(high, 2 * low)), _GRID_STEP)):
        found = _peak(lags, scale)
        if found is not None and found <= scale and before is not None:
            # Between the two, the sigma equals that of its peak.
            for _ in range(20):
                again = _peak(lags, found)
                if again is None or abs(again - found) < 1e-3 * found:
                    break
                found = 0.5 * (again + found)
            return float(found)
        before = found if found is not None else before
    return None


def _peak(lags: FloatArray, scale: float) -> float | None:
    """Sigma, mm, of the peak over the level at larger lags; None without a peak."""
    if not scale > 0.0:
        return None
    near, far = np.searchsorted(lags, [PEAK_SIGMAS * scale, LEVEL_SIGMAS * scale], side="right")
    level = (far - near) / ((LEVEL_SIGMAS - PEAK_SIGMAS) * scale)
    excess = near - level * PEAK_SIGMAS * scale
    if near < LEAST_IN_PEAK or excess < max(LEAST_EXCESS * near, SIGNIFICANT_EXCESS * math.sqrt(far)):
        return None
    over = np.arange(1, near + 1) - level * lags[:near]
    at = int(np.argmax(over >= 0.5 * excess))
    return float(lags[at] / MEDIAN_OF_DIFFERENCE) if lags[at] > 0 else None
