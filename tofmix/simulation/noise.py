"""The parts of a camera's noise beyond sigma(r): the shape of the error, each pixel's own width, the amplitude's noise.

Effects act on Gaussian noise, which alone keeps its distribution under memory. The sample is the quantile of the shape
at the same probability (a Gaussian copula).
"""

import math
import zlib

import numpy as np
from scipy.special import ndtr

from tofmix.arrays import FloatArray
from tofmix.noise_shape import NoiseShape
from tofmix.sensors.camera import CompleteCamera

_STREAM = (zlib.crc32(b"noise width"), 0)
"""Where the widths' random stream is among those of a recording: no frame and no effect has it."""

_AMPLITUDE_STREAM = zlib.crc32(b"amplitude noise")
"""Before the frame's number, the key of its amplitudes' stream: ranges are drawn as if amplitudes had no noise."""


def amplitude_draws(pixels: int, *, seed: int, frame: int) -> FloatArray:
    """Standard normal noise (pixel,) of a frame's amplitudes, from a random stream of its own."""
    key = (_AMPLITUDE_STREAM, frame)
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key))).standard_normal(pixels)


def noisy_amplitude(amplitude: FloatArray, sigma_mm: FloatArray, draws: FloatArray, *, turn_mm: float) -> FloatArray:
    """Amplitudes as they are measured.

    The noise of a phasor z is the same in both directions. Across z it turns the phase, a range noise of sigma; along
    z it changes the amplitude A by A sigma 2 pi / d_u.

    Parameters
    ----------
    amplitude : (pixel,) float64
        Of the light, at least 0; 0 stays 0.
    sigma_mm : (pixel,) float64
        Each sample's range noise, mm.
    draws : (pixel,) float64
        Standard normal noise.
    turn_mm : float
        d_u, mm; NaN where the camera has no modulation frequency: then amplitudes have no noise.

    Returns
    -------
    (pixel,) float64
        At least 0: negative values become 0.
    """
    if math.isnan(turn_mm):
        return amplitude
    return np.maximum(amplitude * (1.0 + sigma_mm * (2 * math.pi / turn_mm) * draws), 0.0)


def shaped(noise: FloatArray, shape: NoiseShape | None) -> FloatArray:
    """Standard normal noise, of any shape of array, as noise of a shape: the same chance of lying below."""
    return noise if shape is None else shape.quantile(ndtr(noise))


def drawn_widths(sensor: CompleteCamera, *, seed: int) -> FloatArray | None:
    """Each pixel's own width, a factor on sigma for a whole recording.

    Parameters
    ----------
    sensor : CompleteCamera
        The camera.
    seed : int
        The recording's seed.

    Returns
    -------
    (pixel,) float64 or None
        Log-normal, with median 1; None if all pixels are equal.
    """
    spread = sensor.noise.width_spread
    if not spread:
        return None
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=_STREAM)))
    widths: FloatArray = np.exp(spread * rng.standard_normal(sensor.rows * sensor.cols))
    return widths
