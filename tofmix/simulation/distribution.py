"""The distribution of each pixel's next sample: a mixture over stored values.

`Prediction.cdf` and `Prediction.probability` describe the values that a recording stores, whole millimetres and invalid
samples. `tofmix.simulation.exposure.predict` makes one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tofmix.arrays import BoolArray, FloatArray
from tofmix.noise_shape import NoiseShape
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.events import stored_range

_LOWEST, _HIGHEST = 1.0, 65_534.0  # what a recording can store


@dataclass(slots=True, kw_only=True, eq=False)
class Prediction(Echoes):
    """The mixture of each pixel. Arrays are (component, pixel); a component is a surface, or no return.

    Weights, invalid share and outlier share of a pixel sum to 1.

    Parameters
    ----------
    weight : (component, pixel) float64
        Probability that a sample is valid and of this component; 0 for padding.
    invalid : (pixel,) float64
        Probability that a sample is invalid.
    outlier : float or (pixel,) float64
        Probability of a random value, background included.
    limits_mm : (float, float)
        A random value is uniform between these.
    step_mm : float
        Ranges are rounded to multiples of this before they are stored; 0 for none.
    stuck_mm : (pixel,) float64
        The one value that a stuck pixel returns; NaN where the pixel works.
    error_shape : NoiseShape or None
        Density of each component's error in units of its sigma; Gaussian without it.
    """

    weight: FloatArray
    invalid: FloatArray
    outlier: float | FloatArray
    limits_mm: tuple[float, float]
    step_mm: float = 0.0
    stuck_mm: FloatArray
    error_shape: NoiseShape | None = None

    def area(self) -> FloatArray:
        """Area shares (component, pixel) of the surfaces, as light effects need them; 0 for no return."""
        share: FloatArray = np.where(self.returned, self.weight, 0.0) / (1.0 - self.outlier)
        return share

    def lose(self, probability: FloatArray | float) -> None:
        """Move that part of each component to the invalid samples."""
        lost = self.weight * probability
        self.weight = self.weight - lost
        self.invalid = self.invalid + lost.sum(axis=0)

    def replace_by_outliers(self, share: float) -> None:
        """Make `share` of all samples random values, at the cost of everything but the random values there are."""
        kept = (1.0 - self.outlier - share) / (1.0 - self.outlier)
        self.weight, self.invalid = self.weight * kept, self.invalid * kept
        self.outlier = self.outlier + share

    def split(self, probability: FloatArray | float) -> tuple["Prediction", "Prediction"]:
        """Two copies that share the weights: 1 - probability and probability; `join` puts them together."""
        one, other = (_copy(self) for _ in range(2))
        other.weight = self.weight * probability
        one.weight = self.weight - other.weight
        return one, other

    def join(self, one: "Prediction", other: "Prediction") -> None:
        """Take over the components of both."""
        for name in ("surface", "true_range_mm", "range_mm", "amplitude", "sigma_mm", "weight"):
            setattr(self, name, np.concatenate([getattr(one, name), getattr(other, name)]))

    def cdf(self, range_mm: FloatArray) -> FloatArray:
        """P(range <= r | the sample is valid), before any rounding.

        Parameters
        ----------
        range_mm : (n, pixel) float64
            Ranges, mm; infinities are allowed.

        Returns
        -------
        (n, pixel) float64
            NaN where a pixel never returns a valid sample.
        """
        low, high = self.limits_mm
        total = self.outlier * np.clip((range_mm - low) / (high - low), 0.0, 1.0)
        for k in range(len(self.weight)):
            if self.weight[k].any():
                total += self.weight[k] * self._component_cdf(k, range_mm)
        with np.errstate(invalid="ignore", divide="ignore"):
            total /= 1.0 - self.invalid
        return np.where(self._stuck, np.asarray(range_mm >= self.stuck_mm, dtype=np.float64), total)

    def _component_cdf(self, k: int, range_mm: FloatArray) -> FloatArray:
        mean, sigma = self.range_mm[k], np.maximum(self.sigma_mm[k], 1.0e-6)
        below = ndtr if self.error_shape is None else self.error_shape.cdf
        plain: FloatArray = below((range_mm - mean) / sigma)
        folds = (self.weight[k] > 0) & self.returned[k]
        if self.period_mm is None or not folds.any():
            return plain
        sigmas = 8.5  # a Gaussian's tail beyond holds less than the rounding of a float
        first, last = (-sigmas, sigmas) if self.error_shape is None else (self.error_shape.z[0], self.error_shape.z[-1])
        span = (mean + first * sigma)[folds].min(), (mean + last * sigma)[folds].max()
        return np.where(folds, _folded_cdf(range_mm, mean, sigma, self.period_mm, span, below), plain)

    def cell(self, stored_mm: NDArray[np.generic]) -> tuple[FloatArray, FloatArray]:
        """The ranges that are stored as a value: ``[lower, upper)`` in mm before any rounding.

        Parameters
        ----------
        stored_mm : (n, pixel)
            Whole mm, 1 to 65,534.

        Returns
        -------
        lower, upper : (n, pixel) float64
            Lower is above upper where no range is stored as this value.
        """
        value = np.asarray(stored_mm, dtype=np.float64)
        lower, upper = value - 0.5, value + 0.5
        if self.step_mm > 0:  # multiples first to last whose nearest whole mm is the value, halves to the even one
            first, last = np.ceil(lower / self.step_mm), np.floor(upper / self.step_mm)
            first += np.rint(first * self.step_mm) < value
            last -= np.rint(last * self.step_mm) > value
            lower, upper = (first - 0.5) * self.step_mm, (last + 0.5) * self.step_mm
        return np.where(value <= _LOWEST, -np.inf, lower), np.where(value >= _HIGHEST, np.inf, upper)

    def probability(self, stored_mm: NDArray[np.generic]) -> FloatArray:
        """Probability (n, pixel) of stored values (n, pixel); 0 mm means an invalid sample."""
        stored = np.asarray(stored_mm)
        lower, upper = self.cell(stored)
        inside = np.nan_to_num(np.maximum(self.cdf(upper) - self.cdf(lower), 0.0)) * (1.0 - self.invalid)
        working = np.where(stored > 0, inside, self.invalid)
        return np.where(self._stuck, np.asarray(self._is_stuck_value(stored), dtype=np.float64), working)

    @property
    def _stuck(self) -> BoolArray:
        return ~np.isnan(self.stuck_mm)

    def _is_stuck_value(self, stored_mm: NDArray[np.generic]) -> BoolArray:
        return np.asarray(stored_mm == stored_range(np.nan_to_num(self.stuck_mm)), dtype=np.bool_)


def _folded_cdf(
    range_mm: FloatArray,
    mean: FloatArray,
    sigma: FloatArray,
    period_mm: float,
    span_mm: tuple[float, float],
    below: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Sum of the error's pieces of one period each, over the turns that `span_mm` touches."""
    inside = np.clip(range_mm, 0.0, period_mm)
    total = np.zeros(np.broadcast_shapes(range_mm.shape, mean.shape))
    for turn in range(math.floor(span_mm[0] / period_mm), math.floor(span_mm[1] / period_mm) + 1):
        start = turn * period_mm - mean
        total += below((inside + start) / sigma) - below(start / sigma)
    return total


def _copy(prediction: Prediction) -> Prediction:
    names = Prediction.__dataclass_fields__
    return Prediction(**{name: getattr(prediction, name) for name in names})
