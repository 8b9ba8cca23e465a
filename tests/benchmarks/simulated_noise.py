"""Recordings of noise that is not Gaussian, for tests/benchmarks/real.py: one surface in each pixel, or three.

`NOISES` are errors in units of sigma, of mean 0 and standard deviation 1 before widths, drift and background come in.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from tofmix.arrays import FloatArray, IntArray
from tofmix.sensor import NoiseCurve, Sensor

LOW_MM, TOP_MM = 300.0, 6000.0
"""Working range, over which background is uniform."""

NEAR_MM, FAR_MM = 500.0, 5500.0
"""Surfaces stand between these: more than 10 sigma from the ends, where nothing returns or nothing is seen."""

CURVE = NoiseCurve(np.array([LOW_MM, TOP_MM]), np.array([12.3, 18.0]))
"""sigma(r) = 12 mm + 0.001 r: like no camera of the package."""

MOST_BACKGROUND = 0.9
WIDTH_SPREAD = 0.3
DRIFT_SIGMAS = 3.0
MEMORY = 0.5

CAMERA = Sensor(name="benchmark", range_min_mm=LOW_MM, range_max_mm=TOP_MM)
"""As a recording of an unknown camera has it: a working range and no noise curve."""

Errors = Callable[[np.random.Generator, int, int], FloatArray]


def gaussian(rng: np.random.Generator, frames: int, pixels: int) -> FloatArray:
    """Gaussian errors (frame, pixel)."""
    return rng.standard_normal((frames, pixels))


def skewed(rng: np.random.Generator, frames: int, pixels: int) -> FloatArray:
    """A shifted gamma distribution of skewness 1: its shape is 4."""
    return np.asarray(rng.standard_gamma(4.0, (frames, pixels)) / 2.0 - 2.0)


def student(rng: np.random.Generator, frames: int, pixels: int) -> FloatArray:
    """Student t of 5 degrees, whose variance is 5 / 3."""
    return np.asarray(rng.standard_t(5.0, (frames, pixels)) / np.sqrt(5.0 / 3.0))


def laplace(rng: np.random.Generator, frames: int, pixels: int) -> FloatArray:
    """Laplace errors, whose variance is 2."""
    return np.asarray(rng.laplace(size=(frames, pixels)) / np.sqrt(2.0))


def remembering(rng: np.random.Generator, frames: int, pixels: int) -> FloatArray:
    """AR(1) of coefficient 0.5, stationary from the first frame on."""
    new = np.sqrt(1.0 - MEMORY**2) * rng.standard_normal((frames, pixels))
    new[0] /= np.sqrt(1.0 - MEMORY**2)
    return np.asarray(lfilter([1.0], [1.0, -MEMORY], new, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise of a simulated recording."""

    errors: Errors = gaussian
    """Errors (frame, pixel) in sigma."""
    width_spread: float = 0.0
    """Standard deviation of the logarithm of a pixel's own width."""
    most_background: float = 0.0
    """Shares of background are uniform from 0 to this by pixel."""
    drift_sigmas: float = 0.0
    """Straight drift over all frames, in sigma of the curve; up or down by pixel."""


NOISES: dict[str, Noise] = {
    "Gaussian": Noise(),
    "skewness 1": Noise(errors=skewed),
    "Student t (5)": Noise(errors=student),
    "Laplace": Noise(errors=laplace),
    "widths spread by 0.3": Noise(width_spread=WIDTH_SPREAD),
    "background 0 to 0.9": Noise(most_background=MOST_BACKGROUND),
    "drift of 3 sigma": Noise(drift_sigmas=DRIFT_SIGMAS),
    "AR(1) 0.5": Noise(errors=remembering),
    "skewness, widths, background, drift": Noise(
        errors=skewed, width_spread=WIDTH_SPREAD, most_background=MOST_BACKGROUND, drift_sigmas=DRIFT_SIGMAS
    ),
}


class Drawn(NamedTuple):
    """Samples (frame, pixel), mm; what they were drawn with (pixel,)."""

    samples: FloatArray
    range_mm: FloatArray
    background: FloatArray
    of_surface: IntArray
    """Samples that are the surface's."""


def draw(noise: Noise, frames: int, pixels: int, rng: np.random.Generator) -> Drawn:
    """Samples of pixels that see one surface each, anywhere in range."""
    place = rng.uniform(NEAR_MM, FAR_MM, pixels)
    sigma = CURVE.sigma(place)
    width = np.exp(noise.width_spread * rng.standard_normal(pixels))
    drift = rng.choice([-1.0, 1.0], pixels) * noise.drift_sigmas * np.linspace(-0.5, 0.5, frames)[:, None]
    samples = place + sigma * (width * noise.errors(rng, frames, pixels) + drift)
    background = rng.uniform(0.0, noise.most_background, pixels)
    random = rng.random((frames, pixels)) < background
    samples[random] = rng.uniform(LOW_MM, TOP_MM, int(random.sum()))
    return Drawn(samples, place, background, frames - random.sum(axis=0))


def draw_three(frames: int, pixels: int, distance: float, rng: np.random.Generator) -> Drawn:
    """Samples of pixels that see three surfaces each, `distance` sigma apart, with shares of 0.2 and more."""
    middle = rng.uniform(NEAR_MM + 500.0, FAR_MM - 500.0, pixels)
    share = 0.2 + 0.4 * rng.dirichlet(np.ones(3), pixels)
    chance = rng.random((frames, pixels))
    which = (chance > share[:, 0]).astype(np.int64) + (chance > share[:, 0] + share[:, 1])
    place = middle + distance * CURVE.sigma(middle) * (which - 1)
    samples = place + CURVE.sigma(place) * rng.standard_normal((frames, pixels))
    return Drawn(samples, middle, np.zeros(pixels), np.full(pixels, frames))
