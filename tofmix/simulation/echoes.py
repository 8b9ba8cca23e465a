"""Echoes in the camera, on which effects act.

`Echoes` is the common part of the samples of one frame (`FrameSamples`) and the components of a predictive distribution
(`tofmix.simulation.exposure`), so one piece of code applies an effect to both.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.simulation.events import stored_range

ComplexArray = NDArray[np.complex128]


@dataclass(slots=True, kw_only=True, eq=False)
class Echoes:
    """Means and noise of echoes; the arrays have one shape, (pixel,) or (component, pixel).

    Parameters
    ----------
    turn_mm : float
        d_u of the modulation, mm.
    surface : int64
        Number of the surface that the echo is from; -1 without one.
    true_range_mm : float64
        True range of it, mm.
    range_mm : float64
        Mean range, mm: light and bias included, noise and folding not.
    amplitude : float64
        Amplitude |z|.
    sigma_mm : float64
        Standard deviation of the range, mm.
    period_mm : float or None
        Where ranges fold, noise and bias included; None if they do not.
    """

    turn_mm: float
    surface: IntArray
    true_range_mm: FloatArray
    range_mm: FloatArray
    amplitude: FloatArray
    sigma_mm: FloatArray
    period_mm: float | None = None

    @property
    def returned(self) -> BoolArray:
        """Which echoes are from a surface. Those without a return stay as they are (the contract)."""
        return np.asarray(self.surface >= 0, dtype=np.bool_)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the arrays; the last axis is the pixel."""
        return self.range_mm.shape

    def add_bias(self, bias_mm: FloatArray | float) -> None:
        """Move the mean range of echoes from surfaces; sigma stays."""
        self.range_mm = self.range_mm + np.where(self.returned, bias_mm, 0.0)

    def scale_sigma(self, factor: FloatArray | float) -> None:
        """Multiply the noise of echoes from surfaces."""
        self.sigma_mm = self.sigma_mm * np.where(self.returned, factor, 1.0)

    def phasor(self) -> ComplexArray:
        """z, amplitude times exp(2 pi i r / d_u); 0 without a surface."""
        phase = self.range_mm * (2 * math.pi / self.turn_mm)
        z = np.empty(self.shape, dtype=np.complex128)
        z.real = np.cos(phase)
        z.imag = np.sin(phase)
        z *= np.where(self.returned, self.amplitude, 0.0)
        return z

    def replace_phasor(self, before: ComplexArray, after: ComplexArray) -> None:
        """Replace z by z'.

        The new range is d_u arg(z') / 2 pi on the turn nearest the old one, the new amplitude |z'|, the new sigma
        sigma |z| / |z'|. Echoes with z = 0 stay as they are.
        """
        lit = self.returned & (before != 0)
        turned = np.angle(np.where(lit, after * before.conj(), 1.0))
        gain = np.abs(after) / np.abs(np.where(lit, before, 1.0))
        faintest = 1.0e-9  # |z'| / |z| below this counts as this: sigma stays finite where light cancels itself
        gain = np.where(lit, np.maximum(gain, faintest), 1.0)
        self.range_mm = self.range_mm + turned * (self.turn_mm / (2 * math.pi))
        self.amplitude = self.amplitude * gain
        self.sigma_mm = self.sigma_mm / gain


@dataclass(slots=True, kw_only=True, eq=False)
class FrameSamples(Echoes):
    """The samples of one frame, (pixel,) in row order.

    Parameters
    ----------
    noise : (pixel,) float64
        Standardised noise, of the camera's shape.
    outlier_mm : (pixel,) float64
        Value of each random sample, mm; NaN for other samples.
    lost : (pixel,) bool
        Invalid samples.
    stuck : (pixel,) bool
        Pixels that return one value; none of their samples is lost.
    measured_mm : (pixel,) float64
        Ranges with noise, from `measure` on.
    """

    noise: FloatArray
    outlier_mm: FloatArray
    lost: BoolArray
    stuck: BoolArray
    measured_mm: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def outlier(self) -> BoolArray:
        """Which samples are random values."""
        return ~np.isnan(self.outlier_mm)

    def lose(self, lost: BoolArray) -> None:
        """Mark samples as invalid; random values and stuck pixels are never lost."""
        self.lost = self.lost | lost

    def lose_any(self, lost: BoolArray) -> None:
        """Mark samples as invalid, random values among them."""
        self.outlier_mm = np.where(lost, np.nan, self.outlier_mm)
        self.lose(lost)

    def measure(self) -> None:
        """Add the noise, fold, and put random values in place."""
        measured = self.noise * self.sigma_mm
        measured += self.range_mm
        if self.period_mm is not None:
            measured = np.where(self.returned, np.mod(measured, self.period_mm), measured)
        self.measured_mm = np.where(self.outlier, self.outlier_mm, measured)

    def stored(self) -> NDArray[np.uint16]:
        """Stored ranges: the nearest whole mm, 1 to 65,534, and 0 if invalid."""
        lost = self.lost & ~self.outlier & ~self.stuck
        stored: NDArray[np.uint16] = np.where(lost, np.uint16(0), stored_range(self.measured_mm))
        return stored
