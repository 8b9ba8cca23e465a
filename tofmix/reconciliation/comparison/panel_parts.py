"""Parts of the panel: statistics over time, along lines of the image, and between the surfaces of a pixel.

Scores do not show samples between the two surfaces of a pixel. Between two peaks the distribution function is flat, so
the score of a sample depends on the share of the nearer surface only. Over many pixels these scores cancel.

Lines of the image have a common bias in a frame where the read-out rolls. Over frames and time, means, spreads and
memory are looked at.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import ndtr

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconciliation.comparison.panel import Axis, Curve, sigma_of_lit
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.likelihood import ModelState, Part
from tofmix.reconciliation.likelihood.memory import lag_product, one_surface
from tofmix.reconciliation.likelihood.mixture import Mixture
from tofmix.simulation.effects.hidden import FrameChain


def bridging(evidence: Evidence, m: Mixture, state: ModelState, axes: Sequence[Axis], part: Part) -> Iterator[Curve]:
    """Share of samples between the two surfaces of a pixel, beyond the predicted share.

    A pixel is left out if a neighbour sees a surface between the two: the share of a third surface may be too small to
    be known. There is no result for scenes that move and for a model with bursts.
    """
    if len(m.weight) > 1 or state.bursts is not None:
        return
    low, high, two = _valleys(m)
    use = (two & state.working & (high > low) & ~_between(m, evidence.image, low, high))[part[1]]
    pixels = part[1][use]
    if not pixels.size:
        return
    seen = evidence.samples[part[0]][:, pixels].astype(np.float64)
    moved = seen - m.frame_bias[part[0], None] - state.pixel_bias[pixels]
    valid = seen > 0
    inside = valid & (moved > low[pixels]) & (moved < high[pixels])
    chance = valid.sum(axis=0) * _chance(m, low, high)[pixels]
    axis = next(a for a in axes if a.name == "neighbour_contrast")
    found, expected, n = (
        np.bincount(axis.bin[use], by_pixel, minlength=axis.lower.size)
        for by_pixel in (inside.sum(axis=0), chance, valid.sum(axis=0))
    )
    enough = 100  # samples of a bin
    some = n >= enough
    found, expected, n = found[some], expected[some], n[some]
    # Few are expected, so the squared deviation of their number is no chi-square; a variance that also follows the
    # number found keeps it small
    variance = (np.maximum(0.5 * (found + expected), expected) + 1.0) / n**2
    yield Curve(
        statistic="bridging",
        axis=axis.name,
        lower=axis.lower[some],
        upper=axis.upper[some],
        value=(found - expected) / n,
        variance=variance,
        unit=axis.unit,
        scale_mm=np.ones(n.size),
    )


def _valleys(m: Mixture) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Limits (pixel,) of the ranges between the two surfaces of a pixel, mm; whether it sees exactly two."""
    weight = np.where(m.lit[0], m.weight[0], 0.0)
    first = weight.argmax(axis=0)
    at = np.arange(first.size)
    own = m.surface[0] == m.surface[0][first, at]
    second = np.where(own, 0.0, weight).argmax(axis=0)
    others = own | (m.surface[0] == m.surface[0][second, at])
    share = np.where(own, 0.0, weight).sum(axis=0)
    least_share = 1e-3  # of the beam
    two = (share > least_share) & (np.where(others, 0.0, weight).sum(axis=0) == 0)
    clear = 4.5  # sigma from a surface, beyond which it has no samples
    mean, reach = m.mean[0], clear * m.sigma[0] + m.step / 2
    near = np.where(mean[first, at] < mean[second, at], first, second)
    far = np.where(mean[first, at] < mean[second, at], second, first)
    return mean[near, at] + reach[near, at], mean[far, at] - reach[far, at], two


def _between(m: Mixture, image: tuple[int, int], low: FloatArray, high: FloatArray) -> BoolArray:
    """Whether a neighbour of a pixel has most of its light from between the limits (pixel,)."""
    main = np.where(m.of_main(m.lit), m.of_main(m.mean), np.inf).reshape(image)
    framed = np.pad(main, 1, constant_values=np.inf)
    rows, cols = image
    out = np.zeros(image, dtype=bool)
    for down in (0, 1, 2):
        for right in (0, 1, 2):
            near = framed[down : down + rows, right : right + cols]
            out |= (near > low.reshape(image)) & (near < high.reshape(image))
    return out.ravel()


def _chance(m: Mixture, low: FloatArray, high: FloatArray) -> FloatArray:
    """Probability (pixel,) of a valid sample between the limits."""
    chance = ndtr if m.shape is None else m.shape.cdf
    below, above = (chance((edge - m.mean[0]) / m.sigma[0]) for edge in (low, high))
    inside = (m.weight[0] * (above - below)).sum(axis=0) / np.maximum(m.weight[0].sum(axis=0), 1e-9)
    return np.asarray((1 - m.outlier) * inside + m.outlier * (high - low) / max(m.high - m.low, 1.0))


def lines(z: Float32Array, evidence: Evidence, part: Part) -> Iterator[Curve]:
    """Variance of the mean of each row, and column, over that of independent samples, minus 1, over root 2.

    Means of pixels and of frames are removed first, and values are divided by the spread of the line. In an image of
    one row the mean of the row is that of the frame, which is removed, so there is no result. The same holds for one
    column. The variance of n frames is a chi-square of n - 1: it is made normal, since of few frames it is skewed.

    References
    ----------
    Wilson and Hilferty, Proc. Nat. Acad. Sci. 17 (1931) 684.
    """
    rows, cols = evidence.image
    ok = np.isfinite(z)
    flat = np.where(ok, z - np.nansum(z, axis=0) / np.maximum(ok.sum(axis=0), 1), np.float32(0))
    flat -= np.where(ok, flat.sum(axis=1, keepdims=True) / np.maximum(ok.sum(axis=1, keepdims=True), 1), np.float32(0))
    cube: Float32Array = np.zeros((len(z), rows * cols), dtype=np.float32)
    cube[:, part[1]] = flat
    seen = np.zeros((len(z), rows * cols), dtype=bool)
    seen[:, part[1]] = ok
    image, valid = cube.reshape(-1, rows, cols), seen.reshape(-1, rows, cols)
    sigma = np.ones(1)
    few = 4  # samples of a line in a frame
    least = 1e-9  # variance of a line that is not constant
    for axis, name in ((2, "row"), (1, "col")):
        if image.shape[3 - axis] == 1:
            continue
        n = valid.sum(axis=axis)
        use = n >= few
        frames = use.sum(axis=0)
        level = (image**2).sum(axis=(0, axis), dtype=np.float64) / np.maximum(n.sum(axis=0), 1)
        square = np.where(use, image.sum(axis=axis, dtype=np.float64) ** 2 / np.maximum(n, 1), 0.0).sum(axis=0)
        some = (frames >= few) & (level > least)
        lost = 1.0 - 1.0 / image.shape[3 - axis]  # the part that the means of frames removed
        free = frames[some] - 1.0
        ratio = square[some] / frames[some] / level[some] / lost
        value = (np.cbrt(ratio) - 1.0 + 2.0 / (9.0 * free)) * np.sqrt(4.5)
        at = np.flatnonzero(some).astype(np.float64)
        yield Curve(
            statistic="common_mode",
            axis=name,
            lower=at,
            upper=at + 1,
            value=value,
            variance=1.0 / free,
            unit="1",
            scale_mm=np.broadcast_to(sigma, at.shape),
        )


def in_time(z: Float32Array, evidence: Evidence, part: Part, m: Mixture, together: float = 0.0) -> Iterator[Curve]:
    """Mean and spread of each frame, without the means of pixels; of tenths of the time; memory at lags 1 to 3.

    `together` is the variance of what the samples of a frame have in common, which a measured scene shows already.
    """
    now = evidence.time_s[part[0]]
    frame = part[0].astype(np.float64)
    ok = np.isfinite(z)
    count = ok.sum(axis=0)
    flat = np.where(ok, z - np.nansum(z, axis=0) / np.maximum(count, 1), np.float32(0))
    n = ok.sum(axis=1)
    alone = one_surface(m)[part[1]]  # in other pixels a score also depends on the surface that was drawn
    if alone.any() and ok.any():
        yield from _memory(flat[:, alone], ok[:, alone], part[0])
    enough_in_frame = 30  # samples
    some = n >= enough_in_frame
    if not some.any():
        return
    per_mm = float((count / sigma_of_lit(m, part)).sum() / count.sum())
    sigma = np.full(int(some.sum()), 1.0 / per_mm if per_mm > 0 else 0.0)
    mean = flat.sum(axis=1, dtype=np.float64)[some] / n[some]
    square = ((flat**2).sum(axis=1, dtype=np.float64)[some] / n[some] - _mean_square(flat, ok)) / np.sqrt(2)
    for name, value, extra, shared in (
        ("common_mode", mean, 1.0, together),
        ("bursts", square, _kurtosis(flat, ok), 2.0 * together**2),
    ):
        yield Curve(
            statistic=name,
            axis="frame",
            lower=frame[some],
            upper=frame[some] + 1,
            value=value,
            variance=extra / n[some] + shared,
            unit="1",
            scale_mm=sigma,
        )
    told = int(some.sum())
    parts = 10  # of the time
    tenth = np.arange(told) * min(parts, told) // told
    for name, value, shared in (("trend", mean, together), ("spread", square, 2.0 * together**2)):
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
            variance=1.0 / size + shared / np.bincount(tenth),
            unit="s",
            scale_mm=sigma[: size.size],
        )


def burst_share(disturbed: FloatArray, chain: FrameChain) -> Iterator[Curve]:
    """Share of disturbed frames beyond that of the chain; bursts are few, and of any length.

    Parameters
    ----------
    disturbed : (frame,) float64
        Probability that each frame was disturbed.
    chain : FrameChain
        The bursts of the model.
    """
    p = chain.probability
    bursts = disturbed.size / max(2 * chain.burst_frames * (1 - p) - 1, 1.0)  # number of independent frames
    more = 4.0  # weight of the effect's share, in frames
    share = (float(disturbed.sum()) * bursts / disturbed.size + more * p) / (bursts + more)
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
