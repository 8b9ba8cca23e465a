"""The parts of a camera's noise beyond sigma(r): the shape of the error, and each pixel's own width.

Effects act on Gaussian noise, which alone keeps its distribution where samples remember each other; what is measured
is the shape's quantile at the same chance (a Gaussian copula).
"""

import zlib

import numpy as np
from scipy.special import ndtr

from tofmix.arrays import FloatArray
from tofmix.noise_shape import NoiseShape
from tofmix.sensors.profile import SensorProfile

_STREAM = (zlib.crc32(b"noise width"), 0)
"""Where the widths' random stream is among those of a recording: no frame and no effect has it."""


def shaped(noise: FloatArray, shape: NoiseShape | None) -> FloatArray:
    """Standard normal noise, of any shape of array, as noise of a shape: the same chance of lying below."""
    return noise if shape is None else shape.quantile(ndtr(noise))


def drawn_widths(sensor: SensorProfile, *, seed: int) -> FloatArray | None:
    """Each pixel's own width, a factor on sigma for a whole recording.

    Parameters
    ----------
    sensor : SensorProfile
        The camera.
    seed : int
        The recording's seed.

    Returns
    -------
    (pixel,) float64 or None
        Log-normal, of the median 1; None where all pixels are alike.
    """
    spread = sensor.noise.width_spread
    if not spread:
        return None
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=_STREAM)))
    widths: FloatArray = np.exp(spread * rng.standard_normal(sensor.rows * sensor.cols))
    return widths
