"""Values that are of no surface: the share of random ones, and the constant of a camera without a return.

The share of random values p(c_r), counted in series that see one surface.

Use it through `noise`, once the curve is measured. An outlier lies more than 5
sigma from the surface, and alone: samples that lie together are a weak surface.
Where outliers are many, their density is that of the median part of the working
range, as weak surfaces lie at few ranges and outliers everywhere.

The value that a camera returns where there is no surface, if it is one value: from the samples of a recording.

Use `no_return_constant` before an estimate. Without a return, many cameras give r_max or another constant; others
scatter there as at a surface. c_0 of equation (1) has the spread that the recording shows.
"""

import numpy as np

from tofmix.arrays import Float32Array, FloatArray
from tofmix.circle import NO_RETURN_SIGMAS
from tofmix.estimation.beam import outlier_interval
from tofmix.estimation.noise.series import SeriesStatistics
from tofmix.estimation.noise.settings import OutlierSettings
from tofmix.recording import DECODED_SAMPLES, SampleSource
from tofmix.sensor import NoiseCurve, Sensor


def no_return_constant(
    source: SampleSource,
    *,
    most_frames: int = 100,
    least_samples: int = 10,
    least_pixels: int = 3,
    near_errors: float = 3.0,
) -> float | None:
    """Find the constant of samples without a return.

    Parameters
    ----------
    source : SampleSource
        The recording, with a noise curve and `range_max_mm`.
    most_frames : int
        Frames that are looked at, from the first on.
    least_samples : int
        Samples that a pixel must have near r_max: 10 equal whole mm come from a spread of 1 mm once in 10^4 pixels.
    least_pixels : int
        Pixels that must agree. No more than agree may scatter around r_max: the few that agree are then stuck pixels.
    near_errors : float
        A pixel scatters around r_max if its mean is this near to it, in standard errors.

    Returns
    -------
    float or None
        The value, mm: at least `least_pixels` pixels have it as their only value within 2 sigma(r_max) of r_max, in at
        least `least_samples` of the first `most_frames` frames. None where there is none, or the sensor has no r_max or
        no noise curve.
    """
    sensor = source.sensor
    if sensor.noise is None or sensor.range_max_mm is None:
        return None
    top, sigma = np.float32(sensor.range_max_mm), float(sensor.noise.sigma(sensor.range_max_mm))
    frames, rows, cols = source.shape
    frames = min(frames, most_frames)
    high = max(source.row_step, DECODED_SAMPLES // (frames * cols) // source.row_step * source.row_step)
    constants, scattered = [np.zeros(0, dtype=np.float32)], 0
    for row in range(0, rows, high):
        samples = source.read_range(slice(0, frames), slice(row, min(row + high, rows)))
        with np.errstate(invalid="ignore"):
            near = np.abs(samples - top) <= NO_RETURN_SIGMAS * sigma
        count = near.sum(axis=0)
        low = np.where(near, samples, np.inf).min(axis=0)
        most = np.where(near, samples, -np.inf).max(axis=0)
        mean = np.where(near, samples - top, 0.0).sum(axis=0) / np.maximum(count, 1)
        told, one = count >= least_samples, low == most
        constants.append(most[told & one])
        as_scattered = np.abs(mean) <= near_errors * sigma / np.sqrt(np.maximum(count, 1))
        scattered += int((told & ~one & as_scattered).sum())
    values, pixels = np.unique(np.concatenate(constants), return_counts=True)
    if not len(values) or pixels.max() < max(least_pixels, scattered):
        return None
    return float(values[np.argmax(pixels)])


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
