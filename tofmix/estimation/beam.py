"""The fixed part of equation (1), as the kernels read it: the same for every pixel, but for curves of their own."""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.sensor import Sensor

NO_RETURN_SIGMAS = 2.0
"""A surface within this many sigma of `range_max_mm` is taken as no return, c_0."""

_SMALLEST_OUTLIER_PROBABILITY = 1.0e-12


class OwnCurves(NamedTuple):
    """Noise curves of single pixels: `range_mm` and `sigma_mm` (pixel, point); the first `size` (pixel,) count.

    Made by `tofmix.estimation.pixel_noise`; of no pixel where the beam's curve holds for all.
    """

    range_mm: FloatArray
    sigma_mm: FloatArray
    size: IntArray


class Beam(NamedTuple):
    """The fixed part of equation (1), in mm, as the kernels read it.

    `range_max` is infinite where the sensor has no such limit; there is no c_0 then.
    `outlier_density` is p(c_r) / (range_max - range_min), 1/mm. `range_min` and `range_top`, always
    finite, are the ends of that interval: the working range, or what stands in for it. `own` are the curves of single
    pixels, for `pixel_noise.beam_of_pixel` to put in the place of the common one.
    """

    curve_range: FloatArray
    curve_sigma: FloatArray
    range_max: float
    sigma_max: float
    no_return_from: float
    p_outlier: float
    outlier_density: float
    range_min: float
    range_top: float
    own: OwnCurves


def beam_of(sensor: Sensor) -> Beam:
    """Take the fixed part of equation (1) from a sensor.

    Without `range_max_mm`, the random values spread up to the last range of the noise curve.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or the random values have no interval to spread over.
    """
    if sensor.noise is None:
        raise ValueError("the sensor has no noise curve sigma(r)")
    low = sensor.range_min_mm or 0.0
    high = float(sensor.noise.range_mm[-1]) if sensor.range_max_mm is None else sensor.range_max_mm
    if high <= low:
        raise ValueError(f"range_min_mm {low:g} is not below the last range {high:g} of the noise curve")
    range_max = np.inf if sensor.range_max_mm is None else sensor.range_max_mm
    sigma_max = float(sensor.noise.sigma(high))
    p_outlier = sensor.outlier_probability
    return Beam(
        curve_range=np.array(sensor.noise.range_mm),
        curve_sigma=np.array(sensor.noise.sigma_mm),
        range_max=float(range_max),
        sigma_max=sigma_max,
        no_return_from=float(range_max - NO_RETURN_SIGMAS * sigma_max),
        p_outlier=p_outlier,
        # With p(c_r) = 0 a sample far from every surface would have no likelihood at all.
        outlier_density=max(p_outlier, _SMALLEST_OUTLIER_PROBABILITY) / (high - low),
        range_min=float(low),
        range_top=float(high),
        own=OwnCurves(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0, dtype=np.int64)),
    )
