"""Log-likelihood of quantised samples by their distinct values, with its exact derivatives by a pixel's bias.

A quantised pixel has few distinct values, so this takes a twentieth of the time of a pass over samples. Use it where
the distribution of a pixel is constant in time. The information of `tofmix.reconciliation.likelihood.kernel` takes
a cell as noise, which is wrong where cells are wider than sigma.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.reconciliation.likelihood.kernel import _cell, _phi, _width
from tofmix.reconciliation.likelihood.mixture import Mixture

_FLOOR, _INVALID_FLOOR = 1.0e-12, 1.0e-6  # as of the pass over samples


@dataclass(frozen=True, slots=True, eq=False)
class DistinctValues:
    """The distinct values of each pixel, and how often each occurs.

    Parameters
    ----------
    first : (pixel + 1,) int64
        Where the values of each pixel begin.
    value, count : (n,) float64
        Values, mm, 0 for invalid; and counts.
    """

    first: IntArray
    value: FloatArray
    count: FloatArray

    @classmethod
    def of(cls, samples: NDArray[np.uint16]) -> "DistinctValues":
        """Those of samples (frame, pixel)."""
        found = [np.unique(column, return_counts=True) for column in samples.T]
        return cls(
            first=np.concatenate([[0], np.cumsum([v.size for v, _ in found])]).astype(np.int64),
            value=np.concatenate([v for v, _ in found]).astype(np.float64),
            count=np.concatenate([c for _, c in found]).astype(np.float64),
        )


def is_static(m: Mixture) -> bool:
    """Whether a mixture of one recording is quantised, Gaussian, and constant in time."""
    still = m.weight.shape[0] == 1 and not m.frame_bias.any() and not m.rate.any()
    return bool(m.step > 0 and still and m.period == 0 and m.shape is None)


def by_values(values: DistinctValues, m: Mixture, bias_mm: FloatArray) -> FloatArray:
    """Log-likelihood, slope, 1/mm, and observed information, 1/mm2, of each pixel (pixel, 3).

    Parameters
    ----------
    values : DistinctValues
        Of the samples.
    m : Mixture
        The prediction; static (`is_static`).
    bias_mm : (pixel,) float64
        Bias of each pixel.
    """
    out: FloatArray = np.zeros((bias_mm.size, 3))
    weight, mean, sigma = (np.ascontiguousarray(a[0]) for a in (m.weight, m.mean, m.sigma))
    density = m.outlier / (m.high - m.low)
    lit = np.ascontiguousarray(m.lit[0])
    invalid = m.invalid[0]
    _sums(
        values.first,
        values.value,
        values.count,
        weight,
        mean,
        sigma,
        lit,
        invalid,
        density,
        m.step,
        bias_mm,
        out,
    )
    return out


@jit
def _sums(
    first: IntArray,
    value: FloatArray,
    count: FloatArray,
    weight: FloatArray,
    mean: FloatArray,
    sigma: FloatArray,
    lit: BoolArray,
    invalid: FloatArray,
    density: FloatArray,
    step: float,
    bias: FloatArray,
    out: FloatArray,
) -> None:
    root = 1.0 / math.sqrt(2.0 * math.pi)
    for p in range(first.size - 1):
        for k in range(first[p], first[p + 1]):
            n = count[k]
            if value[k] == 0.0:
                out[p, 0] += n * math.log(max(invalid[p], _INVALID_FLOOR))
                continue
            lower, upper = _cell(value[k], step, 0.0)
            total, one, two = _FLOOR, 0.0, 0.0
            if lower < upper:
                total += density[p] * _width(lower, upper, step)
                for c in range(weight.shape[0]):
                    w = weight[c, p]
                    if w <= 0.0:
                        continue
                    s = sigma[c, p]
                    m = mean[c, p] + (bias[p] if lit[c, p] else 0.0)
                    a, b = (lower - m) / s, (upper - m) / s
                    total += w * (_phi(-a) - _phi(-b) if a > 0 else _phi(b) - _phi(a))
                    if lit[c, p]:
                        fa, fb = root * math.exp(-0.5 * a * a), root * math.exp(-0.5 * b * b)
                        one += w * (fa - fb) / s
                        two += w * (a * fa - b * fb) / (s * s)
            out[p, 0] += n * math.log(total)
            out[p, 1] += n * one / total
            out[p, 2] += n * ((one / total) ** 2 - two / total)
