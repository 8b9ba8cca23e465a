"""Part of the panel: statistics over frames and time: means, spreads and memory."""

from collections.abc import Iterator

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconciliation.comparison.panel import Curve, sigma_of_lit
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.lags import lag_product
from tofmix.reconciliation.likelihood.likelihood import Part
from tofmix.reconciliation.likelihood.memory import one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.effects.interference import Interference

_ENOUGH_IN_FRAME = 30  # samples
_PARTS = 10  # of the time
_MORE = 4.0  # weight of the effect's share, in frames


def in_time(z: Float32Array, evidence: Evidence, part: Part, m: Mixture) -> Iterator[Curve]:
    """Mean and spread of each frame, without the means of pixels; of tenths of the time; memory at lags 1 to 3."""
    now = evidence.time_s[part[0]]
    frame = part[0].astype(np.float64)
    ok = np.isfinite(z)
    count = ok.sum(axis=0)
    flat = np.where(ok, z - np.nansum(z, axis=0) / np.maximum(count, 1), np.float32(0))
    n = ok.sum(axis=1)
    alone = one_surface(m)[part[1]]  # in other pixels a score also depends on the surface that was drawn
    if alone.any() and ok.any():
        yield from _memory(flat[:, alone], ok[:, alone], part[0])
    some = n >= _ENOUGH_IN_FRAME
    if not some.any():
        return
    per_mm = float((count / sigma_of_lit(m, part)).sum() / count.sum())
    sigma = np.full(int(some.sum()), 1.0 / per_mm if per_mm > 0 else 0.0)
    mean = flat.sum(axis=1, dtype=np.float64)[some] / n[some]
    square = ((flat**2).sum(axis=1, dtype=np.float64)[some] / n[some] - _mean_square(flat, ok)) / np.sqrt(2)
    for name, value, extra in (("common_mode", mean, 1.0), ("bursts", square, _kurtosis(flat, ok))):
        yield Curve(
            statistic=name,
            axis="frame",
            lower=frame[some],
            upper=frame[some] + 1,
            value=value,
            variance=extra / n[some],
            unit="1",
            scale_mm=sigma,
        )
    told = int(some.sum())
    tenth = np.arange(told) * min(_PARTS, told) // told
    for name, value in (("trend", mean), ("spread", square)):
        size = np.bincount(tenth, n[some])
        start = np.array([now[some][tenth == k][0] for k in range(tenth.max() + 1)])
        end = np.array([now[some][tenth == k][-1] for k in range(tenth.max() + 1)])
        mean_value = np.bincount(tenth, value * n[some]) / size
        yield Curve(
            statistic=name,
            axis="time",
            lower=start,
            upper=end,
            value=mean_value,
            variance=1.0 / size,
            unit="s",
            scale_mm=sigma[: size.size],
        )


def burst_share(disturbed: FloatArray, effect: Interference) -> Iterator[Curve]:
    """Share of disturbed frames beyond that of the effect; bursts are few, and of any length.

    Parameters
    ----------
    disturbed : (frame,) float64
        Probability that each frame was disturbed.
    effect : Interference
        The bursts of the model.
    """
    p = effect.probability
    bursts = disturbed.size / max(2 * effect.burst_frames * (1 - p) - 1, 1.0)  # number of independent frames
    share = (float(disturbed.sum()) * bursts / disturbed.size + _MORE * p) / (bursts + _MORE)
    yield Curve(
        statistic="bursts",
        axis="all",
        lower=np.zeros(1),
        upper=np.ones(1),
        value=np.array([share - p]),
        variance=np.array([p * (1 - p) / max(bursts, 1.0)]),
        unit="1",
        scale_mm=np.ones(1),
    )


def _mean_square(flat: Float32Array, ok: BoolArray) -> float:
    return float((flat**2).sum(dtype=np.float64) / max(int(ok.sum()), 1))


def _kurtosis(flat: Float32Array, ok: BoolArray) -> float:
    square = np.where(ok, flat**2, np.nan)
    return float(np.nanvar(square) / 2)


def _memory(flat: Float32Array, ok: BoolArray, frames: IntArray) -> Iterator[Curve]:
    centred = flat - flat.sum(axis=1, keepdims=True) / np.maximum(ok.sum(axis=1, keepdims=True), 1)
    centred = np.where(ok, centred, np.float32(0))
    lags = (1, 2, 3)
    value, variance = [], []
    for lag in lags:
        n, product = lag_product(centred, ok, lag, frames)
        value.append(product / max(n, 1) + 1.0 / max(len(frames), 1))  # the removed mean lowers the correlation by this
        variance.append(1.0 / max(n, 1))
    lag_axis = np.array(lags, dtype=np.float64)
    yield Curve(
        statistic="memory",
        axis="frame",
        lower=lag_axis,
        upper=lag_axis,
        value=np.array(value),
        variance=np.array(variance),
        unit="1",
        scale_mm=np.ones(len(lags)),
    )
