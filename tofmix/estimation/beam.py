"""The fixed part of equation (1), as the kernels read it: the same for every pixel, but for its noise curve.

The noise curve as kernels read it.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.circle import NO_RETURN_SIGMAS, circular_noise, has_no_return
from tofmix.compiled.jit import borrowing
from tofmix.noise_shape import RangeStep
from tofmix.sensor import NoiseCurve, Sensor


@borrowing
def sigma_at(range_mm: float, curve_range: FloatArray, curve_sigma: FloatArray) -> float:
    """sigma(r), linear between the curve's points and constant past its ends."""
    last = len(curve_range) - 1
    if range_mm <= curve_range[0]:
        return float(curve_sigma[0])
    if range_mm >= curve_range[last]:
        return float(curve_sigma[last])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if curve_range[middle] <= range_mm:
            low = middle
        else:
            high = middle
    share = (range_mm - curve_range[low]) / (curve_range[high] - curve_range[low])
    return float(curve_sigma[low] + share * (curve_sigma[high] - curve_sigma[low]))


NO_RETURN_REACH = 6.0
"""Without a sample this near to range_max, in sigmas, p(c_0) is 0 from the start."""


FINE = 0.5
"""A step of fewer sigmas is neglected: it widens sigma by 1 % at most."""

COARSE = 1.0
"""A step of whole mm in integers is neglected up to this many sigmas: spread over the step, it widens sigma by 4 %."""

_SMALLEST_OUTLIER_PROBABILITY = 1.0e-12  # in the density: a sample far from all surfaces has a finite log likelihood


class PixelCurves(NamedTuple):
    """Noise curves of single pixels: `range_mm` and `sigma_mm` (pixel, point); the first `size` (pixel,) count.

    Made by `tofmix.estimation.noise.amplitude`; of no pixel where the beam's curve holds for all.
    """

    range_mm: FloatArray
    sigma_mm: FloatArray
    size: IntArray


class Steps(NamedTuple):
    """Steps of the stored ranges, where they matter: `step_mm` (n,) at `range_mm` (n,), mm; empty where they do not.

    `of_pixel` (pixel,), mm, are steps of single pixels, which `amplitude.beam_of_pixel` puts in the place of the
    common ones; empty where there is none.
    """

    range_mm: FloatArray
    step_mm: FloatArray
    of_pixel: FloatArray


class Background(NamedTuple):
    """Density of random values, 1/mm: `density` (n,) at `range_mm` (n,), mm; empty where they are uniform."""

    range_mm: FloatArray
    density: FloatArray


class Beam(NamedTuple):
    """The fixed part of equation (1), in mm, as the kernels read it.

    `range_max` is infinite where the sensor has no such limit; there is no c_0 then. c_0 lies at `range_max` with the
    spread `sigma_max`: sigma(r_max), or the constant that the camera returns and its spread. A peak past
    `no_return_from`, up to `no_return_to`, belongs to c_0; the latter is infinite but on a circle. No surface lies past
    `surface_end`, the sensor's r_max, up to there. `outlier_density` is p(c_r) / (range_max - range_min), 1/mm.
    `range_min` and `range_top`, always finite, are the ends of that interval: the working range, or its substitute
    (`outlier_interval`). `pixel_curves` are the curves of single pixels, which `amplitude.beam_of_pixel` puts in the
    place of the common one. `steps` are those of the stored ranges; only the learnt engine reads them. `background` is
    the density of random values where it is not uniform; p(c_r) times it then stands for `outlier_density`.
    """

    curve_range: FloatArray
    curve_sigma: FloatArray
    range_max: float
    sigma_max: float
    no_return_from: float
    no_return_to: float
    surface_end: float
    p_outlier: float
    outlier_density: float
    range_min: float
    range_top: float
    pixel_curves: PixelCurves
    steps: Steps
    background: Background


def uniform_background() -> Background:
    """Make the density of random values that are uniform over the working range."""
    return Background(np.zeros(0), np.zeros(0))


def background_of(curve: NoiseCurve) -> Background:
    """Density of random values as kernels read it."""
    density = curve.background_density
    if density is None:
        return uniform_background()
    return Background(np.array(density.range_mm), np.array(density.density))


@borrowing
def is_uniform(beam: Beam) -> bool:
    """Whether random values are uniform over the working range."""
    return len(beam.background.range_mm) == 0


@borrowing
def background_at(range_mm: float, beam: Beam) -> float:
    """Density of random values at a range, 1/mm."""
    if is_uniform(beam):
        return 1.0 / (beam.range_top - beam.range_min)
    return sigma_at(range_mm, beam.background.range_mm, beam.background.density)  # linear, constant past the ends


@borrowing
def outlier_density_at(range_mm: float, beam: Beam) -> float:
    """p(c_r) times the density of random values at a range, 1/mm."""
    if is_uniform(beam):
        return beam.outlier_density
    return beam.outlier_density * (beam.range_top - beam.range_min) * background_at(range_mm, beam)


def no_pixel_curves() -> PixelCurves:
    """Make the curves of no pixel: the beam's curve holds for all."""
    return PixelCurves(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0, dtype=np.int64))


def no_steps() -> Steps:
    """Make the steps of samples whose step does not matter."""
    return Steps(np.zeros(0), np.zeros(0), np.zeros(0))


def steps_of(step: RangeStep | None, curve: NoiseCurve) -> Steps:
    """Steps as kernels read them; none where no step is `FINE` sigmas or more."""
    return no_steps() if step is None or not step_matters(step, curve) else all_steps(step)


def all_steps(step: RangeStep) -> Steps:
    """Steps as kernels read them, whether they matter or not."""
    own = np.zeros(0) if step.own_mm is None else np.where(np.isfinite(step.own_mm), step.own_mm, step.typical())
    return Steps(np.array(step.range_mm), np.array(step.step_mm), own)


def step_matters(step: RangeStep, curve: NoiseCurve, *, of_type: bool = False) -> bool:
    """Whether a step is `FINE` sigmas or more at some range of the curve; `COARSE` if it is that of the stored type."""
    return bool((step.at(curve.range_mm) >= (COARSE if of_type else FINE) * curve.sigma_mm).any())


@borrowing
def is_no_return(range_mm: float, beam: Beam) -> bool:
    """Whether a peak there belongs to c_0: where a count starts, and all that the paper's procedure has."""
    return beam.no_return_from < range_mm <= beam.no_return_to


@borrowing
def is_beyond(range_mm: float, beam: Beam) -> bool:
    """Whether it is beyond the working range, where no surface is found."""
    return beam.surface_end < range_mm <= beam.no_return_to


@borrowing
def near_no_return(range_mm: float, sigmas: float, beam: Beam) -> bool:
    """Whether c_0 lies within so many of its sigmas; false where the sensor has no end of range."""
    return bool(abs(beam.range_max - range_mm) < sigmas * beam.sigma_max)


@borrowing
def reaches_no_return(samples: FloatArray, beam: Beam) -> bool:
    """Whether any of the sorted samples lies so near to range_max that there may be a c_0."""
    reach = NO_RETURN_REACH * beam.sigma_max
    j = len(samples) - 1
    if not math.isinf(beam.no_return_to):
        while j >= 0 and samples[j] > beam.range_max + reach:
            j -= 1
    return j >= 0 and samples[j] > beam.range_max - reach


def outlier_interval(sensor: Sensor, curve: NoiseCurve) -> tuple[float, float]:
    """Where random values spread, mm, if ranges are on a line.

    It is the working range. Where `range_max_mm` is not known, it ends at the recording's largest sample, and begins at
    `range_min_mm`, or without one at the least sample. A sensor with neither is not that of a recording: the interval
    then ends at the last range of the curve, and begins at `range_min_mm` or 0.

    Parameters
    ----------
    curve : NoiseCurve
        sigma(r): between samples, the interval is at least six sigma wide.

    Returns
    -------
    float, float
        Its ends; the second is not above the first where `range_min_mm` does not fit the curve.
    """
    low = sensor.range_min_mm or 0.0
    if sensor.range_max_mm is not None:
        return low, sensor.range_max_mm
    least, largest = sensor.sample_min_mm, sensor.sample_max_mm
    if least is None or largest is None:
        return low, float(curve.range_mm[-1])
    if sensor.range_min_mm is not None and sensor.range_min_mm < largest:
        least = sensor.range_min_mm
    # sigmas at least: as far as samples of one surface spread
    lacking = max(0.0, 6.0 * float(curve.sigma(largest)) - (largest - least))
    return least - 0.5 * lacking, largest + 0.5 * lacking


def beam_of(sensor: Sensor, unambiguous_range_mm: float | None = None, *, at_fold: bool = True) -> Beam:
    """Take the fixed part of equation (1) from a sensor.

    `outlier_interval` gives the interval of random values; on a circle without `range_max_mm` it is the whole circle.
    The working range of a circle is one turn from `range_min_mm` on; random values are uniform over it.

    Parameters
    ----------
    unambiguous_range_mm : float, optional
        Length of the circle that ranges are on, mm; a line without it.
    at_fold : bool
        Whether a surface may lie at the fold, as for `tofmix.circle.circular_noise`.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, the random values have no interval to spread over, or the circle is too
        short for the noise or the working range.
    """
    if unambiguous_range_mm is not None:
        return _circular_beam(sensor, unambiguous_range_mm, at_fold=at_fold)
    if sensor.noise is None:
        raise ValueError("the sensor has no noise curve sigma(r)")
    low, high = outlier_interval(sensor, sensor.noise)
    if high <= low:
        raise ValueError(f"range_min_mm {low:g} is not below the last range {high:g} of the noise curve")
    range_max = np.inf if sensor.range_max_mm is None else sensor.range_max_mm
    sigma_max = float(sensor.noise.sigma(high))
    p_outlier, constant = sensor.outlier_probability, sensor.no_return_mm
    constant_sigma_mm = 0.5  # spread of c_0, mm, where the camera returns one value for it: half a step of whole mm
    return Beam(
        curve_range=np.array(sensor.noise.range_mm),
        curve_sigma=np.array(sensor.noise.sigma_mm),
        range_max=float(range_max) if constant is None else constant,
        sigma_max=sigma_max if constant is None else constant_sigma_mm,
        no_return_from=float(range_max - NO_RETURN_SIGMAS * sigma_max),
        no_return_to=np.inf,
        surface_end=float(range_max),
        p_outlier=p_outlier,
        # With p(c_r) = 0 a sample far from every surface would have no likelihood at all.
        outlier_density=max(p_outlier, _SMALLEST_OUTLIER_PROBABILITY) / (high - low),
        range_min=float(low),
        range_top=float(high),
        pixel_curves=no_pixel_curves(),
        steps=steps_of(sensor.step, sensor.noise),
        background=background_of(sensor.noise),
    )


def _circular_beam(sensor: Sensor, length: float, *, at_fold: bool) -> Beam:
    """The beam on a circle; without c_0 if it could not be separated from a surface at the fold."""
    curve = circular_noise(sensor, length, at_fold=at_fold)
    low = sensor.range_min_mm or 0.0
    if not low < length:
        raise ValueError(f"range_min_mm {low:g} is not below the unambiguous range {length:g} mm")
    range_max, sigma_max = math.inf, float(curve.sigma(length))
    if sensor.range_max_mm is not None and has_no_return(sensor, length):
        range_max, sigma_max = sensor.range_max_mm, float(curve.sigma(sensor.range_max_mm))
    spread = length if sensor.range_max_mm is None else min(sensor.range_max_mm - low, length)
    return Beam(
        curve_range=np.array(curve.range_mm),
        curve_sigma=np.array(curve.sigma_mm),
        range_max=range_max,
        sigma_max=sigma_max,
        no_return_from=range_max - NO_RETURN_SIGMAS * sigma_max,
        no_return_to=range_max + NO_RETURN_SIGMAS * sigma_max if math.isfinite(range_max) else math.inf,
        surface_end=range_max,
        p_outlier=sensor.outlier_probability,
        outlier_density=max(sensor.outlier_probability, _SMALLEST_OUTLIER_PROBABILITY) / spread,
        range_min=low,
        range_top=low + length,
        pixel_curves=no_pixel_curves(),
        steps=steps_of(sensor.step, curve),
        background=uniform_background(),
    )
