"""Steps 1 and 2: compare a recording with a model by normal scores, and find where they disagree most.

The score of a sample is its probability integral transform under the predicted distribution of its pixel, mapped to a
standard normal. If the model is right, scores are standard normal. `tofmix.reconciliation.comparison.panel` computes
the statistics of the scores.

In step 2 each curve of the panel is scanned over all intervals of its bins. The p-value of the best interval is
corrected for all intervals and curves (Bonferroni), so it is conservative.

The places are ranked by the information of each curve that curves of lower order do not contain. A wrong mean also
changes spread, skew and tails, on every axis. So means come first, in mm: over each axis of the pixels, over frames and
over time. Means are removed before spreads are computed, and both before skew and tails. The gain of an axis is that of
the marginal likelihood of a Gaussian effect over its bins, with a free variance. So an axis of many bins must explain
more.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr
from scipy.stats import norm

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconciliation.comparison.panel import (
    Axis,
    Curve,
    discreteness,
    invalid,
    neighbours,
    panel_axes,
    shapes,
    widths,
)
from tofmix.reconciliation.comparison.panel_parts import bridging, burst_share, in_time, lines
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import lag_product, memory_of, one_surface, whitened
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.reconciliation.likelihood.wander import FARTHEST_SCORE

STRUCTURED = 0.15
"""Least share of the gain of single pixels at which an axis is the place."""


_LAGS = (1, 2, 3)  # frames

Information = dict[tuple[str, str], float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scored:
    """Scores (frame, pixel), 0 where `ok` is false, with the axes.

    Parameters
    ----------
    z : (frame, pixel) float32
        Normal scores.
    ok : (frame, pixel) bool
        Valid samples.
    sigma : (pixel,) float64
        The model's, mm.
    axes : tuple of Axis
        Bins of the pixels.
    pixels : (pixel,) int64
        Their numbers in the image.
    image : (int, int)
        Rows, columns.
    frames : (frame,) int64
        Numbers of the frames.
    """

    z: Float32Array
    ok: BoolArray
    sigma: FloatArray
    axes: tuple[Axis, ...]
    pixels: IntArray
    image: tuple[int, int]
    frames: IntArray


def gain(chi2: float, dof: int) -> float:
    """Gain in marginal likelihood, nats, of a Gaussian effect of free variance over bins with this sum of squares."""
    ratio = chi2 / max(dof, 1)
    return 0.5 * dof * (ratio - 1 - float(np.log(ratio))) if ratio > 1 else 0.0


def information(s: Scored) -> Information:
    """Gain (nats) by statistic and axis, beyond lower orders.

    Parameters
    ----------
    s : Scored
        Scores of the held-out part.
    """
    out: Information = {}
    weight = (1.0 / s.sigma).astype(np.float32) * float(np.median(s.sigma))
    seen = np.where(s.ok, weight**2, np.float32(0))
    mass = (seen.sum(axis=0, dtype=np.float64), seen.sum(axis=1, dtype=np.float64))
    pull = s.z * weight
    out |= _over("bias", s, pull, mass, names=("common_mode", "trend"))
    s = _within_reach(s)
    rest = _without_means(s, weight)
    count = (s.ok.sum(axis=0).astype(np.float64), s.ok.sum(axis=1).astype(np.float64))
    square = np.where(s.ok, (rest * rest - 1) / np.float32(np.sqrt(2)), np.float32(0))
    out |= _over("spread", s, square, count, names=("bursts", "spread"))
    rest = _without_spreads(rest, s.ok)
    out |= dict(_linked(rest, s))
    third = (rest * rest - 3) * rest / np.float32(np.sqrt(6))
    few = np.float32(6.0 / (len(rest) + 1))  # bias of a kurtosis whose mean and spread are those of the sample
    fourth = np.where(s.ok, (rest**2 * (rest**2 - 6) + 3 + few) / np.float32(np.sqrt(24)), np.float32(0))
    out |= _over("skew", s, third, count, names=("", ""))
    out |= _over("tails", s, fourth, count, names=("", ""))
    return out


def _over(
    name: str, s: Scored, values: Float32Array, mass: tuple[FloatArray, FloatArray], *, names: tuple[str, str]
) -> Information:
    """One statistic over all axes: its values (frame, pixel), with variances by pixel and by frame."""
    by_pixel, by_frame = values.sum(axis=0, dtype=np.float64), values.sum(axis=1, dtype=np.float64)
    single = _chi2(by_pixel, mass[0])
    found = {(name, axis.name): _binned(axis.bin, by_pixel, mass[0]) for axis in s.axes}
    tenths = 10  # parts of the time, for slow changes
    tenth = np.arange(len(by_frame)) * tenths // max(len(by_frame), 1)
    if names[0]:
        found[names[0], "frame"] = _chi2(by_frame, mass[1])
        found[names[1], "time"] = _binned(tenth, by_frame, mass[1])
    return _ranked(name, found, single)


def _ranked(name: str, found: dict[tuple[str, str], tuple[float, int]], single: tuple[float, int]) -> Information:
    """Gains by axis; an axis that adds little to the gain of `all` comes after `all`."""
    gains = {key: gain(*value) for key, value in found.items()}
    common = gains[name, "all"]
    everywhere = 0.05  # part, of the gain of `all`, that an axis must add to be the place instead of `all`
    for key, value in gains.items():
        if key != (name, "all") and value < (1 + everywhere) * common:
            gains[key] = min(value, common) * (1 - everywhere)
    of_pixels = {key: value for key, value in gains.items() if key[0] == name and key[1] != "time"}
    best = max(of_pixels, key=lambda key: of_pixels[key])
    structured = (found[best][0] - found[best][1]) > STRUCTURED * (single[0] - single[1])
    pattern = min(gain(*single), 0.99 * gains[best]) if structured else gain(*single)
    return gains | {("pattern" if name == "bias" else f"{name}_pattern", "all"): pattern}


def _chi2(total: FloatArray, mass: FloatArray) -> tuple[float, int]:
    some = mass > 0
    return float((total[some] ** 2 / mass[some]).sum()), int(some.sum())


def _binned(bins: IntArray, total: FloatArray, mass: FloatArray) -> tuple[float, int]:
    return _chi2(np.bincount(bins, total).astype(np.float64), np.bincount(bins, mass).astype(np.float64))


def _within_reach(s: Scored) -> Scored:
    """Without pixels with a large mean: their scores are clipped, so they have no valid spread."""
    mean = np.abs(s.z.sum(axis=0)) / np.maximum(s.ok.sum(axis=0), 1)
    reach = 2.0  # largest mean, in sigma, of a pixel with a valid spread: scores beyond 4 count as 4
    ok = s.ok & (mean < reach)
    return replace(s, z=np.where(ok, s.z, np.float32(0)), ok=ok)


def _without_means(s: Scored, weight: Float32Array) -> Float32Array:
    """Scores without each pixel's mean and each frame's bias in mm, of unit variance."""
    n = np.maximum(s.ok.sum(axis=0), 2)
    rest = np.where(s.ok, s.z - s.z.sum(axis=0) / n, np.float32(0))
    mass = np.where(s.ok, weight**2, np.float32(0)).sum(axis=1)
    least = 1e-9  # weight of a pixel
    bias = (rest * weight).sum(axis=1) / np.maximum(mass, least)
    rest -= np.where(s.ok, bias[:, None].astype(np.float32) * weight, np.float32(0))
    return np.asarray(rest * np.sqrt(n / (n - 1.0)), dtype=np.float32)


def _without_spreads(rest: Float32Array, ok: BoolArray) -> Float32Array:
    """Scaled to unit variance in each pixel, then in each frame."""
    for axis in (0, 1):
        n = np.maximum(ok.sum(axis=axis, keepdims=True), 1)
        level = np.sqrt((rest * rest).sum(axis=axis, keepdims=True, dtype=np.float64) / n)
        rest = (rest / np.maximum(level, 1e-3)).astype(np.float32)
    return rest


def _linked(rest: Float32Array, s: Scored) -> Iterator[tuple[tuple[str, str], float]]:
    """Memory from frame to frame; common biases of lines; correlation of neighbours."""
    yield ("memory", "frame"), gain(sum(_pairs(rest, s, lag) for lag in _LAGS), len(_LAGS))
    rows, cols = s.image
    cube: Float32Array = np.zeros((len(rest), rows * cols), dtype=np.float32)
    cube[:, s.pixels] = rest
    image = cube.reshape(-1, rows, cols)
    seen: BoolArray = np.zeros((len(rest), rows * cols), dtype=bool)
    seen[:, s.pixels] = s.ok
    valid = seen.reshape(-1, rows, cols)
    for axis, name in ((2, "row"), (1, "col")):
        total, n = image.sum(axis=axis, dtype=np.float64), valid.sum(axis=axis).astype(np.float64)
        yield ("common_mode", name), gain(*_chi2(total.ravel(), n.ravel()))
    for axis, name in ((2, "col"), (1, "row")):
        now, then = _halves(image, axis)
        both = int(np.logical_and(*_halves(valid, axis)).sum())
        yield ("neighbour_correlation", name), gain(float((now * then).sum(dtype=np.float64)) ** 2 / max(both, 1), 1)


def _halves(image: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    n = image.shape[axis]
    return np.take(image, range(1, n), axis=axis), np.take(image, range(n - 1), axis=axis)


def _pairs(rest: Float32Array, s: Scored, lag: int) -> float:
    n, product = lag_product(rest, s.ok, lag, s.frames)
    return (product + n / max(len(rest), 1)) ** 2 / max(n, 1)


def of_losses(lost: BoolArray, expected: FloatArray, axes: Iterable[Axis]) -> Information:
    """Gains by axis of invalid samples beyond the predicted ones, all samples with the same variance.

    Parameters
    ----------
    lost : (frame, pixel) bool
        Invalid samples.
    expected : (pixel,) float64
        The predicted share of them.
    axes : iterable of Axis
        Bins of the pixels.
    """
    share = float(np.clip(max(lost.mean(), expected.mean()), 1.0 / max(lost.size, 1), 0.5))
    one = share * (1 - share)
    frames, pixels = lost.shape
    by_pixel = lost.sum(axis=0) - frames * expected
    by_frame = lost.sum(axis=1) - expected.sum()
    mass = np.full(pixels, frames * one)
    found = {("invalid", axis.name): _binned(axis.bin, by_pixel, mass) for axis in axes}
    found["invalid", "frame"] = _chi2(by_frame, np.full(frames, pixels * one))
    gains = _ranked("invalid", found, _chi2(by_pixel, mass))
    return {key: value for key, value in gains.items() if key[0] == "invalid"}


def information_of(
    z: Float32Array, evidence: Evidence, m: Mixture, part: Part, *, measured: bool = False
) -> Information:
    """All gains of a part's scores (frame, pixel), NaN where invalid."""
    fine = 48  # number of bins of axes that are divided by quantiles; changes within a bin are lost
    axes = tuple(panel_axes(evidence, m, part, bins=fine, measured=measured))
    ok = np.isfinite(z)
    scored = Scored(
        z=np.where(ok, z, np.float32(0)),
        ok=ok,
        sigma=m.of_main(m.sigma)[part[1]],
        axes=axes,
        pixels=part[1],
        image=evidence.image,
        frames=part[0],
    )
    lost = evidence.samples[part[0]][:, part[1]] == 0
    return information(scored) | of_losses(lost, m.invalid[0][part[1]], axes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compared:
    """The statistics of a part's scores."""

    curves: tuple[Curve, ...]
    pattern: FloatArray  # (recording, pixel) mean score, NaN outside the part
    part: Part

    @property
    def gap(self) -> float:
        """Root mean square of the panel's distances; noise alone gives 1."""
        return float(np.sqrt(np.mean([c.distance**2 for c in self.curves])))


def compare(
    likelihood: Likelihood, state: ModelState, part: Part, *, seed: int, mixture: Mixture | None = None
) -> Compared:
    """Compare a part of a recording with a state.

    Parameters
    ----------
    likelihood : Likelihood
        The recording and the scene.
    state : ModelState
        The model with the effects added so far.
    part : (frames, pixels)
        Samples to compare. They must be held out of every fit, or the gap is too small. Each recording has separate
        curves.
    seed : int
        For the draws within cells of whole mm.
    mixture : Mixture, optional
        That of the state, if it was computed before.
    """
    m = likelihood.mixture(state) if mixture is None else mixture
    memory = memory_of(state)
    scored = (np.arange(likelihood.evidence.shape[0]), part[1]) if memory else part
    z = likelihood.scores(state, scored, seed, m)
    curves: list[Curve] = []
    pattern = np.full((len(likelihood.evidence.starts), likelihood.evidence.shape[1]), np.nan)
    for view in views(likelihood, m, part):
        own = z[view.frames] if not memory else whitened(z[view.frames], view.mixture, memory)
        own = np.clip(own[view.part[0]][:, view.part[1]], -FARTHEST_SCORE, FARTHEST_SCORE)
        gains = information_of(own, view.evidence, view.mixture, view.part, measured=state.errors is not None)
        crossed = any(e.links_neighbours for e in (*view.scene.effects, *state.effects))
        apart = _apart(own, view) if crossed else own
        curves += [
            replace(c.varying, recording=view.number, information=gains.get((c.statistic, c.axis)))
            for c in _curves(own, apart, view, state)
        ]
        with np.errstate(invalid="ignore"):
            pattern[view.number, part[1]] = np.nansum(own, axis=0) / np.maximum(np.isfinite(own).sum(axis=0), 1)
    return Compared(curves=tuple(curves), pattern=pattern, part=part)


def _apart(z: Float32Array, view: RecordingView) -> Float32Array:
    """Scores without pixels that see several surfaces, or that have such a neighbour.

    With crosstalk, neighbouring scores are correlated, because they show which surface was drawn.
    """
    alone = one_surface(view.mixture).reshape(view.evidence.image)
    framed = np.pad(alone, 1, mode="edge")
    alone = alone & framed[:-2, 1:-1] & framed[2:, 1:-1] & framed[1:-1, :-2] & framed[1:-1, 2:]
    return np.where(alone.ravel()[view.part[1]], z, np.float32(np.nan))


def _curves(z: Float32Array, apart: Float32Array, view: RecordingView, state: ModelState) -> Iterator[Curve]:
    """The panel of one recording's scores (frame, pixel); `apart` are the scores for correlations."""
    evidence, m, part = view.evidence, view.mixture, view.part
    axes = list(panel_axes(evidence, m, part, measured=state.errors is not None))
    yield from shapes(z, axes, m, state, part, view.number)
    yield from widths(state, view.scene.model.sensor.noise.width_spread, view.number)
    together = 0.0 if state.errors is None else state.errors.frame_noise**2
    yield from in_time(apart, evidence, part, m, together)
    if state.bursts is not None and not state.bursts.period_frames:
        yield from burst_share(state.disturbed[view.frames], state.bursts)
    yield from invalid(evidence, m, state, axes, part)
    yield from neighbours(apart, evidence, part)
    yield from lines(apart, evidence, part)
    yield from bridging(evidence, m, state, axes, part)
    yield from discreteness(evidence, part, m, state)


LEAST_SIZE = 0.02
"""Smaller deviations, in sigma, do not count."""

_IN_SIGMA = (
    "bias",
    "spread",
    "skew",
    "tails",
    "pattern",
    "spread_pattern",
    "skew_pattern",
    "tails_pattern",
    "common_mode",
    "bursts",
    "trend",
    "memory",
    "neighbour_correlation",
    "widths",
)
SMALLEST_P = 1.0e-300
"""Smallest p-value, above 0, which some JSON readers take as a missing value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """An interval in which a statistic disagrees.

    Parameters
    ----------
    axis, statistic : str
        Names as in `gap.json`.
    interval : (float, float)
        In the unit of the axis.
    size : float
        Mean of the statistic in it; mm for a bias, else a ratio, a correlation or a share. Of a trend the change of
        measured minus predicted ranges, mm, from the beginning of the interval to its end.
    unit : str
        Unit of the size.
    p_value : float
        Corrected for all intervals and curves.
    z : float
        Deviation in standard errors.
    recording : int
        Number of the recording, from 0.
    """

    axis: str
    statistic: str
    interval: tuple[float, float]
    size: float
    unit: str
    p_value: float
    z: float
    recording: int = 0


def disagreements(compared: Compared, alpha: float) -> list[Curve]:
    """Curves above noise at the corrected level `alpha`, and above `LEAST_SIZE`; largest evidence first."""
    curves = compared.curves
    limit = float(norm.isf(alpha / max(len(curves), 1)))
    loud = [
        c
        for c in curves
        if c.dof and c.z > limit and c.excess_nats > 0 and (c.largest > LEAST_SIZE or c.statistic not in _IN_SIGMA)
    ]
    return sorted(loud, key=lambda c: -c.excess_nats)


def localise(compared: Compared, alpha: float) -> list[Place]:
    """The interval of largest deviation of each curve that stands out; largest evidence first.

    Parameters
    ----------
    compared : Compared
        Panel of a part.
    alpha : float
        Level of the test, after correction.
    """
    curves = disagreements(compared, alpha)
    places = [_strongest(curve, len(compared.curves)) for curve in _by_weight(curves)]
    return [p for p in places if p.p_value <= alpha]


def _by_weight(curves: Iterable[Curve]) -> list[Curve]:
    """Sorted by the information that lower orders do not contain; equal ones in the order of the panel."""
    return sorted(curves, key=lambda c: -(gain(c.chi2, c.dof) if c.information is None else c.information))


def _change(value: FloatArray) -> tuple[tuple[int, int], float]:
    """The bins between the least and the largest value, in their order, and the change from the first to the last."""
    first, last = sorted((int(value.argmin()), int(value.argmax())))
    return (first, last + 1), float(value[last] - value[first])


def _strongest(curve: Curve, looked_at: int) -> Place:
    weight = 1 / curve.variance
    total, mass = np.concatenate([[0], np.cumsum(curve.value * weight)]), np.concatenate([[0], np.cumsum(weight)])
    best, where = -1.0, (0, curve.dof)
    most_bins = 60  # times ten: with more bins, intervals are not scanned
    longest = curve.dof if curve.dof <= most_bins * 10 else 1
    for length in range(1, longest + 1):
        z = np.abs(total[length:] - total[:-length]) / np.sqrt(mass[length:] - mass[:-length])
        at = int(z.argmax())
        if z[at] > best:
            best, where = float(z[at]), (at, at + length)
    a, b = where
    whole = curve.statistic.endswith("pattern")  # pixels have no order, so no interval of them is a place
    a, b = (0, curve.dof) if whole else where
    value = (total[b] - total[a]) / (mass[b] - mass[a])
    if curve.statistic == "trend":
        (a, b), value = _change(curve.value)
    tests = looked_at * curve.dof * (min(longest, curve.dof) + 1) / 2
    # The whole curve may be more significant than its best interval, as for a sine
    log_p = min(log_ndtr(-best) + math.log(2 * tests), log_ndtr(-curve.z) + math.log(looked_at))
    in_mm = curve.statistic in ("bias", "trend", "common_mode", "pattern")
    scale = float(np.average(curve.scale_mm[a:b], weights=weight[a:b])) if in_mm else 1.0
    return Place(
        axis=curve.axis,
        statistic=curve.statistic,
        interval=(0.0, 1.0) if whole else (float(curve.lower[a]), float(curve.upper[b - 1])),
        size=float((curve.size if whole else value) * scale),
        unit="mm" if in_mm else "1",
        p_value=max(min(math.exp(max(min(log_p, 0.0), -690.0)), 1.0), SMALLEST_P),
        z=best,
        recording=curve.recording,
    )
