"""Series of one pixel's samples in time, and the statistics that give its noise without a noise curve.

Use it through `noise`. A series is one pixel in one run of consecutive frames. Its trend in time (drift, a surface that
moves) is removed by a polynomial, samples far off are set aside, and the residuals have a variance and a shape. For
Gaussian noise the shape is independent of the variance (Basu's theorem), so that series may be picked by their shape as
strictly as one likes and the variance stays unbiased.

Where no pixel sees one surface alone, the differences between samples of a pixel give sigma(r). The difference of two
samples of one surface has the standard deviation sqrt(2) sigma. Differences to background or to other surfaces are
larger and spread widely. So the density of |x_i - x_j| is a peak at small differences on a level. The level is
subtracted; the median of the rest is 0.954 sigma, that of a Gaussian's difference. Surfaces that are a few sigmas apart
in every pixel widen the peak: `sigma_curve` then tries smaller sigmas too.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.recording import AmplitudeSource, SampleSource, amplitude_source

SEED = 20080922
"""Seed of every random draw that an estimate makes: the same recording gives the same noise and the same layers."""

SERIES_FRAMES = 100
"""Frames of a series: long enough to determine a shape, short enough for drift to be a polynomial."""

LEAST_SAMPLES = 10
"""Fewest valid samples of a series."""

TREND_DEGREES = ((50, 4), (20, 2), (0, 1))
"""Degree of a series' trend, from so many samples on: a warm-up within the series is followed."""

CLIP_SIGMAS = 6.0
"""Samples farther from the trend than this, in robust sigmas, are set aside."""

LEAST_KEPT = 0.7
"""A series of which a smaller share is left then sees more than one surface."""


_BLOCK = 1 << 18  # samples that are worked on at once: they stay in the processor's cache
_USUAL_LIMITS = (
    (0.9302248796326201, 1.6889123682259486, 5.122634928518553),
    (0.8639173947030889, 1.76993153084951, 5.023172992937566),
    (0.8271469963715202, 1.8827364505541437, 5.294696054000337),
    (0.7558968262130039, 1.9551637430103475, 5.264482573247904),
    (0.7240518611684393, 2.0236067956425425, 5.340089293801905),
    (0.6224684312356144, 2.1422577745111373, 4.929194596168365),
    (0.5405905415422962, 2.2449379157020015, 4.7971653734575295),
    (0.4505866119825002, 2.3434151544142314, 4.496646635809754),
    (0.39264421766454194, 2.418978396851784, 4.383696594306362),
)
"""Limits of the usual strictness for each of `_SHAPE_SIZES`, as `drawn_limits` gives them: each takes it 50 ms."""
_SHAPE_SIZES = (10, 13, 17, 20, 26, 34, 50, 70, 100)  # samples of a series; limits in between are interpolated


class Series(NamedTuple):
    """Series of samples.

    `samples` (series, frame) float32 in mm, NaN where invalid; `pixel` (series,), the number of the pixel they are of;
    `amplitude` (series,), the median of their amplitudes above 0, NaN where none is known.
    """

    samples: Float32Array
    pixel: IntArray
    amplitude: FloatArray


class SeriesStatistics(NamedTuple):
    """Statistics of each series, all of the shape (series,).

    `valid` samples, of which `kept` are near the trend; `range_mm`, their median; `variance` about the trend, mm^2,
    unbiased for independent samples; `skewness`, `kurtosis` of them (0 and 3 for a Gaussian); `memory`, their
    correlation from one frame to the next. Where there are fewer than `LEAST_SAMPLES`, `kept` is 0.
    """

    valid: IntArray
    kept: IntArray
    range_mm: FloatArray
    variance: FloatArray
    skewness: FloatArray
    kurtosis: FloatArray
    memory: FloatArray


def read_series(source: SampleSource, *, most: int = 1 << 17) -> Series:
    """Take series from a recording: all pixels up to `most`, in as many runs of frames as that allows.

    Runs are spread evenly over the recording. Of larger images every k-th row is taken. The selection depends on the
    recording's sizes alone. It is read band by band; 131,072 series take 52 MB.
    """
    frames, rows, cols = source.shape
    length = min(frames, SERIES_FRAMES)
    step = max(1, math.ceil(rows * cols / most))
    chosen = np.arange(0, rows, step)
    runs = max(1, min(frames // length, most // (len(chosen) * cols)))
    starts = np.linspace(0, frames - length, runs).astype(int)
    return read_runs(source, starts.tolist(), length, chosen, amplitude_source(source))


def read_runs(
    source: SampleSource,
    starts: Sequence[int],
    length: int,
    chosen: IntArray,
    amplitudes: AmplitudeSource | None,
) -> Series:
    """Series of `length` frames from each of `starts` on, of the pixels of the chosen rows, ascending.

    Runs come one after the other, each in the order of its pixels. They are read band by band of stored rows.
    """
    _, rows, cols = source.shape
    band = max(1, source.row_step)
    parts, pixels, medians = [], [], []
    for start in starts:
        for first in range(0, rows, band):
            wanted = chosen[(chosen >= first) & (chosen < first + band)]
            if wanted.size:
                block = slice(start, start + length), slice(first, min(first + band, rows))
                parts.append(source.read_range(*block)[:, wanted - first].reshape(length, -1).T.copy())
                pixels.append((wanted[:, None] * cols + np.arange(cols)).ravel())
                if amplitudes is None:
                    medians.append(np.full(len(pixels[-1]), np.nan))
                else:
                    read = amplitudes.read_amplitude(*block)[:, wanted - first].reshape(length, -1).T
                    medians.append(_medians(np.where(np.isfinite(parts[-1]), read, np.nan)))
    return Series(np.concatenate(parts), np.concatenate(pixels).astype(np.int64), np.concatenate(medians))


def _medians(amplitude: Float32Array) -> FloatArray:
    """Median of the finite values above 0 of each row; NaN without any.

    `np.nanmedian` gives the same, one row after the other, and is slower.
    """
    ordered = np.sort(np.where(np.isfinite(amplitude) & (amplitude > 0), amplitude, np.nan), axis=1)  # NaN last
    count = np.isfinite(ordered).sum(axis=1)
    row = np.arange(len(ordered))
    low, high = ordered[row, np.maximum(count - 1, 0) // 2], ordered[row, count // 2]
    return np.asarray(0.5 * (low.astype(np.float64) + high), dtype=np.float64)


def quantisation_step(samples_mm: Float32Array) -> float:
    """Step between neighbouring stored ranges, mm: that of the densest tenth; tiny where ranges are continuous."""
    values = samples_mm[np.abs(samples_mm) <= FARTHEST_MM]
    resolution_mm = 0.01  # finer steps are not told from none
    distinct = np.unique(np.rint(values.astype(np.float64) / resolution_mm))
    if distinct.size < 3:  # noqa: PLR2004  two values may be any distance apart
        return resolution_mm
    gaps = np.diff(distinct) * resolution_mm
    # A step that is no whole number of mm is stored as two gaps by turns: their mean is the step.
    return float(gaps[gaps <= 1.5 * np.quantile(gaps, 0.1)].mean())


def trend_degree(n: int) -> int:
    """Degree of the polynomial that is taken out of `n` samples."""
    for least, degree in TREND_DEGREES:
        if n >= least:
            return degree
    return 1


def _series_statistics(samples: Float32Array, step: float) -> SeriesStatistics:
    count, frames = samples.shape
    with np.errstate(invalid="ignore"):
        valid = (np.abs(samples) <= FARTHEST_MM).sum(axis=1)
    out = SeriesStatistics(valid, np.zeros(count, np.int64), *(np.zeros(count) for _ in range(5)))
    enough = valid >= LEAST_SAMPLES
    degree_of = np.array([trend_degree(n) for n in range(frames + 1)])[valid]
    for degree in np.unique(degree_of[enough]):
        rows = np.flatnonzero(enough & (degree_of == degree))
        most = max(1, _BLOCK // frames)
        for start in range(0, len(rows), most):
            _fill_statistics(samples, rows[start : start + most], int(degree), step, out)
    return out


def _fill_statistics(samples: Float32Array, rows: IntArray, degree: int, step: float, out: SeriesStatistics) -> None:
    """Fill the statistics of some series, whose trend is a polynomial of one degree."""
    frames, n = samples.shape[1], out.valid[rows]
    raw = samples[rows].astype(np.float64)
    known = np.ones(raw.shape, dtype=np.bool_)
    frame = np.broadcast_to(np.arange(frames), raw.shape)
    if n.min() < frames:
        with np.errstate(invalid="ignore"):
            known = np.abs(raw) <= FARTHEST_MM
        frame = np.argsort(~known, axis=1, kind="stable")[:, : int(n.max())]  # valid samples first, in their order
        known = np.arange(frame.shape[1]) < n[:, None]
        raw = np.where(known, np.take_along_axis(raw, frame, axis=1), 0.0)
    time = 2.0 * frame / frames - 1.0
    powers = np.stack([time**a for a in range(degree + 1)])
    centre = _middle(raw, known)
    values = np.where(known, raw - centre[:, None], 0.0)
    trend, keep = np.zeros(values.shape), known
    rounds = 4  # of fitting a trend and setting samples aside
    for _ in range(rounds):
        rest = values - trend
        away = np.abs(rest - _middle(rest, known)[:, None])
        spread = MAD_TO_SIGMA * _middle(away, known)
        # Few samples have a rough median deviation: the limit is wider for them.
        limit = np.maximum(CLIP_SIGMAS * spread * (1.0 + 5.0 / n), 2.0 * step)
        keep = known & (away <= limit[:, None])
        trend = _fit_trends(powers, values, keep)
    rest = np.where(keep, values - trend, 0.0)
    square, left = rest * rest, keep.sum(axis=1)
    m2, m3, m4 = square.sum(axis=1), (square * rest).sum(axis=1), (square * square).sum(axis=1)
    good = left >= np.maximum(degree + 3, LEAST_KEPT * n)
    at, m2, m3, m4, left = rows[good], m2[good], m3[good], m4[good], left[good]
    lagged = (rest[good, 1:] * rest[good, :-1]).sum(axis=1)
    out.kept[at], out.range_mm[at] = left, centre[good] + _middle(values[good], keep[good])
    out.variance[at] = m2 / (left - degree - 1)
    moves = m2 > 0.0
    mean = m2[moves] / left[moves]
    out.skewness[at[moves]] = m3[moves] / left[moves] / mean**1.5
    out.kurtosis[at[moves]] = m4[moves] / left[moves] / mean**2
    out.memory[at[moves]] = lagged[moves] / m2[moves]


def _middle(values: FloatArray, known: BoolArray) -> FloatArray:
    """Median of the known values of each row (row, n), of which there are some."""
    count, row = known.sum(axis=1), np.arange(len(values))
    if (count == values.shape[1]).all():
        return np.asarray(np.median(values, axis=1))
    ordered = np.sort(np.where(known, values, np.inf), axis=1)
    return np.asarray(0.5 * (ordered[row, (count - 1) // 2] + ordered[row, count // 2]))


def _fit_trends(powers: FloatArray, values: FloatArray, keep: BoolArray) -> FloatArray:
    """Least-squares polynomial through the kept values of each row (row, n); `powers` (degree + 1, row, n)."""
    kept = np.where(keep, powers, 0.0)
    normal = np.einsum("arn,brn->rab", kept, powers, optimize=True)
    # Frames that are all in one place leave the trend to a tiny ridge, not to a division by zero.
    normal += 1e-9 * np.eye(len(powers))
    right = np.einsum("arn,rn->ra", kept, values)
    solution = np.linalg.solve(normal, right[..., None])[..., 0]
    return np.asarray(np.einsum("ra,arn->rn", solution, powers))


def series_statistics(series: Series, step_mm: float) -> SeriesStatistics:
    """Statistics of each series; `step_mm` is the result of `quantisation_step`."""
    return _series_statistics(series.samples, step_mm)


def _limits_of_shape(index: int, strictness: float) -> tuple[float, float, float]:
    """Largest absolute skewness, least and largest kurtosis of Gaussian series of `_SHAPE_SIZES[index]` samples."""
    usual_strictness = 0.1  # of `NoiseSettings`
    return _USUAL_LIMITS[index] if strictness == usual_strictness else drawn_limits(index, strictness)


@lru_cache(maxsize=64)
def drawn_limits(
    index: int,
    strictness: float,
    *,
    trials: int = 2000,  # simulated Gaussian series for each size
) -> tuple[float, float, float]:
    """The limits of series of `_SHAPE_SIZES[index]` samples, from drawn ones."""
    rng = np.random.default_rng(SEED)
    for n in _SHAPE_SIZES[: index + 1]:  # all sizes share one stream: the draws of the smaller ones come first
        gaussian = rng.standard_normal((trials, n))
    drawn = _series_statistics(gaussian.astype(np.float32), 0.0)
    skewness = np.quantile(np.abs(drawn.skewness), 1.0 - strictness)
    least, largest = np.quantile(drawn.kurtosis, (strictness, 1.0 - 0.1 * strictness))
    return float(skewness), float(least), float(largest)


def shaped_as_one(statistics: SeriesStatistics, strictness: float) -> BoolArray:
    """Which series have the shape of one Gaussian.

    Two surfaces that overlap make a sample flat (low kurtosis) or lopsided. The limits are those that Gaussian series
    of as many samples pass, from a simulation with a fixed seed: a share `strictness` of them fails each of the two.
    A tenth of that fails for long tails.
    """
    size = np.clip(statistics.kept, _SHAPE_SIZES[0], _SHAPE_SIZES[-1])
    # Only the sizes around those that occur: each costs as much as 2000 pixels.
    below = np.searchsorted(_SHAPE_SIZES, size[statistics.kept > 0], side="right") - 1
    used = np.union1d(below, np.minimum(below + 1, len(_SHAPE_SIZES) - 1)).astype(int)
    if used.size == 0:
        return np.zeros(size.shape, dtype=np.bool_)
    limits = np.array([_limits_of_shape(int(index), strictness) for index in used])
    skew, flat, long = (np.interp(size, np.take(_SHAPE_SIZES, used), column) for column in limits.T)
    fits = (np.abs(statistics.skewness) <= skew) & (statistics.kurtosis >= flat) & (statistics.kurtosis <= long)
    return np.asarray(fits & (statistics.kept > 0), dtype=np.bool_)


def memory_correction(memory: float, n: int) -> float:
    """Factor on the variance of `n` samples whose noise is AR(1), from their correlation from frame to frame.

    A trend takes out slow noise as well, and more of it the longer the noise remembers. Both the variance and the
    correlation that are left have known means, traces of M R with M the projection and R the correlation matrix; the
    coefficient is the one that gives `memory`. 1 where there is no memory.
    """
    degree = trend_degree(n)
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n), degree + 1))
    project = np.eye(n) - basis @ basis.T
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    coefficients = np.linspace(0.0, 0.9, 46)
    left, lagged = [], []
    for coefficient in coefficients:
        rest = project @ coefficient**apart @ project
        left.append(float(np.trace(rest)))
        lagged.append(float(np.trace(rest, offset=1)) / left[-1])
    found = float(np.interp(memory, lagged, coefficients))  # lagged rises with the coefficient
    return (n - degree - 1) / float(np.interp(found, coefficients, left))


MEDIAN_OF_DIFFERENCE = NormalDist().inv_cdf(0.75) * math.sqrt(2.0)
"""Median of |x_i - x_j| of a Gaussian, in sigmas."""

PEAK_SIGMAS, LEVEL_SIGMAS = 5.0, 10.0
"""Differences up to the first are the peak's, those between the two the level's, in sigmas."""


LEAST_IN_PEAK = 10
"""Least differences of a peak."""


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
    pairs_a_sample = 16  # pairs of each sample, with the next valid ones of its pixel: a drift over them is small
    partners = min(pairs_a_sample, max(samples_mm.shape[1] - 1, 1))
    most_pairs = 1_500_000  # about the most differences of all pixels: they determine sigma to a fifth of a percent
    some = samples_mm[:: 1 + samples_mm.size * partners // most_pairs]
    place, lag = _differences(some, partners)
    if place.size == 0:
        return None
    order = np.argsort(place, kind="stable")
    place, lag = place[order], lag[order]
    common = _scale(np.sort(lag), math.inf)
    flat = 0.25  # largest sigma by the span of the samples: uniform samples have 0.31, those of a surface less than 0.2
    if common is None or common > flat * (place[-1] - place[0]):
        return None
    ranges, sigmas = [], []
    middle = float(np.median(place[lag < PEAK_SIGMAS * common]))
    least_pairs = 1000  # least differences in a bin of range: those of 60 samples, which tell sigma to a tenth
    for first, stop in _bins(place, common):
        part, most = np.sort(lag[first:stop]), _most_of(common, middle, float(place[stop - 1]))
        part = part[: np.searchsorted(part, 2.0 * LEVEL_SIGMAS * most)]
        found = _scale(part, most) if part.size >= least_pairs else None
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
    # Largest factor between sigma in a bin and the common one, where sigma grows at most as range does (`_most_of`).
    widest = 5.0
    return widest * common * (max(range_mm / middle, 1.0) if middle > 0.0 else 1.0)


def _bins(place: FloatArray, common: float) -> list[tuple[int, int]]:
    """Cut ascending places, mm, into bins a quarter of the range wide, or many sigmas: a narrow bin would cut peaks."""
    edges = [float(place[0])]
    while edges[-1] < place[-1]:
        edges.append(edges[-1] + max(0.25 * abs(edges[-1]), 4.0 * LEVEL_SIGMAS * common))
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
    least_excess = 0.02  # least part of the differences that the peak has over the level
    # Least excess of a peak over the level, in standard errors of the number of differences up to `LEVEL_SIGMAS`.
    significant_excess = 5.0
    if near < LEAST_IN_PEAK or excess < max(least_excess * near, significant_excess * math.sqrt(far)):
        return None
    over = np.arange(1, near + 1) - level * lags[:near]
    at = int(np.argmax(over >= 0.5 * excess))
    return float(lags[at] / MEDIAN_OF_DIFFERENCE) if lags[at] > 0 else None
