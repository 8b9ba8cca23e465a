"""How much likelihood a surface must gain, for a wanted chance of false alarms.

Where a pixel sees one surface, a second one in the fit still gains some likelihood
by following the noise. How much depends on the number of samples, slowly. The
table holds the gains that were exceeded with each chance, drawn with the package's
own search by ``python tests/benchmarks/calibrate.py``; in between it is read off
linearly in the logarithms of both.
"""

import math

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.options import ESTIMATE

FALSE_ALARMS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0001)
"""Chances of a false alarm, a column each."""

SAMPLES = (5, 10, 15, 30, 60, 100, 200, 500, 1000)
"""Samples in the pixel, a row each."""

LEAST_FALSE_ALARM, MOST_FALSE_ALARM = ESTIMATE["false_alarm"].low, ESTIMATE["false_alarm"].high
"""Least and greatest probability of a false alarm that the table covers, the least by extrapolation."""

_GAINS = np.array(
    [
        (0.00, 0.51, 1.30, 1.91, 2.55, 3.53, 4.18, 6.44),  # 5
        (0.53, 1.12, 1.94, 2.58, 3.27, 4.14, 4.70, 6.82),  # 10
        (0.71, 1.31, 2.15, 2.79, 3.45, 4.36, 4.89, 6.99),  # 15
        (0.97, 1.61, 2.49, 3.21, 3.94, 4.83, 5.49, 7.77),  # 30
        (1.14, 1.79, 2.67, 3.38, 4.04, 5.00, 5.69, 8.01),  # 60
        (1.25, 1.91, 2.78, 3.45, 4.11, 5.04, 5.83, 8.21),  # 100
        (1.36, 2.02, 2.91, 3.57, 4.26, 5.23, 6.00, 8.43),  # 200
        (1.48, 2.15, 3.06, 3.70, 4.43, 5.45, 6.12, 8.54),  # 500
        (1.55, 2.24, 3.16, 3.81, 4.52, 5.37, 6.08, 8.34),  # 1000
    ]
)

_NATS_OF_CHANCE = -np.log(np.array(FALSE_ALARMS))


def gain_table(most_samples: int) -> FloatArray:
    """Gains that noise exceeds with each of `FALSE_ALARMS`, for each number of samples.

    Parameters
    ----------
    most_samples : int
        Most samples in a pixel.

    Returns
    -------
    (most_samples + 1, len(FALSE_ALARMS)) float64
        Gains in nat; row n is for n samples. Below 5 samples those of 5 hold, above 1000 those of 1000.
    """
    log_n = np.log(np.maximum(np.arange(most_samples + 1, dtype=np.float64), 1.0))
    columns = [np.interp(log_n, np.log(np.array(SAMPLES)), column) for column in _GAINS.T]
    return np.ascontiguousarray(np.stack(columns, axis=1), dtype=np.float64)


@borrowing
def _read_off(x: float, known: FloatArray, values: FloatArray) -> float:
    """Interpolate linearly; past the last point, go on as between the last two."""
    last = len(known) - 1
    k = 1
    while k < last and known[k] < x:
        k += 1
    slope = (values[k] - values[k - 1]) / (known[k] - known[k - 1])
    return float(values[k] + slope * (x - known[k]))


@borrowing
def least_gain(false_alarm: float, gains: FloatArray) -> float:
    """Gain, nat, that noise exceeds with the chance `false_alarm`; `gains` is the pixel's row of `gain_table`."""
    return _read_off(-math.log(false_alarm), _NATS_OF_CHANCE, gains)


@borrowing
def chance_of(gain: float, gains: FloatArray) -> float:
    """Chance that noise gains as much: the inverse of `least_gain`, at most 1."""
    if gain <= 0.0:
        return 1.0
    if gain < gains[0]:
        return float(1.0 - (1.0 - FALSE_ALARMS[0]) * gain / gains[0])
    return float(math.exp(-_read_off(gain, gains, _NATS_OF_CHANCE)))
