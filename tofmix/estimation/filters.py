"""The temporal filter of a camera, found in the samples of a recording.

Use `learn_filter` before noise is learnt. A filter is common to all pixels, and shows in three ways:

- *Linear filters*: pixels of several surfaces (*wide* ones) and pixels of one surface have the same correlation from
  frame to frame, as a filter takes samples of noise and of surfaces alike. Noise with a memory, 1/f noise, drift and
  the jitter of whole frames correlate the noise only: wide pixels change from one surface to another without memory.
  A surface that moves correlates wide pixels only.
- *Medians* repeat values: the same sample is the median of several windows, in a known share of frames.
- *Held values* repeat them too, and never come back: a driver that is read faster than the camera measures.

An average is taken for granted only if its inverse explains wide pixels better than independent samples and better than
ranges that wander: by the entropy of the samples, given those before. Of several averages, that one is taken whose
inverse explains them best.

Layers of independent samples behind a temporal filter, as layers of the samples before it.

`layer_pixels` calls `layers_before_filter` last. Averages and means are undone in the samples: their layers stay as
they are.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.bounds import AtLeastTwo, Count, Factor, Share, checked
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.estimation.composed_filters import Samples, composed_filter
from tofmix.estimation.noise.series import quantisation_step, read_runs
from tofmix.estimation.samples import FARTHEST_MM
from tofmix.layers import Layers
from tofmix.recording import SampleSource, samples_a_frame
from tofmix.sensor import Sensor
from tofmix.temporal_filter import (
    ApartMedians,
    ExponentialAverage,
    HeldValues,
    RunningMean,
    RunningMedian,
    TemporalFilter,
)


def layers_before_filter(layers: Layers, sensor: Sensor) -> None:
    """Change layers of the leading shape (pixel,) in place, if the camera has a filter.

    Medians: shares and ranges become those of the samples (`RunningMedian`).
    """
    found = sensor.temporal_filter
    if found is not None and found.median is not None:
        _before_median(layers, sensor, found.median)


def _before_median(layers: Layers, sensor: Sensor, median: RunningMedian | ApartMedians) -> None:
    """Shares and ranges before a median; errors by the spread and dependence of seen samples.

    Sigma is the curve's: a fit of sigma follows the spread of seen samples, which differs between surfaces.
    """
    curve = sensor.noise
    if curve is not None:
        there = np.isfinite(layers.range)  # a curve of one point has a sigma even where there is no range
        sigma = np.where(there, curve.sigma(layers.range.astype(np.float64)), np.nan).astype(np.float32)
        layers.range_stderr[:] *= sigma / layers.sigma
        layers.sigma[:] = sigma
    shares, order = _ordered_shares(layers, sensor)
    whole = np.maximum(shares.sum(axis=1, keepdims=True), 1e-12)
    found, slope = median.shares_of_samples(np.take_along_axis(shares, order, axis=1) / whole)
    back = np.argsort(order, axis=1)
    new, factor = (np.take_along_axis(part, back, axis=1) for part in (found * whole, slope))
    present = np.isfinite(layers.weight)
    layers.weight[:] = np.where(present, new[:, :-1], layers.weight)
    layers.weight_stderr[:] *= factor[:, :-1].astype(np.float32)
    layers.weight_no_return[:] = np.where(np.isfinite(layers.weight_no_return), new[:, -1], layers.weight_no_return)
    ends = np.concatenate([np.zeros((len(found), 1)), np.cumsum(found, axis=1)], axis=1).clip(0.0, 1.0)
    for pixel, layer in np.argwhere(present).tolist():
        place = back[pixel, layer]
        mean, _ = median.moments(float(ends[pixel, place]), float(ends[pixel, place + 1]))
        layers.range[pixel, layer] -= np.float32(mean * layers.sigma[pixel, layer])
    dependence = median.dependence()
    layers.range_stderr[:] *= np.float32(median.moments(0.0, 1.0)[1] * math.sqrt(dependence))
    layers.weight_stderr[:] *= np.float32(math.sqrt(dependence))


def _ordered_shares(layers: Layers, sensor: Sensor) -> tuple[FloatArray, IntArray]:
    """Shares (pixel, n) of the layers and of no return, 0 where there is none, and their order from near to far."""
    none = sensor.no_return_mm if sensor.no_return_mm is not None else sensor.range_max_mm
    far = np.full((len(layers.range), 1), np.inf if none is None else none)
    at = np.concatenate([np.where(np.isfinite(layers.range), layers.range, np.inf).astype(np.float64), far], axis=1)
    shares = np.concatenate([layers.weight, layers.weight_no_return[:, None]], axis=1)
    return np.nan_to_num(shares.astype(np.float64)), np.argsort(at, axis=1, kind="stable")


@checked
class FilterSettings(NamedTuple):
    """Numbers of the search for a filter.

    Parameters
    ----------
    frames, pixels : int
        Most frames and about how many pixels are read.
    least_frames, least_pixels : int
        Fewest frames, and fewest wide pixels that may show a linear filter.
    valid : float
        Least share of valid samples of a pixel.
    wide, near : float
        Spread of a wide pixel, in spreads of the pixels of its range; of one that may see near surfaces, where few are
        wide.
    least_correlation, correlation_tolerance : float
        Least correlation of a filter from frame to frame, in both kinds of pixels; difference between the two that
        their means, which are removed, and rounding explain.
    undone_tolerance : float
        Difference of the correlations of undone samples from those of running medians that rounding explains.
    agreeing : float
        Least share of the wide pixels that the inverse explains better.
    windows, mean_windows : tuple of int
        Windows of medians and of means that are tried.
    most_ties, tie_tolerance, tie_spread : float
        Most samples that equal another by chance for a pixel to show medians; tolerance of the share of repeated
        values; most spread of the share of pixels that repeat theirs over frames: frames that are stored twice have
        more, and show no filter.
    """

    frames: AtLeastTwo = 128
    pixels: Count = 4096
    least_frames: AtLeastTwo = 20
    least_pixels: Count = 8
    valid: Share = 0.9
    wide: Factor = 4.0
    near: Factor = 1.5
    least_correlation: Share = 0.1
    correlation_tolerance: Share = 0.2
    undone_tolerance: Share = 0.15
    agreeing: Share = 0.75
    windows: tuple[AtLeastTwo, ...] = (3, 5, 7, 9)
    mean_windows: tuple[AtLeastTwo, ...] = tuple(range(2, 17))
    most_ties: Share = 0.2
    tie_tolerance: Share = 0.06
    tie_spread: Share = 0.15


DEFAULT_SETTINGS = FilterSettings()

_LAGS = 12  # frames apart, of repeated values


def learn_filter(source: SampleSource, settings: FilterSettings = DEFAULT_SETTINGS) -> TemporalFilter | None:
    """The filter of the camera; None where the samples show none.

    Parameters
    ----------
    source : SampleSource
        The recording, as it is stored. Its first frames are read, in rows spread over the image.
    settings : FilterSettings, optional
        Numbers of the search.

    Returns
    -------
    TemporalFilter or None
        None, too, for recordings of several targets a frame or of few frames.
    """
    stored = _stored(source, settings)
    if not len(stored):
        return None
    found = None
    if not _stored_twice(stored, settings):
        found = _median_filter(stored, settings) or _linear_filter(stored, settings)
    if found is None and (repeats := _repeats(stored, settings)) is not None:
        return HeldValues(repeats.share)
    if isinstance(found, RunningMedian) or _stored_twice(stored, settings):
        return found
    return _composed(stored, settings) or found


class Repeats(NamedTuple):
    """Samples that repeat the one before."""

    share: float  # of the samples, beyond chance
    frames: float  # share of the frames that repeat as a whole


def find_repeats(source: SampleSource, settings: FilterSettings = DEFAULT_SETTINGS) -> Repeats | None:
    """The repeats of a recording whose camera filters nothing over time; None where there are few beyond chance."""
    return _repeats(_stored(source, settings), settings)


def _repeats(stored: FloatArray, settings: FilterSettings) -> Repeats | None:
    """The repeats of samples (pixel, frame).

    Samples that are no repeats differ from those before as samples far apart do. Noise with a memory has small
    differences as often as none.
    """
    if len(stored) < settings.least_pixels or np.mean(stored[:, 1:] == stored[:, :-1]) < settings.least_correlation:
        return None
    # Pixels chosen for few ties at one lag have too few of them there, and as many as by chance at any other
    change, chosen_by, far = (np.abs(stored[:, lag:] - stored[:, :-lag]) for lag in (1, _LAGS, _LAGS + 1))
    told = (chosen_by == 0.0).mean(axis=1) < settings.most_ties
    if told.sum() < settings.least_pixels:
        return None
    change, far = change[told], far[told]
    near = np.nanmedian(far, axis=1, keepdims=True)
    chance, by_near = float(np.mean(far == 0.0)), float(np.mean((far > 0.0) & (far <= near)))
    share = (float(np.mean(change == 0.0)) - chance) / (1.0 - chance)
    of_others = float(np.mean((change > 0.0) & (change <= near))) / by_near
    if share < settings.least_correlation or abs(1.0 - share - of_others) > settings.tie_tolerance:
        return None
    return Repeats(share, float(np.mean((change == 0.0).mean(axis=0) >= settings.valid)))


def common_motion(source: SampleSource, settings: FilterSettings = DEFAULT_SETTINGS) -> tuple[float, float] | None:
    """How far all ranges of a frame move together, and how far those of one pixel move beside that, frame by frame.

    Two standard deviations, mm, by the differences of consecutive frames: a drift is none of it, and one jump neither.
    The common one is beyond what pixels that are independent have in common by chance. None where few pixels tell.
    """
    stored = _stored(source, settings)
    if len(stored) < settings.least_pixels:
        return None
    change = np.diff(stored, axis=1)
    common = np.nanmedian(change, axis=0)
    alone = float(np.median(_spread(change - common, axis=1))) / math.sqrt(2.0)
    together = float(_spread(common, axis=0)) / math.sqrt(2.0)
    of_medians = math.pi / 2.0 / len(stored)  # variance of a median of Gaussian values
    return math.sqrt(max(together**2 - of_medians * alone**2, 0.0)), alone


def _spread(values: FloatArray, axis: int) -> FloatArray:
    """Standard deviation along an axis, by the median absolute deviation."""
    middle = np.nanmedian(values, axis=axis, keepdims=True)
    return np.asarray(MAD_TO_SIGMA * np.nanmedian(np.abs(values - middle), axis=axis))


def _stored(source: SampleSource, settings: FilterSettings) -> FloatArray:
    """Samples (pixel, frame) of the first frames of pixels spread over the image; of no pixel where they tell nothing.

    Recordings of several targets a frame, or of few frames, tell nothing.
    """
    frames, rows, cols = source.shape
    if samples_a_frame(source) > 1 or frames < settings.least_frames:
        return np.zeros((0, frames))
    every = max(1, math.ceil(rows * cols / settings.pixels))
    chosen = np.arange(every // 2 if rows > every // 2 else 0, rows, every)
    stored = read_runs(source, [0], min(frames, settings.frames), chosen, None).samples.astype(np.float64)
    with np.errstate(invalid="ignore"):
        stored[~(np.abs(stored) <= FARTHEST_MM)] = np.nan
    stored = stored[np.isfinite(stored).mean(axis=1) >= settings.valid]
    return np.asarray(stored[np.nanmax(stored, axis=1) > np.nanmin(stored, axis=1)]) if len(stored) else stored


def _stored_twice(stored: FloatArray, settings: FilterSettings) -> bool:
    """Whether whole frames of samples (pixel, frame) repeat the one before."""
    same = stored[:, 1:] == stored[:, :-1]
    told = same.mean(axis=1) > 0.0
    return bool(told.sum() >= settings.least_pixels and same[told].mean(axis=0).std() > settings.tie_spread)


def _median_filter(stored: FloatArray, settings: FilterSettings) -> RunningMedian | None:
    """The median whose repeated values the samples (pixel, frame) have."""
    length = stored.shape[1]
    lags = range(1, min(_LAGS, length - 1) + 1)
    ties = np.array([np.mean(stored[:, lag:] == stored[:, :-lag], axis=1) for lag in lags])  # (lag, pixel)
    far_lags = 4  # the last of them: no window is as long
    chance = ties[-far_lags:].mean(axis=0)
    told = chance < settings.most_ties
    if told.sum() < settings.least_pixels:
        return None
    base = chance[told].mean()
    excess = (ties[:, told].mean(axis=1) - base) / (1.0 - base)
    returns = _returns(stored[told], 2) - np.mean([_returns(stored[told], lag) for lag in lags[-far_lags:]])
    for window in settings.windows:
        found = RunningMedian(float(window))
        expected = np.array([found.tie(lag) for lag in lags])
        # A median comes back to a value that it left; a value that is held does not.
        comes_back = returns > 0.5 * (1.0 - base) * found.returns()
        if comes_back and np.abs(excess - expected).max() <= settings.tie_tolerance:
            return found
    return None


def _returns(stored: FloatArray, lag: int) -> float:
    """Share of the samples (pixel, frame) that equal the one `lag` frames before, which the next one differed from."""
    before = stored[:, :-lag]
    return float(np.mean((stored[:, lag:] == before) & (stored[:, 1 : 1 - lag] != before)))


def _composed(stored: FloatArray, settings: FilterSettings) -> TemporalFilter | None:
    """The average that takes jumps at once, or that of medians, of samples (pixel, frame).

    Where few pixels are wide, those that see near surfaces tell the filter, also an average or a mean alone.
    """
    low, middle, high = _quantiles(stored, (0.05, 0.5, 0.95))
    spread = high - low
    noise = _noise_of_range(middle, spread)
    whole = np.isfinite(stored).all(axis=1) & (noise > 0.0)
    wide, calm = (np.flatnonzero(whole & part) for part in (spread > settings.wide * noise, spread <= 2.0 * noise))
    if len(calm) < settings.least_pixels or (memory := _correlation(stored[calm], 1)) < settings.least_correlation:
        return None
    if is_near := len(wide) < settings.least_pixels:
        new = stored[:, 1:] - memory * stored[:, :-1]  # their spread has more independent values
        low, high = _quantiles(new, (0.05, 0.95))
        broad = high - low > settings.near * _noise_of_range(middle, high - low)
        wide, calm = np.flatnonzero(whole & broad), np.flatnonzero(whole & ~broad)
        if min(len(wide), len(calm)) < settings.least_pixels:
            return None
    chosen = np.concatenate([part[_few(len(part), settings)] for part in (wide, calm)])
    return composed_filter(
        Samples(
            stored=stored[chosen],
            noise=noise[chosen],
            is_wide=np.arange(len(chosen)) < min(len(wide), 8 * settings.least_pixels),
            steps=np.sort(np.abs(np.diff(stored[whole], axis=1)).ravel()),
            step_mm=quantisation_step(stored[calm].astype(np.float32)),
            calm=stored[calm[:: max(1, len(calm) // ((64 if is_near else 16) * settings.least_pixels))]],
        ),
        None if is_near else lambda share: _exponential(stored[wide], noise[wide], 1.0 - share, settings),
        medians=settings.windows,
        means=settings.mean_windows,
        tolerance=settings.undone_tolerance,
        agreeing=settings.agreeing,
    )


def _linear_filter(stored: FloatArray, settings: FilterSettings) -> TemporalFilter | None:
    """The exponential average or the mean that wide and other pixels (pixel, frame) share."""
    low, middle, high = _quantiles(stored, (0.05, 0.5, 0.95))
    spread = high - low
    noise = _noise_of_range(middle, spread)
    wide = spread > settings.wide * noise
    calm = spread <= 2.0 * noise
    if wide.sum() < settings.least_pixels or calm.sum() < settings.least_pixels:
        return None
    lags = range(1, min(_LAGS, stored.shape[1] - 2) + 1)
    least, tolerance = settings.least_correlation, settings.correlation_tolerance
    first = [_correlation(stored[which], 1) for which in (wide, calm)]  # without a filter there is none
    if min(first) < least or abs(first[0] - first[1]) > tolerance:
        return None
    at_edges, elsewhere = (np.array([_correlation(stored[which], lag) for lag in lags]) for which in (wide, calm))
    found = _exponential(stored[wide], noise[wide], float(at_edges[0]), settings)
    trials: list[ExponentialAverage | RunningMean] = [] if found is None else [found]
    for window in settings.mean_windows:
        expected = _triangular(window, lags, stored.shape[1])
        if max(np.abs(seen - expected).max() for seen in (at_edges, elsewhere)) <= tolerance:
            trials.append(RunningMean(float(window)))
    return _explaining(trials, stored[wide], noise[wide], stored[calm], settings)


def _triangular(window: int, lags: range, frames: int) -> FloatArray:
    """Correlation (lag,) of means over a window, less the mean of so many frames."""
    every = np.clip(1.0 - np.arange(frames) / window, 0.0, None)
    of_mean = (1.0 + 2.0 * float((every * (1.0 - np.arange(frames) / frames))[1:].sum())) / frames
    return np.asarray((every[list(lags)] - of_mean) / max(1.0 - of_mean, 1.0 / frames))


def _explaining(
    trials: list[ExponentialAverage | RunningMean],
    wide: FloatArray,
    noise: FloatArray,
    calm: FloatArray,
    settings: FilterSettings,
) -> ExponentialAverage | RunningMean | None:
    """The filter whose inverse explains wide pixels (pixel, frame) of some noise (pixel,) best, if it explains both.

    A filter takes a share of the new sample: its inverse enlarges the ranges' entropy by that factor at most.
    """
    whole = np.isfinite(wide).all(axis=1)
    wide, noise = wide[whole], noise[whole]
    if len(wide) < settings.least_pixels:
        return None
    wide, noise, calm = (part[_few(len(part), settings)] for part in (wide, noise, calm))
    rivals = np.minimum(_entropy(wide[:, 1:], noise), _entropy(np.diff(wide, axis=1), noise))
    best, least = None, math.inf
    for trial in trials:
        share = trial.parameter if isinstance(trial, ExponentialAverage) else 1.0 / trial.parameter
        undone, quiet = (_undone(trial, part)[:, 1:] for part in (wide, calm))
        known = np.isfinite(undone).all(axis=1)
        entropy = np.where(known, _entropy(undone, noise / share) + math.log(share), np.inf)
        agrees = np.mean(entropy < rivals) >= settings.agreeing
        if agrees and abs(_correlation(quiet, 1)) <= settings.correlation_tolerance and np.median(entropy) < least:
            best, least = trial, float(np.median(entropy))
    return best


def _few(count: int, settings: FilterSettings) -> IntArray:
    """Pixels of so many that stand for all: spread over them."""
    return np.linspace(0, count - 1, min(count, 8 * settings.least_pixels)).astype(np.int64)


def _undone(trial: ExponentialAverage | RunningMean, stored: FloatArray) -> FloatArray:
    """Independent samples (pixel, frame) of stored ones."""
    frames = stored.T.astype(np.float32)
    found = trial.likeliest(frames) if isinstance(trial, RunningMean) else trial.independent(frames, 0)
    return np.asarray(found.T, dtype=np.float64)


def _quantiles(samples: FloatArray, shares: tuple[float, ...]) -> list[FloatArray]:
    """Order statistics (pixel,) of the valid samples (pixel, frame) at some shares."""
    ordered = np.sort(samples, axis=1)  # NaN last
    count = np.isfinite(samples).sum(axis=1)
    row = np.arange(len(samples))
    return [ordered[row, np.rint(share * (count - 1)).astype(int)] for share in shares]


def _noise_of_range(range_mm: FloatArray, spread: FloatArray) -> FloatArray:
    """Spread (pixel,) of pixels of one surface at each pixel's range: the lower quartile of its neighbours in range.

    Between two surfaces all neighbours may be mixed. Noise changes slowly with range, so a quartile is at most
    1.5 times a line through all of them: its slope is the median over pairs of groups.
    """
    order = np.argsort(range_mm, kind="stable")
    # pixels of similar range, whose lower quartile of spreads is the noise
    groups = np.array_split(order, max(1, len(order) // 64))
    at = np.array([np.median(range_mm[group]) for group in groups])
    level = np.log(np.maximum([np.quantile(spread[group], 0.25) for group in groups], 1e-6))
    first, second = np.triu_indices(len(groups), 1)
    apart = at[second] - at[first]
    slopes = (level[second] - level[first])[apart > 0.0] / apart[apart > 0.0]
    slope = float(np.median(slopes)) if slopes.size else 0.0
    line = slope * at + np.median(level - slope * at)
    out = np.empty(len(order))
    # noise of a range over the line through all ranges, at most
    for group, noise in zip(groups, np.minimum(level, line + math.log(1.5)), strict=True):
        out[group] = math.exp(noise)
    return out


def _correlation(samples: FloatArray, lag: int) -> float:
    """Median over pixels (pixel, frame) of the correlation of samples `lag` frames apart, each pixel's mean removed."""
    known = np.isfinite(samples)
    mean = np.where(known, samples, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    away = np.where(known, samples - mean[:, None], 0.0)
    pairs = np.maximum((known[:, lag:] & known[:, :-lag]).sum(axis=1), 1)
    products = (away[:, lag:] * away[:, :-lag]).sum(axis=1) / pairs
    return float(np.median(products / np.maximum((away * away).sum(axis=1) / np.maximum(known.sum(axis=1), 1), 1e-12)))


def _exponential(
    wide: FloatArray, noise: FloatArray, correlation: float, settings: FilterSettings
) -> ExponentialAverage | None:
    """The exponential average whose inverse explains wide pixels (pixel, frame) of some noise (pixel,) best."""
    before, change = wide[:, :-1], np.diff(wide, axis=1)
    known = np.isfinite(change).all(axis=1)
    before, change, noise = before[known], change[known], noise[known]
    if len(change) < settings.least_pixels:
        return None
    few = _few(len(change), settings)
    low, high = (np.clip(1.0 - correlation + d, 0.02, 0.98) for d in (-settings.correlation_tolerance, 0.1))
    # Samples move by d ln a times (x - y): half a sigma at most from one trial to the next.
    ratio = float(np.quantile(np.ptp(wide[known], axis=1) / noise, 0.9))
    step = 0.5  # step of the search for a, in the sigmas by which samples of the widest pixel move
    count = int(math.log(high / low) * ratio / step) + 2
    trials = np.geomspace(low, high, min(count, 4000))
    entropies = np.array(
        [np.median(_entropy(before[few] + change[few] / a, noise[few] / a) + math.log(a)) for a in trials]
    )
    share = float(trials[np.argmin(entropies)])
    for _ in range(3):
        share = _refined(before, change, noise, share)
        if not low <= share <= high:
            return None
    return ExponentialAverage(share) if 0.0 < share < 1.0 else None


def _entropy(values: FloatArray, noise: FloatArray) -> FloatArray:
    """Entropy (pixel,), nat a sample, of independent values (pixel, n) by their spacings (Vasicek 1976).

    A spacing is at least a small part of the noise (pixel,), so that equal values are not infinitely dense.
    """
    n = values.shape[1]
    reach = max(1, round(math.sqrt(n)) // 2)
    ordered = np.sort(values, axis=1)
    spacing = ordered[:, 2 * reach :] - ordered[:, : -2 * reach]
    least_spreads = 0.1  # spreads of the noise: the resolution of the density
    return np.asarray(np.log(spacing + least_spreads * noise[:, None]).mean(axis=1) + math.log(n / (2 * reach)))


def _refined(before: FloatArray, change: FloatArray, noise: FloatArray, share: float) -> float:
    """The share a of the new sample by least squares: y_t - y_(t-1) = a (x - y_(t-1)), where x is a mean in each heap.

    The noise of a sample is independent of y_(t-1). Heaps are those of the samples at the present share, parted by gaps
    of several sigmas. `noise` is the central 90 % of filtered ranges.
    """
    sigma = noise / 3.3 * math.sqrt((2.0 - share) / share)
    values = before + change / share
    order = np.argsort(values, axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    cut = np.diff(ordered, axis=1) > 5.0 * sigma[:, None]
    heap = np.concatenate([np.zeros((len(values), 1), np.int64), np.cumsum(cut, axis=1)], axis=1)
    label = np.empty_like(heap)
    np.put_along_axis(label, order, heap + np.arange(len(values))[:, None] * values.shape[1], axis=1)
    _, group = np.unique(label.ravel(), return_inverse=True)
    weight = np.broadcast_to(sigma[:, None] ** -2, values.shape).ravel()
    members = np.bincount(group)
    base, slope = (_about_heap(part.ravel(), group, members) for part in (before, change))
    few = 3  # samples that make a heap
    used = (members[group] >= few) & _near(values.ravel(), group, members, np.repeat(sigma, values.shape[1]))
    along = float((weight * base * base)[used].sum())
    found = -float((weight * base * slope)[used].sum()) / along if along > 0.0 else share
    return min(max(found, 1e-6), 1.0)


def _about_heap(values: FloatArray, group: IntArray, members: IntArray) -> FloatArray:
    """Values less the mean of their heap."""
    return np.asarray(values - (np.bincount(group, values) / members)[group])


def _near(values: FloatArray, group: IntArray, members: IntArray, sigma: FloatArray) -> BoolArray:
    """Values within some sigmas of their heap's mean: heaps of several surfaces are left out sample by sample."""
    return np.asarray(np.abs(_about_heap(values, group, members)) < 6.0 * sigma)
