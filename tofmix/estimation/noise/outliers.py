"""The share of random values p(c_r), counted in series that see one surface.

Use it through `noise`, once the curve is measured. An outlier lies more than 5
sigma from the surface, and alone: samples that lie together are a weak surface.
Where outliers are many, their density is that of the median part of the working
range, as weak surfaces lie at few ranges and outliers everywhere.
"""

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.estimation.beam import outlier_interval
from tofmix.estimation.noise.series import SeriesStatistics
from tofmix.sensor import NoiseCurve, Sensor

FAR_SIGMAS = 5.0
"""Samples that are farther from the surface are no noise."""

NEIGHBOUR_SIGMAS = 3.0
"""Two of them that are nearer to each other are a weak surface."""

CELLS = 20
"""Parts of the working range."""

LEAST_IN_CELL = 5
"""Mean outliers in a part of the range, from which on the median over parts is used."""

_SUSPECT_FACTOR = 1.35  # a series whose spread is that many times sigma(r) may see two surfaces
_BLOCK = 8192  # series at once, for memory


def measure_outliers(
    samples: Float32Array,
    statistics: SeriesStatistics,
    curve: NoiseCurve,
    sensor: Sensor,
    amplitude: FloatArray | None = None,
) -> tuple[float, int]:
    """Share of random values among samples.

    Parameters
    ----------
    samples : (series, frame) float32
        Samples, mm, NaN where invalid.
    statistics : SeriesStatistics
        Of the same series.
    curve : NoiseCurve
        The measured sigma(r).
    sensor : Sensor
        For the interval of random values, as in the estimator (`tofmix.estimation.beam.outlier_interval`).
    amplitude : (series,) float64, optional
        Amplitude of each series, for a curve with a law.

    Returns
    -------
    float
        (k + 0.5) / (n + 1) of k outliers in n samples, scaled to the whole working range; in (0, 1).
    int
        k.
    """
    low, high = outlier_interval(sensor, curve)
    top = high if sensor.range_max_mm is None else high - FAR_SIGMAS * float(curve.sigma(high))
    sigma = curve.sigma(statistics.range_mm, amplitude)
    one = (statistics.kept > 0) & (np.sqrt(statistics.variance) < _SUSPECT_FACTOR * sigma)
    series = np.flatnonzero(one & (statistics.range_mm < top))
    if not low < top or series.size == 0:
        return sensor.outlier_probability or 0.5, 0
    edges = np.linspace(low, top, CELLS + 1)
    seen, exposure, count = np.zeros(CELLS), np.zeros(CELLS), 0
    for start in range(0, series.size, _BLOCK):
        block = series[start : start + _BLOCK]
        centre, reach = statistics.range_mm[block], FAR_SIGMAS * sigma[block]
        alone, weight = _alone(samples[block], centre, reach, curve, (low, top))
        seen += np.histogram(alone, edges, weights=weight)[0]
        count += alone.size
        hidden = _overlap(centre - reach, centre + reach, edges)
        exposure += statistics.valid[block] @ (np.diff(edges) - hidden)
    return _share(seen, exposure, high - low), count


def _alone(
    samples: Float32Array, centre: FloatArray, reach: FloatArray, curve: NoiseCurve, limits: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Outliers that lie alone, and their weights: for each, how many there are that chance has not put together."""
    low, top = limits
    values = np.sort(samples.astype(np.float64), axis=1)  # NaN last
    far = (np.abs(values - centre[:, None]) > reach[:, None]) & (values >= low) & (values <= top)
    rows, cols = np.nonzero(far)
    place = values[rows, cols]
    near = NEIGHBOUR_SIGMAS * curve.sigma(place)
    padded = np.pad(values, ((0, 0), (1, 1)), constant_values=np.nan)
    # A comparison with NaN is false: there is no neighbour.
    has_neighbour = (place - padded[rows, cols] <= near) | (padded[rows, cols + 2] - place <= near)
    others = far.sum(axis=1)[rows] - 1
    weight = np.clip(1.0 - 2.0 * near / (top - low), 0.5, 1.0) ** -others.astype(np.float64)
    return place[~has_neighbour], np.minimum(weight[~has_neighbour], 2.0)


def _overlap(first: FloatArray, last: FloatArray, edges: FloatArray) -> FloatArray:
    """Length (series, cell) of each cell that the intervals [first, last] cover."""
    cover = np.minimum(last[:, None], edges[None, 1:]) - np.maximum(first[:, None], edges[None, :-1])
    return np.asarray(np.maximum(cover, 0.0), dtype=np.float64)


def _share(seen: FloatArray, exposure: FloatArray, length: float) -> float:
    """p(c_r) from the outliers in each cell and its exposure, samples times mm."""
    total, exposed = float(seen.sum()), float(exposure.sum())
    trials = max(exposed / length, 1.0)
    share = (total + 0.5) / (trials + 1.0)
    if total >= LEAST_IN_CELL * len(seen):
        known = exposure > 0
        share = float(np.median(seen[known] / exposure[known])) * length
        share = max(share, 0.5 / (trials + 1.0))
    return min(share, 0.999)
