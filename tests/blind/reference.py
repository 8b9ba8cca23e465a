"""Equation (1) as the bench understands it: each sample's normal score under the model without effects.

Use it to show that without an effect recording and model agree, and as the ruler of the detectors that measure
what is faint.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from blind.camera import Device
from blind.geometry import Array, Beams, Surface


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeTable:
    """Sigma by amplitude as in a model file: a factor, a power law between its points, constant beyond."""

    reference: Array
    amplitude: Array
    factor: Array
    """`amplitude`, `factor`: """

    def log_factor(self, amplitude: Array) -> Array:
        """Logarithm of the factor."""
        return np.asarray(np.interp(np.log(amplitude), np.log(self.amplitude), np.log(self.factor)))


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseTable:
    """sigma(r) as in a model file: linear between the points, constant beyond; times a factor by amplitude, if any."""

    range_mm: Array
    sigma_mm: Array
    by_amplitude: AmplitudeTable | None = None

    def sigma(self, range_mm: Array, amplitude: Array | None = None) -> Array:
        """Sigma at ranges, mm, and at reported amplitudes; without these at the reference amplitude."""
        sigma = np.asarray(np.interp(range_mm, self.range_mm, self.sigma_mm))
        if amplitude is None or self.by_amplitude is None:
            return sigma
        reference = np.interp(range_mm, self.range_mm, self.by_amplitude.reference)
        table = self.by_amplitude
        return np.asarray(sigma * np.exp(table.log_factor(amplitude) - table.log_factor(reference)))


def amplitudes(beams: Beams, device: Device, surfaces: list[Surface]) -> Array:
    """Reported amplitude (L, pixel) of each surface of a beam; small where there is none."""
    reflectivity = np.array([s.reflectivity for s in surfaces] + [0.0])
    gloss = reflectivity[beams.surface] * beams.cosine
    return np.asarray(np.maximum(device.amplitude(beams.range_mm, gloss) * device.amplitude_unit, 1e-9))


def cdf(range_mm: Array, beams: Beams, device: Device, noise: NoiseTable, amplitude: Array | None = None) -> Array:
    """Probability (frame, pixel) of a sample at or below each range, before rounding.

    `amplitude` (L, pixel) are the surfaces' reported amplitudes, for noise by amplitude.
    """
    returned = 1.0 - device.outlier_probability
    width = device.range_max_mm - device.range_min_mm
    out = device.outlier_probability * np.clip((range_mm - device.range_min_mm) / width, 0, 1)
    for layer, (share, mean) in enumerate(zip(beams.share, beams.range_mm, strict=True)):
        seen = np.flatnonzero(share)
        if seen.size:
            sigma = noise.sigma(mean[seen], None if amplitude is None else amplitude[layer, seen])
            out[:, seen] += returned * share[seen] * ndtr((range_mm[:, seen] - mean[seen]) / sigma)
    gap = np.flatnonzero(beams.nothing)
    if gap.size:
        far = device.range_max_mm
        out[:, gap] += returned * beams.nothing[gap] * ndtr((range_mm[:, gap] - far) / noise.sigma(np.array(far)))
    return np.asarray(out)


def uniforms(
    range_mm: Array,
    beams: Beams,
    device: Device,
    noise: NoiseTable,
    rng: np.random.Generator,
    amplitude: Array | None = None,
) -> Array:
    """Probability integral transform (frame, pixel), drawn at random within each whole millimetre; NaN where lost."""
    below = cdf(range_mm - 0.5, beams, device, noise, amplitude)
    above = cdf(range_mm + 0.5, beams, device, noise, amplitude)
    return np.asarray(below + (above - below) * rng.random(range_mm.shape))


def scores(
    range_mm: Array,
    beams: Beams,
    device: Device,
    noise: NoiseTable,
    rng: np.random.Generator,
    amplitude: Array | None = None,
) -> Array:
    """Standard normal scores (frame, pixel), limited to +-6; NaN where lost."""
    u = uniforms(range_mm, beams, device, noise, rng, amplitude)
    return np.asarray(np.clip(ndtri(np.clip(u, 1e-12, 1 - 1e-12)), -6.0, 6.0))
