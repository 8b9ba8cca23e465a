"""Light or charge that leaks into the neighbouring pixels."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tofmix.simulation.echoes import ComplexArray, Echoes, FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level
from tofmix.simulation.effects.parameter import number

if TYPE_CHECKING:
    from tofmix.simulation.prediction import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelCrosstalk(Effect):
    """z becomes (1 - 4 share) z + share (sum of the four neighbours' z in that frame), the image's edge repeated.

    Charge diffuses between pixels, and a lens out of focus spreads a point over several. A share of some per cent is
    usual for either (experience, no source). Ranges are pulled across edges, and neighbours' events show in a pixel's
    spread. Samples without a return have z = 0 and stay as they are.
    """

    kind: ClassVar[str] = "pixel_crosstalk"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "bias and spread where neighbours differ; correlation between neighbours"
    predicts: ClassVar[str] = (
        "mean and variance of each component, from the mean and variance of the neighbours' phasors (to first order "
        "in the share); exact where the neighbours see one surface each"
    )

    share: float = number(
        "Share that each neighbour gets.", unit="1", low=0, high=0.25, high_open=True, zero=0, typical=(0.002, 0.05)
    )

    def explain(self) -> str:
        """One sentence."""
        return f"each pixel leaks {100 * self.share:g} % of its light into each of its four neighbours"

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Mix with the neighbours' samples of this frame."""
        z = samples.phasor()
        shape = (context.sensor.rows, context.sensor.cols)
        leaked = _neighbours(z.reshape(shape)).ravel()
        samples.replace_phasor(z, (1 - 4 * self.share) * z + self.share * leaked)

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """First two moments: the neighbours' mean phasor moves a component, their variance widens it."""
        shape = (context.sensor.rows, context.sensor.cols)
        z, area = prediction.phasor(), prediction.area()
        mean = (area * z).sum(axis=0)
        power = (area * np.abs(z) ** 2).sum(axis=0) - np.abs(mean) ** 2
        square = (area * z**2).sum(axis=0) - mean**2
        own = _own(shape).ravel()
        from_others = _neighbours(mean.reshape(shape)).ravel() - own * mean
        power = _neighbours(power.reshape(shape)).ravel() - own * power
        square = _neighbours(square.reshape(shape)).ravel() - own * square
        mixed = (1 - (4 - own) * self.share) * z + self.share * from_others
        prediction.replace_phasor(z, mixed)
        self._widen(prediction, power, square, z, mixed)

    def _widen(
        self, echoes: Echoes, power: ComplexArray, square: ComplexArray, z: ComplexArray, mixed: ComplexArray
    ) -> None:
        """Add the variance across the phasor, which turns it."""
        lit = echoes.returned & (z != 0) & (mixed != 0)
        length = np.abs(np.where(lit, mixed, 1.0))
        across = np.where(lit, mixed / length, 1.0) * 1j
        variance = 0.5 * (power.real + (across.conj() ** 2 * square).real)
        turned = np.maximum(variance, 0.0) * (self.share * echoes.turn_mm / (2 * math.pi) / length) ** 2
        echoes.sigma_mm = np.where(lit, np.sqrt(echoes.sigma_mm**2 + turned), echoes.sigma_mm)


def _neighbours(image: ComplexArray) -> ComplexArray:
    """Sum of the four neighbours (row, col), the edge repeated."""
    framed = np.pad(image, 1, mode="edge")
    return framed[:-2, 1:-1] + framed[2:, 1:-1] + framed[1:-1, :-2] + framed[1:-1, 2:]


def _own(shape: tuple[int, int]) -> ComplexArray:
    """How many of a pixel's four neighbours are the pixel itself, by the repeated edge."""
    own = np.zeros(shape, dtype=np.complex128)
    own[0] += 1
    own[-1] += 1
    own[:, 0] += 1
    own[:, -1] += 1
    return own
