"""Pixels that the noise is learnt from."""

from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pixels:
    """Samples of some pixels, each in one window.

    Parameters
    ----------
    samples : (pixel, frame) float32
        Samples in the order of frames, mm, NaN where invalid. Their rounding is spread evenly over its step.
    amplitude : (pixel, frame) float32, optional
        Their amplitudes, in the unit of the recording.
    rounding_mm : float
        Step of the stored ranges, mm.
    """

    samples: Float32Array
    amplitude: Float32Array | None = None
    rounding_mm: float = 0.0

    def chosen(self, which: BoolArray) -> "Pixels":
        """Return the pixels for which `which` (pixel,) is true."""
        light = None if self.amplitude is None else np.ascontiguousarray(self.amplitude[which])
        return Pixels(samples=np.ascontiguousarray(self.samples[which]), amplitude=light, rounding_mm=self.rounding_mm)

    def some(self, most: int) -> "Pixels":
        """Return at most `most` pixels, evenly spread."""
        count = len(self.samples)
        if count <= most:
            return self
        which = np.zeros(count, dtype=np.bool_)
        which[np.linspace(0, count - 1, most).astype(int)] = True
        return self.chosen(which)


def medians(samples: Float32Array) -> FloatArray:
    """Median of the valid samples (pixel, frame) of each pixel that has one, mm; pixels without one are left out."""
    return np.array([float(np.median(row[np.isfinite(row)])) for row in samples if np.isfinite(row).any()])
