"""The noise curve sigma(r) and the share of outliers, measured from a recording itself.

Use `measure_noise` where a camera's curve is not known, or to check the one that
is. It needs pixels that see one surface; up to 40 % may see several. Nothing here
knows a curve beforehand.

1. `series` gives each pixel's variance and shape, run of frames by run.
2. Series shaped as one Gaussian are sorted by range into bins (`curve`).
3. If amplitudes were recorded and predict held-out pixels better, sigma is a function of range and amplitude
   (`amplitude`); the series are then divided by the factor of amplitude.
4. A bin's sigma is that of the lowest group of its series: two surfaces closer than some 3 sigma look like one
   with a larger sigma, never a smaller one (`curve`).
5. The curve through the bins is divided out and the bins are measured again, so a steep curve within a bin causes no
   error. They are smoothed according to their scatter.

The share of random values p(c_r) is counted in series that see one surface. An outlier lies more than 5 sigma from the
surface, and alone: samples that lie together are a weak surface. Where outliers are many, their density is that of the
median part of the working range, as weak surfaces lie at few ranges and outliers everywhere.

Use `no_return_constant` before an estimate. Without a return, many cameras give r_max or another constant; others
scatter there as at a surface. c_0 of equation (1) has the spread that the recording shows.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.circle import NO_RETURN_SIGMAS
from tofmix.estimation.beam import outlier_interval
from tofmix.estimation.noise.amplitude import ChosenLaw, SpreadSeries, choose_law
from tofmix.estimation.noise.curve import (
    DEFAULT_SETTINGS,
    CurveSettings,
    NoiseSettings,
    OutlierSettings,
    Point,
    cut_into_bins,
    join,
    log_curve,
    measure_bins,
    reference_at,
    single_share,
    smooth,
    with_law,
)
from tofmix.estimation.noise.series import (
    LEAST_SAMPLES,
    Series,
    SeriesStatistics,
    memory_correction,
    quantisation_step,
    read_series,
    series_statistics,
    shaped_as_one,
    trend_degree,
)
from tofmix.noise_shape import RangeStep
from tofmix.recording import DECODED_SAMPLES, SampleSource, by_target
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.wording import counted


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredNoise:
    """Noise of a camera, measured from a recording.

    Parameters
    ----------
    curve : NoiseCurve
        sigma(r), mm; with a law of amplitude where the recording shows one.
    pixels : (n,) int64
        Pixels that determine each point of the curve; 0 for points that follow from neighbours.
    outlier_probability : float
        p(c_r) of equation (1), in (0, 1).
    outlier_samples : int
        Samples that were seen as outliers.
    step_mm : float
        Step of the stored ranges.
    law_gain : float or None
        What the law gains in likelihood, nat, on pixels that no fit has seen; None without a law.
    """

    curve: NoiseCurve
    pixels: IntArray
    outlier_probability: float
    outlier_samples: int
    step_mm: float
    law_gain: float | None = None


def measure_noise(
    source: SampleSource, *, step: RangeStep | None = None, settings: NoiseSettings = DEFAULT_SETTINGS
) -> MeasuredNoise:
    """Measure sigma(r), or sigma by range and amplitude, and p(c_r) from a recording.

    The sensor's own curve is not looked at. The result depends on the samples and their amplitudes alone.

    Parameters
    ----------
    source : SampleSource
        The recording; at least 10 frames, and 20 pixels that see one surface at about one range. Amplitudes are used
        if it is a `tofmix.recording.AmplitudeSource`.
    step : RangeStep, optional
        Step of the stored ranges; default: a common one, from the samples.

    Returns
    -------
    MeasuredNoise
        The curve is linear between its points and constant past its ends, as any `NoiseCurve`.

    Raises
    ------
    ValueError
        If too few pixels see one surface; the text names the missing data.

    References
    ----------
    Basu, Sankhya 15 (1955), 377: shape and variance of a Gaussian sample are independent.
    """
    source = by_target(source)
    series = read_series(source)
    step_mm = quantisation_step(series.samples) if step is None else step.typical()
    found = series_statistics(series, step_mm)
    chosen = single_surface(found, settings)
    at_each = np.array(step_mm) if step is None else step.at(found.range_mm[chosen], series.pixel[chosen])
    bins = cut_into_bins(found.range_mm[chosen], settings.curve)
    if not bins:
        raise ValueError(_what_is_missing(source, found, chosen, settings.curve))
    spread = _Spread(series, found, chosen, bins, at_each, settings)
    law = spread.law()
    points = _without_constant_pile(spread.points(law), source.sensor, settings.pile_sigma)
    curve = join(points, settings.curve)
    if law is not None:
        curve = with_law(curve, law.law, spread.centres)
    p_outlier, n_outliers = measure_outliers(
        series.samples, found, curve, source.sensor, series.amplitude, settings=settings.outliers
    )
    return MeasuredNoise(
        curve=curve,
        pixels=_pixels(curve, points, series.pixel[chosen]),
        outlier_probability=p_outlier,
        outlier_samples=n_outliers,
        step_mm=step_mm,
        law_gain=None if law is None else law.gain,
    )


def single_surface(found: SeriesStatistics, settings: NoiseSettings = DEFAULT_SETTINGS) -> IntArray:
    """Numbers of the series of one surface, by range; all with samples if hardly any passes the tests of shape."""
    usable = found.kept > 0
    fits = usable & shaped_as_one(found, settings.strictness)
    # Noise that is not Gaussian fails the tests nearly everywhere: then they tell nothing of surfaces.
    if fits.sum() < settings.least_fitting * usable.sum():
        fits = usable
    moving = found.variance > 0
    if 2 * (fits & moving).sum() > fits.sum():
        fits &= moving  # the others are stuck, or coarse steps hide their noise
    chosen = np.flatnonzero(fits)
    return chosen[np.argsort(found.range_mm[chosen], kind="stable")]


def _what_is_missing(source: SampleSource, found: SeriesStatistics, chosen: IntArray, settings: CurveSettings) -> str:
    frames = source.shape[0]
    if frames < LEAST_SAMPLES:
        return f"noise: {counted(frames, 'frame')}; at least {LEAST_SAMPLES} are needed to measure it"
    least, filled = settings.least_in_bin, int((found.valid >= LEAST_SAMPLES).sum())
    if filled < least:
        seen = counted(filled, "pixel")
        return f"noise: {seen} with {LEAST_SAMPLES} valid samples or more; at least {least} are needed"
    return (
        f"noise: {counted(chosen.size, 'pixel')} of one surface; measuring needs {least} of them within"
        f" {100 * settings.wide:.0f} % of one range"
    )


class _Spread:
    """The series that measure the noise, by range, in bins."""

    def __init__(
        self,
        series: Series,
        found: SeriesStatistics,
        chosen: IntArray,
        bins: Sequence[slice],
        step: FloatArray,
        settings: NoiseSettings,
    ) -> None:
        self._settings = settings
        self._bins = bins
        self._range, self._variance, self._memory = (
            values[chosen] for values in (found.range_mm, found.variance, found.memory)
        )
        self._log_amplitude, self._pixel = np.log(series.amplitude[chosen]), series.pixel[chosen]
        self._size = int(np.median(found.kept[chosen]))
        self._degrees = self._size - trend_degree(self._size) - 1
        # Sheppard's correction: rounding adds step^2 / 12. What is left of less than that cannot be told.
        self._rounding = step**2 / 12.0
        self.centres = np.array([np.median(self._range[members]) for members in bins])

    def _log_sigma(self, correction: float = 1.0) -> FloatArray:
        corrected = self._variance * correction - self._rounding
        return np.asarray(0.5 * np.log(np.maximum(corrected, self._rounding)), dtype=np.float64)

    def law(self) -> ChosenLaw | None:
        """Choose how noise depends on amplitude, with the slope of the curve by range alone taken out of the bins."""
        if not np.isfinite(self._log_amplitude).any():
            return None
        log_sigma = self._log_sigma()
        points, _ = measure_bins(self._range, log_sigma, self._bins, self._degrees, self._settings.curve)
        group = np.repeat(np.arange(len(self._bins)), [members.stop - members.start for members in self._bins])
        inside = np.concatenate([np.arange(members.start, members.stop) for members in self._bins])
        chosen = choose_law(
            SpreadSeries(
                group=group,
                log_sigma=(log_sigma - log_curve(points, self._range, self._settings.curve))[inside],
                log_amplitude=self._log_amplitude[inside],
                pixel=self._pixel[inside],
                degrees=self._degrees,
            ),
            self._settings.amplitude,
        )
        if chosen is None:
            return None
        # A reference that jumps with the reflectivity of each bin's pixels would make the curve jump with it.
        log_reference = np.log(chosen.law.reference)
        error = np.array([_spread_of(self._log_amplitude[members]) for members in self._bins])
        least = self._settings.curve.least_smoothed
        smoothed = smooth(np.log(np.maximum(self.centres, 1.0)), log_reference, error, least)
        return replace(chosen, law=replace(chosen.law, reference=np.exp(smoothed)))

    def points(self, law: ChosenLaw | None) -> list[Point]:
        """Measure the bins, at the law's factor 1; noise that remembers is corrected."""
        log_factor = np.zeros(len(self._range))
        if law is not None:
            reference = reference_at(law.law, self.centres, self._range)
            known = np.isfinite(self._log_amplitude)
            log_factor = law.law.log_factor(np.where(known, np.exp(self._log_amplitude), reference))
        plain, settings = self._log_sigma() - log_factor, self._settings.curve
        points, located = measure_bins(self._range, plain, self._bins, self._degrees, settings)
        # Surfaces that take turns have no memory: only that of the single series counts, by their variance.
        away = plain - log_curve(points, self._range, settings)
        share = single_share(away, self._degrees, located.chances) * np.exp(2.0 * np.minimum(away, 1.0))
        memory = float(share @ self._memory / share.sum())
        correction = memory_correction(memory, self._size)
        if correction == 1.0:
            return points
        corrected = self._log_sigma(correction) - log_factor
        return measure_bins(self._range, corrected, self._bins, self._degrees, settings)[0]


def _spread_of(log_amplitude: FloatArray) -> float:
    """Standard deviation of the known ones, at least 1 %; 1 without any."""
    known = log_amplitude[np.isfinite(log_amplitude)]
    return max(float(known.std()), 0.01) if known.size else 1.0


def _without_constant_pile(points: list[Point], sensor: Sensor, pile_sigma: float) -> list[Point]:
    """Leave out samples without a return that are a constant: their spread is not sigma(range_max)."""
    if sensor.range_max_mm is None or len(points) == 1:
        return points
    before, last = points[-2:]
    near = last.high >= sensor.range_max_mm - 3.0 * math.exp(before.log_sigma)
    return points[:-1] if near and last.log_sigma < before.log_sigma + math.log(pile_sigma) else points


def _pixels(curve: NoiseCurve, points: Sequence[Point], pixel: IntArray) -> IntArray:
    """Pixels that determine each point of the curve; 0 between the bins' centres."""
    count = np.zeros(len(curve.range_mm), dtype=np.int64)
    for point in points:
        nearest = int(np.argmin(np.abs(curve.range_mm - point.centre)))
        count[nearest] += len(np.unique(pixel[point.members]))
    return count


def disagreement(measured: MeasuredNoise, curve: NoiseCurve) -> tuple[float, float]:
    """Largest difference of a curve and the recording: range, mm, and the curve's sigma over the measured one.

    Only ranges at which the recording determines sigma count.

    Parameters
    ----------
    measured : MeasuredNoise
        Result of `measure_noise`.
    curve : NoiseCurve
        The curve to check.

    Returns
    -------
    float, float
        Range and ratio.
    """
    seen = measured.pixels > 0
    range_mm = measured.curve.range_mm[seen]
    ratio = curve.sigma(range_mm) / measured.curve.sigma_mm[seen]
    worst = int(np.argmax(np.abs(np.log(ratio))))
    return float(range_mm[worst]), float(ratio[worst])
