"""sigma(r) where no pixel need see one surface: from the differences of samples of the same pixel.

Two samples of one surface differ by sqrt(2) sigma; samples of background, or of other surfaces, by more, at lags spread
widely. The density of |x_i - x_j| is a peak at small lags on a level. The level is taken off, and the median of what is
left is 0.954 sigma (that of a Gaussian's difference). Where surfaces lie a few sigma apart in every pixel, they widen
the peak: then the scale found is that of all of them together, and `learning` tries smaller ones too.
"""

import math
from itertools import pairwise

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.compiled.jit import jit

MEDIAN_OF_DIFFERENCE = 0.6744897501960817 * math.sqrt(2.0)
"""Median of |x_i - x_j| of a Gaussian, in sigmas."""

PEAK_SIGMAS, LEVEL_SIGMAS = 5.0, 10.0
"""Lags up to the first are the peak's; between the two, those of the level."""

PAIRS_A_SAMPLE = 16
"""Partners of each sample of a pixel, the next ones in time of its valid samples: a drift within them is small."""

MOST_PAIRS = 1_500_000
"""Differences of all pixels together, about: so many tell sigma to a fifth of a percent."""

LEAST_PAIRS = 2000
"""A bin of range with fewer differences tells no sigma."""

WIDE = 0.25
"""Width of a bin over its range."""

WIDEST = 5.0
"""Most that sigma at one range differs from the common one, as a factor."""

FLAT = 0.25
"""Samples of no surface are uniform: the scale of their differences is 0.31 of their span; a Gaussian's, below 0.2."""

LEAST_EXCESS = 0.02
"""Part of the differences that the peak must have over the level."""

_GRID_STEP = math.log(1.12)


@jit
def _differences(samples: Float32Array, partners: int, place: FloatArray, lag: FloatArray) -> int:
    """Fill `place` and `lag` with the middle and the absolute difference of pairs of a pixel's samples."""
    pixels, frames = samples.shape
    kept, count = np.empty(frames), 0
    for pixel in range(pixels):
        n = 0
        for frame in range(frames):
            x = samples[pixel, frame]
            if not math.isnan(x):
                kept[n] = x
                n += 1
        for a in range(n):
            for b in range(a + 1, min(a + 1 + partners, n)):
                place[count], lag[count] = 0.5 * (kept[a] + kept[b]), abs(kept[a] - kept[b])
                count += 1
    return count


def sigma_from_differences(samples_mm: Float32Array) -> tuple[FloatArray, FloatArray] | None:
    """sigma(r) from pairs of samples.

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
    length = some.size * partners
    place, lag = np.empty(length), np.empty(length)
    count = _differences(np.ascontiguousarray(some), partners, place, lag)
    if count < 1:
        return None
    order = np.argsort(place[:count], kind="stable")
    place, lag = place[:count][order], lag[:count][order]
    common = _scale(np.sort(lag), math.inf)
    if common is None or common > FLAT * (place[-1] - place[0]):
        return None
    ranges, sigmas = [], []
    for first, stop in _bins(place, common):
        part = np.sort(lag[first:stop])
        part = part[: np.searchsorted(part, 2.0 * LEVEL_SIGMAS * WIDEST * common)]
        found = _scale(part, WIDEST * common) if part.size >= LEAST_PAIRS else None
        if found is not None and found * WIDEST >= common:
            ranges.append(float(np.median(place[first:stop][lag[first:stop] < PEAK_SIGMAS * found])))
            sigmas.append(found)
    if not ranges:
        ranges, sigmas = [float(np.median(place[lag < PEAK_SIGMAS * common]))], [common]
    return np.array(ranges), np.array(sigmas)


def _bins(place: FloatArray, common: float) -> list[tuple[int, int]]:
    """Cut ascending places into bins, `WIDE` of the range and many sigmas wide: a narrow one cuts peaks in two."""
    edges = [float(place[0])]
    while edges[-1] < place[-1]:
        edges.append(edges[-1] + max(WIDE * abs(edges[-1]), 4.0 * LEVEL_SIGMAS * common))
    cuts = np.searchsorted(place, edges[1:-1])
    return list(pairwise([0, *cuts.tolist(), len(place)]))


def _scale(lags: FloatArray, most: float) -> float | None:
    """Smallest sigma, up to `most`, that is the scale of its own peak in ascending lags; None without one."""
    positive = lags[lags > 0]
    if positive.size < 10:  # noqa: PLR2004  fewer tell nothing
        return None
    low, high = 0.25 * float(np.quantile(positive, 0.001)) + 1e-6, min(float(positive[-1]), most)
    before = None
    for scale in np.exp(np.arange(math.log(low), math.log(max(high, 2 * low)), _GRID_STEP)):
        found = _peak(lags, scale)
        if found is not None and found <= scale and before is not None:
            # Between the two, the scale and that of its peak are equal.
            for _ in range(20):
                again = _peak(lags, found)
                if again is None or abs(again - found) < 1e-3 * found:
                    break
                found = 0.5 * (again + found)
            return float(found)
        before = found if found is not None else before
    return None


def _peak(lags: FloatArray, scale: float) -> float | None:
    """Sigma of the peak over the level at the lags past it; None where the level has it all."""
    if not scale > 0.0:
        return None
    near, far = np.searchsorted(lags, [PEAK_SIGMAS * scale, LEVEL_SIGMAS * scale], side="right")
    level = (far - near) / ((LEVEL_SIGMAS - PEAK_SIGMAS) * scale)
    excess = near - level * PEAK_SIGMAS * scale
    if near < 10 or excess < max(LEAST_EXCESS * near, 5.0 * math.sqrt(far)):  # noqa: PLR2004  as in `_scale`
        return None
    over = np.arange(1, near + 1) - level * lags[:near]
    at = int(np.argmax(over >= 0.5 * excess))
    return float(lags[at] / MEDIAN_OF_DIFFERENCE) if lags[at] > 0 else None
