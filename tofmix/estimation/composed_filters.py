"""Averages that take a jump at once, and averages of medians, found in the samples of a recording.

`tofmix.estimation.filters` calls `composed_filter` where it finds no simple filter. A trial is an average, its jump,
and the median before it. Its inverse must leave samples of one surface as dependent as running medians are, or
independent without a median; and it must explain samples better than noise with a memory does, and than independent
samples. Both are judged by mixtures of Gaussians, of the sigma that pixels of one surface have: after a jump, noise
with a memory goes on, and a filter has forgotten it. A further rival is noise with a memory that is larger in a pixel
of one surface, as on dark things: it spreads as near surfaces do.
"""

import math
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.compiled.vector import MAD_TO_SIGMA
from tofmix.temporal_filter import (
    AveragedMedians,
    ExponentialAverage,
    RunningMean,
    RunningMedian,
    TemporalFilter,
)


class Samples(NamedTuple):
    """Stored samples (pixel, frame) of pixels of several surfaces (*wide* ones) and of one, and their noise (pixel,).

    Noise is the central 90 % of the samples of one surface. `steps` are the lengths of all steps from frame to frame,
    ascending, also of other pixels; `step_mm` is the step of the stored ranges. `calm` are those of more pixels
    of one surface, whose correlations are compared.
    """

    stored: FloatArray
    noise: FloatArray
    is_wide: BoolArray
    steps: FloatArray
    step_mm: float
    calm: FloatArray

    def some(self, count: int) -> "Samples":
        """The same with about as many pixels of each kind."""
        kinds = (np.flatnonzero(self.is_wide), np.flatnonzero(~self.is_wide))
        kept = np.concatenate([kind[:: max(1, len(kind) // count)] for kind in kinds])
        return self._replace(stored=self.stored[kept], noise=self.noise[kept], is_wide=self.is_wide[kept])


class Trial(NamedTuple):
    """An average, and the window of the median before it (1: none)."""

    average: ExponentialAverage | RunningMean
    median: int

    @property
    def has_jumps(self) -> bool:
        """Whether the average takes jumps at once."""
        return isinstance(self.average, ExponentialAverage) and self.average.resets

    @property
    def is_simple(self) -> bool:
        """Whether it is an average alone."""
        return self.median == 1 and not self.has_jumps

    @property
    def found(self) -> TemporalFilter:
        """The filter."""
        return self.average if self.median == 1 else AveragedMedians(self.average, self.median)


def composed_filter(
    samples: Samples,
    exact: Callable[[float], ExponentialAverage | None] | None,
    *,
    medians: tuple[int, ...],
    means: tuple[int, ...],
    tolerance: float,
    agreeing: float,
) -> TemporalFilter | None:
    """The filter that explains samples best; None where none does, or a simple one that other samples tell better.

    Parameters
    ----------
    samples : Samples
        Of some pixels of each kind, without lost ones.
    exact : callable or None
        The average without jumps that explains pixels of several surfaces best, near some share of the new sample.
        None where surfaces are so near that their noise tells it better; simple filters are then found here, too.
    medians, means : tuple of int
        Windows that are tried.
    tolerance : float
        Difference of the correlations of undone samples from those of a filter that rounding explains.
    agreeing : float
        Least share of the pixels that the inverse explains better.
    """
    few = 8  # pixels that may show a filter
    some = samples.some(3 * few)
    trials = list(_trials(some, exact, medians, means, tolerance))
    if not trials:
        return None
    score = {trial: float(_explained(trial, some).mean()) for trial in trials}
    rivals = _rivals(samples)
    without = [trial for trial in score if not trial.has_jumps]
    plain = max(without, key=score.__getitem__) if without else None
    best = _refined(max(score, key=score.__getitem__), samples)
    if best.has_jumps:
        others = rivals if plain is None else np.maximum(rivals, _explained(plain, samples))
        if _explains(best, samples, others, np.asarray(_jumps(best, samples).any(axis=1)), agreeing):
            return best.found
    if plain is None or (plain.is_simple and exact is not None):
        return None
    return plain.found if _explains(plain, samples, rivals, samples.is_wide, agreeing) else None


def _explains(trial: Trial, samples: Samples, rivals: FloatArray, telling: BoolArray, agreeing: float) -> bool:
    """Whether telling pixels (pixel,) are explained better than by rivals (pixel,), beyond chance."""
    gain = (_explained(trial, samples) - rivals)[telling]
    few, least_sds = 8, 4.0  # pixels that may show a filter; of the mean gain: it is the largest of some hundred trials
    if len(gain) < few or np.mean(gain > 0.0) < agreeing:
        return False
    return bool(gain.mean() > least_sds * gain.std() / math.sqrt(len(gain)))


def _jumps(trial: Trial, samples: Samples) -> BoolArray:
    """Steps (pixel, frame) that the average takes at once."""
    average = trial.average
    if not isinstance(average, ExponentialAverage):
        return np.zeros(samples.stored[:, 1:].shape, np.bool_)
    return np.abs(np.diff(samples.stored, axis=1)) > average.edge_mm


def _trials(
    samples: Samples,
    exact: Callable[[float], ExponentialAverage | None] | None,
    medians: tuple[int, ...],
    means: tuple[int, ...],
    tolerance: float,
) -> Iterator[Trial]:
    """Filters whose inverse leaves calm pixels as dependent as the median before the average does."""
    calm = samples.calm
    windows, frames = (1, *medians), calm.shape[1]
    as_stored = _correlations(calm)
    behind = {
        length
        for length in means
        for window in windows
        if np.abs(as_stored - _correlations_of_medians(window, length, frames)).max() <= tolerance
    }
    averages: list[ExponentialAverage | RunningMean] = [RunningMean(float(length)) for length in sorted(behind)]
    for share in np.geomspace(0.05, 0.9, 43).tolist():
        averages.append(ExponentialAverage(share))
        averages += [ExponentialAverage(share, threshold_mm) for threshold_mm in _jumps_between(share, samples)]
    fits = [_fit(average, calm, windows, samples.step_mm) for average in averages]
    least = dict.fromkeys(windows, tolerance)  # least difference of the correlations, by median
    for fit in fits:
        least[fit.trial.median] = min(least[fit.trial.median], fit.off)
    alike = 0.04  # differences of the correlations that chance explains
    for fit in fits:
        average, window = fit.trial
        if fit.off > min(tolerance, least[window] + alike):
            continue
        if isinstance(average, RunningMean) or average.resets:
            yield fit.trial
            continue
        if exact is not None and (precise := exact(average.parameter)) is not None:
            yield _fit(precise, calm, windows, samples.step_mm).trial
        if fit.off <= min(least[window], min(least.values()) + alike) and (exact is None or window > 1):
            yield _by_correlation(fit, calm, windows, samples.step_mm)


class _Fit(NamedTuple):
    """A trial, and the difference of the correlations of its undone samples from those of its medians."""

    trial: Trial
    off: float


def _fit(average: ExponentialAverage | RunningMean, calm: FloatArray, windows: tuple[int, ...], step_mm: float) -> _Fit:
    """The median before an average that suits the correlations of calm pixels (pixel, frame) best."""
    undone = _undone(average, calm)
    undone = undone[np.isfinite(undone).all(axis=1)]
    if not len(undone):
        return _Fit(Trial(average, 1), math.inf)
    seen = _correlations(undone)
    steps = _two_digits(step_mm / max(float(np.median(calm.std(axis=1))), 1e-9))  # per sd of stored ranges
    off = {
        window: float(np.abs(seen - _correlations_of_undone(average, window, calm.shape[1], steps)).max())
        for window in windows
    }
    window = min(off, key=off.__getitem__)
    return _Fit(Trial(average, window), off[window])


def _by_correlation(fit: _Fit, calm: FloatArray, windows: tuple[int, ...], step_mm: float) -> Trial:
    """The trial with the share of the new sample near its own that suits the correlations best."""
    near = fit.trial.average.parameter * np.geomspace(0.93, 1.07, 15)  # to the next shares that are tried, in 1 %
    fits = [fit, *(_fit(ExponentialAverage(share), calm, windows, step_mm) for share in near.tolist() if share < 1.0)]
    return min((one for one in fits if one.trial.median == fit.trial.median), key=lambda one: one.off).trial


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


def _jumps_between(share: float, samples: Samples) -> list[float]:
    """Some jumps d that an average may take at once: hardly a step is between its share of d and d."""
    steps, step_mm = samples.steps, samples.step_mm
    least, most = max(float(np.median(steps)), 1e-3), float(steps[-1])
    if least >= share * most:
        return []
    jumps = np.geomspace(least / share, most, 40)
    low, high = share * jumps + step_mm, jumps - step_mm  # rounding moves a step by as much
    between = np.searchsorted(steps, high) - np.searchsorted(steps, low)
    spoilt = 0.002  # share of the steps that lost samples may put there
    allowed = np.flatnonzero((low < high) & (between <= spoilt * len(steps)))
    return [float(jump) for jump in jumps[allowed[np.linspace(0, len(allowed) - 1, min(len(allowed), 6)).astype(int)]]]


def _undone(average: ExponentialAverage | RunningMean, stored: FloatArray) -> FloatArray:
    """Samples (pixel, frame - 1) before an average."""
    frames = stored.T.astype(np.float32)
    found = average.likeliest(frames) if isinstance(average, RunningMean) else average.independent(frames, 0)
    return np.asarray(found.T[:, 1:], dtype=np.float64)


def _correlation(samples: FloatArray, lag: int) -> float:
    """Median over pixels (pixel, frame) of the correlation of samples `lag` frames apart."""
    away = samples - samples.mean(axis=1, keepdims=True)
    products = (away[:, lag:] * away[:, :-lag]).mean(axis=1)
    return float(np.median(products / np.maximum((away * away).mean(axis=1), 1e-12)))


def _correlations(samples: FloatArray) -> FloatArray:
    """The same at the first lags."""
    return np.array([_correlation(samples, lag) for lag in range(1, min(12, samples.shape[1] - 2) + 1)])


@lru_cache(maxsize=128)
def _correlations_of_medians(median: int, mean: int, frames: int) -> FloatArray:
    """The same of independent samples behind a running median, then a running mean."""
    return _correlations(_drawn(median, mean, frames))


@lru_cache(maxsize=512)
def _correlations_of_undone(
    average: ExponentialAverage | RunningMean, median: int, frames: int, steps: float
) -> FloatArray:
    """The same of running medians behind an average that is stored on steps, in its sds, and undone.

    Rounding is enlarged by the inverse: of an exponential average, where it takes no jump, by 1 / a and (1 - a) / a.
    """
    medians = _correlations_of_medians(median, 1, frames)
    if isinstance(average, RunningMean):
        fine, few = 0.05, 100  # a step that changes no correlation by more than 0.04; pixels
        if steps < fine:
            return medians
        means = _drawn(median, average.window, frames)[:few]
        width = steps * means.std()
        return _correlations(_undone(average, np.rint(means / width) * width))
    kept = 1.0 - average.parameter
    every = np.concatenate([[1.0], medians])
    lags = np.arange(len(every))
    spread = every @ (np.where(lags, 2.0, 1.0) * kept**lags)  # of the average, over that of medians, by a / (2 - a)
    unit = steps**2 / 12.0 * spread * average.parameter / (2.0 - average.parameter) / average.parameter**2
    whole = 1.0 + unit * (1.0 + kept**2)
    out = medians / whole
    out[0] -= unit * kept / whole
    return np.asarray(out)


def _drawn(median: int, mean: int, frames: int) -> FloatArray:
    """Independent samples (pixel, frame) behind a running median, then a running mean."""
    drawn = np.random.default_rng(20080922).standard_normal((400, frames + median + mean - 2))
    medians = np.median(np.lib.stride_tricks.sliding_window_view(drawn, median, axis=1), axis=-1)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(medians, mean, axis=1).mean(axis=-1))


def _explained(trial: Trial, samples: Samples) -> FloatArray:
    """Mean log density (pixel,) of stored samples by those before a filter, nat a sample."""
    undone = _undone(trial.average, samples.stored)
    known: BoolArray = np.asarray(np.isfinite(undone).all(axis=1))
    share = trial.average.parameter if isinstance(trial.average, ExponentialAverage) else 1.0 / trial.average.parameter
    averaged = np.asarray(1.0 - _jumps(trial, samples).mean(axis=1))
    slope = math.log(share) * averaged
    nats = np.full(len(undone), -math.inf)
    if known[~samples.is_wide].any():
        sigma = _sigma(undone[known], samples.noise[known], samples.is_wide[known])
        nats[known] = _of_medians(trial, undone[known], sigma, samples.step_mm).mean(axis=1) - slope[known]
    return np.where(np.isfinite(nats), nats, np.min(nats, where=np.isfinite(nats), initial=-20.0))


def _of_medians(trial: Trial, medians: FloatArray, sigma: FloatArray, step_mm: float) -> FloatArray:
    """Log density (pixel, n) of medians (pixel, n) by a mixture, or as the same sample as the one before.

    Ranges that differ by the rounding of the inverse are the same sample.
    """
    nats = _fitted(medians, sigma)[2]
    if trial.median == 1:
        return nats
    least_part = 0.02  # of the noise: the inverse is not exact
    same = np.maximum(math.sqrt(2.0) * _rounding_mm(trial.average, step_mm), least_part * sigma)[:, np.newaxis]
    z = np.diff(medians, axis=1) / same
    again = -0.5 * z * z - np.log(math.sqrt(2.0 * math.pi) * same)
    share = RunningMedian(float(trial.median)).tie(1)
    nats[:, 1:] = np.logaddexp(math.log(share) + again, math.log(1.0 - share) + nats[:, 1:])
    return nats


def _rounding_mm(average: ExponentialAverage | RunningMean, step_mm: float) -> float:
    """Sd of undone values by the rounding of stored ones; of a mean, about that of one change along a chain."""
    if isinstance(average, RunningMean):
        return average.window * step_mm / math.sqrt(12.0)
    return average.rounding_mm(step_mm)


def _rivals(samples: Samples) -> FloatArray:
    """Mean log density (pixel,) by other reasons for the samples; the best.

    They are independent, their noise has a memory, their ranges wander, or noise with a memory is a pixel's own.
    """
    stored, noise, is_wide = samples.stored, samples.noise, samples.is_wide
    sigma = _sigma(stored, noise, is_wide)
    memory = _correlation(stored[~is_wide], 1)
    from_surface = stored - _surface(stored, sigma)
    goes_on = stored[:, 1:] - memory * from_surface[:, :-1]
    wanders = np.diff(stored, axis=1)
    kinds = [_of_mixture(kind, _sigma(kind, noise, is_wide)) for kind in (stored[:, 1:], goes_on, wanders)]
    return np.asarray(np.max([*kinds, _of_own_noise(stored, memory, is_wide)], axis=0))


def _of_own_noise(stored: FloatArray, memory: float, is_wide: BoolArray) -> FloatArray:
    """Mean log density (pixel,) of samples of one surface each, whose noise is that of the others times a factor.

    A mixture of three surfaces has three numbers more, which explain something of any samples (Schwarz 1978).
    """
    away = stored - stored.mean(axis=1, keepdims=True)
    new = away[:, 1:] - memory * away[:, :-1]
    scale = np.maximum(MAD_TO_SIGMA * np.median(np.abs(new), axis=1, keepdims=True), 1e-9)
    edges, floor = np.linspace(-8.0, 8.0, 81), 1e-5  # of the density of others, in their sds
    density = np.maximum(np.histogram((new / scale)[~is_wide], bins=edges, density=True)[0], floor)
    further, best = 1.5 * math.log(new.shape[1]) / new.shape[1], np.full(len(new), -math.inf)
    for factor in np.geomspace(0.8, 1.25, 7):  # about the scale that the median tells
        cell = np.clip(np.searchsorted(edges, new / (factor * scale)) - 1, 0, len(density) - 1)
        best = np.maximum(best, (np.log(density[cell]) - np.log(factor * scale)).mean(axis=1))
    return np.asarray(best + further)


def _sigma(values: FloatArray, noise: FloatArray, is_wide: BoolArray) -> FloatArray:
    """Sigma (pixel,) of values (pixel, n): that of pixels of one surface, in proportion to their noise."""
    calm = values[~is_wide]
    away = np.abs(calm - np.median(calm, axis=1, keepdims=True)) / noise[~is_wide, np.newaxis]
    return np.asarray(max(MAD_TO_SIGMA * float(np.median(away)), 1e-3) * noise)


def _fitted(values: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means (pixel, 3), responsibilities (pixel, n, 3) and log density (pixel, n) of three Gaussians of a sigma.

    A small share is uniform over the values.
    """
    rounds, random = 20, 0.01
    mean = np.quantile(values, (0.05, 0.5, 0.95), axis=1).T
    weight = np.full_like(mean, (1.0 - random) / mean.shape[1])
    wide = np.maximum(np.ptp(values, axis=1), 6.0 * sigma)[:, np.newaxis]
    for _ in range(rounds):
        z = (values[:, :, np.newaxis] - mean[:, np.newaxis]) / sigma[:, np.newaxis, np.newaxis]
        density = np.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * sigma[:, np.newaxis, np.newaxis])
        density *= weight[:, np.newaxis]
        total = density.sum(axis=2) + random / wide
        part = density / total[:, :, np.newaxis]
        members = part.sum(axis=1)
        weight = (1.0 - random) * members / np.maximum(members.sum(axis=1, keepdims=True), 1e-12)
        mean = np.where(
            members > 1e-6,  # noqa: PLR2004  no sample is its
            (part * values[:, :, np.newaxis]).sum(axis=1) / np.maximum(members, 1e-6),
            mean,
        )
    return mean, part, np.log(total)


def _of_mixture(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """Mean log density (pixel,) of values (pixel, n) under the likeliest mixture of up to three surfaces."""
    return np.asarray(_fitted(values, sigma)[2].mean(axis=1))


def _surface(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """The surface (pixel, n) that each value is of, by its expectation."""
    mean, part, _ = _fitted(values, sigma)
    found = (part * mean[:, np.newaxis]).sum(axis=2) / np.maximum(part.sum(axis=2), 1e-12)
    return np.where(part.sum(axis=2) > 0.5, found, values)  # noqa: PLR2004  others are random


def _refined(trial: Trial, samples: Samples) -> Trial:
    """The trial with the jump amid those that samples allow."""
    average = trial.average
    if not isinstance(average, ExponentialAverage) or not average.resets:
        return trial
    below, above = np.split(samples.steps, [int(np.searchsorted(samples.steps, average.edge_mm, side="right"))])
    if below.size and above.size and 0.0 < below[-1] / average.parameter < above[0]:
        between = math.sqrt(float(below[-1]) / average.parameter * float(above[0]))
        average = ExponentialAverage(average.parameter, between)
    return Trial(average, trial.median)
