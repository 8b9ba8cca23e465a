"""The information of each curve that curves of lower order do not contain; it ranks the places.

A wrong mean also changes spread, skew and tails, on every axis. So means come first, in mm: over each axis of the
pixels, over frames and over time. Means are removed before spreads are computed, and both before skew and tails. The
gain of an axis is that of the marginal likelihood of a Gaussian effect over its bins, with a free variance. So an axis
of many bins must explain more.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray, IntArray
from tofmix.reconciliation.comparison.panel import Axis, panel_axes
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.likelihood import Part
from tofmix.reconciliation.likelihood.memory import lag_product
from tofmix.reconciliation.likelihood.mixture import Mixture

EVERYWHERE = 0.05
"""Part, of the gain of `all`, that an axis must add to be the place instead of `all`."""

STRUCTURED = 0.15
"""Least share of the gain of single pixels at which an axis is the place."""

FINE = 48
"""Number of bins of axes that are divided by quantiles; changes within a bin are lost."""

_REACH = 2.0  # largest mean, in sigma, of a pixel with a valid spread: scores beyond 4 count as 4
_TENTHS = 10  # parts of the time, for slow changes
_LAGS = (1, 2, 3)  # frames
_LEAST = 1e-9  # weight of a pixel

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
    tenth = np.arange(len(by_frame)) * _TENTHS // max(len(by_frame), 1)
    if names[0]:
        found[names[0], "frame"] = _chi2(by_frame, mass[1])
        found[names[1], "time"] = _binned(tenth, by_frame, mass[1])
    return _ranked(name, found, single)


def _ranked(name: str, found: dict[tuple[str, str], tuple[float, int]], single: tuple[float, int]) -> Information:
    """Gains by axis; an axis that adds little to the gain of `all` comes after `all`."""
    gains = {key: gain(*value) for key, value in found.items()}
    common = gains[name, "all"]
    for key, value in gains.items():
        if key != (name, "all") and value < (1 + EVERYWHERE) * common:
            gains[key] = min(value, common) * (1 - EVERYWHERE)
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
    ok = s.ok & (mean < _REACH)
    return replace(s, z=np.where(ok, s.z, np.float32(0)), ok=ok)


def _without_means(s: Scored, weight: Float32Array) -> Float32Array:
    """Scores without each pixel's mean and each frame's bias in mm, of unit variance."""
    n = np.maximum(s.ok.sum(axis=0), 2)
    rest = np.where(s.ok, s.z - s.z.sum(axis=0) / n, np.float32(0))
    mass = np.where(s.ok, weight**2, np.float32(0)).sum(axis=1)
    bias = (rest * weight).sum(axis=1) / np.maximum(mass, _LEAST)
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


def information_of(z: Float32Array, evidence: Evidence, m: Mixture, part: Part) -> Information:
    """All gains of a part's scores (frame, pixel), NaN where invalid."""
    axes = tuple(panel_axes(evidence, m, part, bins=FINE))
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
