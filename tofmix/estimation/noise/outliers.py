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
from tofmix.estimation.noise.settings import OutlierSettings
from tofmix.sensor import NoiseCurve, Sensor

_BLOCK = 8192  # series at once, for memory


def measure_outliers(
    samples: Float32Array,
    statistics: SeriesStatistics,
    curve: NoiseCurve,
    sensor: Sensor,
    amplitude: FloatArray | None = None,
    *,
    settings: OutlierSettings,
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
    settings : OutlierSettings
        Thresholds.

    Returns
    -------
    float
        (k + 0.5) / (n + 1) of k outliers in n samples, scaled to the whole working range; in (0, 1).
    int
        k.
    """
    low, high = outlier_interval(sensor, curve)
    top = high if sensor.range_max_mm is None else high - settings.far_sigmas * float(curve.sigma(high))
    sigma = curve.sigma(statistics.range_mm, amplitude)
    one = (statistics.kept > 0) & (np.sqrt(statistics.variance) < settings.suspect_factor * sigma)
    series = np.flatnonzero(one & (statistics.range_mm < top))
    if not low < top or series.size == 0:
        return sensor.outlier_probability or 0.5, 0
    edges = np.linspace(low, top, settings.cells + 1)
    seen, exposure, count = np.zeros(settings.cells), np.zeros(settings.cells), 0
    for start in range(0, series.size, _BLOCK):
        block = series[start : start + _BLOCK]
        centre, reach = statistics.range_mm[block], settings.far_sigmas * sigma[block]
        alone, weight = _alone(samples[block], centre, reach, curve, (low, top), settings.neighbour_sigmas)
        seen += np.histogram(alone, edges, weights=weight)[0]
        count += alone.size
        hidden = _overlap(centre - reach, centre + reach, edges)
        exposure += statistics.valid[block] @ (np.diff(edges) - hidden)
    return _share(seen, exposure, high - low, settings.least_in_cell), count


def _alone(
    samples: Float32Array,
    centre: FloatArray,
    reach: FloatArray,
    curve: NoiseCurve,
    limits: tuple[float, float],
    neighbour_sigmas: float,
) -> tuple[FloatArray, FloatArray]:
    """Outliers that lie alone, and their weights: for each, how many there are that chance has not put together."""
    low, top = limits
    values = np.sort(samples.astype(np.float64), axis=1)  # NaN last
    far = (np.abs(values - centre[:, None]) > reach[:, None]) & (values >= low) & (values <= top)
    rows, cols = np.nonzero(far)
    place = values[rows, cols]
    near = neighbour_sigmas * curve.sigma(place)
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


def _share(seen: FloatArray, exposure: FloatArray, length: float, least_in_cell: int) -> float:
    """p(c_r) from the outliers in each cell and its exposure, samples times mm."""
    total, exposed = float(seen.sum()), float(exposure.sum())
    trials = max(exposed / length, 1.0)
    share = (total + 0.5) / (trials + 1.0)
    if total >= least_in_cell * len(seen):
        known = exposure > 0
        share = float(np.median(seen[known] / exposure[known])) * length
        share = max(share, 0.5 / (trials + 1.0))
    return min(share, 0.999)
