"""A bias that depends on the amplitude of a sample."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import number
from tofmix.simulation.effects.prior import StudentPrior

_LARGEST_MM = 1.0e5  # beyond any range: amplitude 0 must not give infinity


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeWalk(Effect):
    """Bias ``scale_mm * (reference_amplitude / amplitude) ** exponent``.

    At low signal, charge lags behind in the pixel, and its non-linearity turns the phase: dark targets appear nearer or
    farther than bright ones at the same range. Some mm to a few cm between black and white targets are reported. The
    amplitude is the light's, after all light effects. The bias is limited to 100 m.

    References
    ----------
    Lindner and Kolb, Calibration of the intensity-related distance error of the PMD ToF-camera, SPIE 6764, 2007.
    """

    kind: ClassVar[str] = "amplitude_walk"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias against amplitude, at one range too"
    typical: ClassVar[str] = "some mm to a few cm between black and white targets"
    basis: ClassVar[str] = "reported"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")

    scale_mm: float = number(
        "Bias at the reference amplitude.",
        unit="mm",
        low=-1000,
        high=1000,
        zero=0,
        typical=(1, 50),
        prior=StudentPrior(scale=25, dof=3),
    )
    reference_amplitude: float = number(
        "Amplitude at which the bias is `scale_mm`.", unit="1", low=0, high=1e6, low_open=True
    )
    exponent: float = number(
        "Exponent of its decrease with amplitude.",
        unit="1",
        low=0,
        high=4,
        default=1,
        typical=(0.5, 2),
        prior=StudentPrior(center=1, scale=0.6),
    )

    def explain(self) -> str:
        """One sentence."""
        return (
            f"ranges change by {self.scale_mm:+g} mm at amplitude {self.reference_amplitude:g}, "
            f"and with amplitude to the power of {-self.exponent:g}"
        )

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        """Add the bias of each amplitude."""
        faintest = self.reference_amplitude * 1.0e-30
        ratio = self.reference_amplitude / np.maximum(echoes.amplitude, faintest)
        with np.errstate(over="ignore"):
            bias = self.scale_mm * np.minimum(ratio**self.exponent, _LARGEST_MM / max(abs(self.scale_mm), 1.0e-9))
        echoes.add_bias(bias)
