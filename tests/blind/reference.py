"""Equation (1) as the bench understands it: each sample's normal score under the model without effects.

Use it to show that without an effect recording and model agree, and as the ruler of the detectors that measure
what is faint.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from blind.camera import Device
from blind.geometry import Array, Beams


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseTable:
    """sigma(r) as in a model file: linear between the points, constant beyond."""

    range_mm: Array
    sigma_mm: Array

    def sigma(self, range_mm: Array) -> Array:
        """Sigma at ranges, mm."""
        return np.asarray(np.interp(range_mm, self.range_mm, self.sigma_mm))


def cdf(range_mm: Array, beams: Beams, device: Device, noise: NoiseTable) -> Array:
    """Probability (frame, pixel) of a sample at or below each range, before rounding."""
    returned = 1.0 - device.outlier_probability
    width = device.range_max_mm - device.range_min_mm
    out = device.outlier_probability * np.clip((range_mm - device.range_min_mm) / width, 0, 1)
    for share, mean in zip(beams.share, beams.range_mm, strict=True):
        seen = np.flatnonzero(share)
        if seen.size:
            out[:, seen] += returned * share[seen] * ndtr((range_mm[:, seen] - mean[seen]) / noise.sigma(mean[seen]))
    gap = np.flatnonzero(beams.nothing)
    if gap.size:
        far = device.range_max_mm
        out[:, gap] += returned * beams.nothing[gap] * ndtr((range_mm[:, gap] - far) / noise.sigma(np.array(far)))
    return np.asarray(out)


def uniforms(range_mm: Array, beams: Beams, device: Device, noise: NoiseTable, rng: np.random.Generator) -> Array:
    """Probability integral transform (frame, pixel), drawn at random within each whole millimetre; NaN where lost."""
    below = cdf(range_mm - 0.5, beams, device, noise)
    above = cdf(range_mm + 0.5, beams, device, noise)
    return np.asarray(below + (above - below) * rng.random(range_mm.shape))


def scores(range_mm: Array, beams: Beams, device: Device, noise: NoiseTable, rng: np.random.Generator) -> Array:
    """Standard normal scores (frame, pixel), limited to +-6; NaN where lost."""
    u = uniforms(range_mm, beams, device, noise, rng)
    return np.asarray(np.clip(ndtri(np.clip(u, 1e-12, 1 - 1e-12)), -6.0, 6.0))
