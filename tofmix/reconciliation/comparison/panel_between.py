"""Part of the panel: samples between the two surfaces of a pixel.

Scores do not show such samples. Between two peaks the distribution function is flat, so the score of a sample depends
on the share of the nearer surface only. Over many pixels these scores cancel.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import ndtr

from tofmix.arrays import BoolArray, FloatArray
from tofmix.reconciliation.comparison.panel import Axis, Curve
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.likelihood import ModelState, Part
from tofmix.reconciliation.likelihood.mixture import Mixture

_CLEAR = 4.5  # sigma from a surface, beyond which it has no samples
_ENOUGH = 100  # samples of a bin
_LEAST_SHARE = 1e-3  # of the beam


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
    some = n >= _ENOUGH
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
    two = (share > _LEAST_SHARE) & (np.where(others, 0.0, weight).sum(axis=0) == 0)
    mean, reach = m.mean[0], _CLEAR * m.sigma[0] + m.step / 2
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
