"""The probability integral transform of a prediction: uniform if samples follow it."""

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.simulation.distribution import Prediction
from tofmix.simulation.events import stored_range


def pit(prediction: Prediction, stored_mm: NDArray[np.generic], rng: np.random.Generator) -> FloatArray:
    """Transform (n, pixel) of stored values, whole mm; NaN for invalid samples and for values that cannot be stored.

    A stored value stands for a cell of ranges: the transform is drawn uniformly between those of its ends.
    """
    stored = np.asarray(stored_mm)
    stuck = ~np.isnan(prediction.stuck_mm)
    lower, upper = prediction.cell(stored)
    low, high = prediction.cdf(lower), prediction.cdf(upper)
    drawn = rng.random(stored.shape)
    transform = np.where(stuck, drawn, low + drawn * (high - low))
    is_stuck_value = stored == stored_range(np.nan_to_num(prediction.stuck_mm))
    return np.where(np.where(stuck, is_stuck_value, (stored > 0) & (lower < upper)), transform, np.nan)
