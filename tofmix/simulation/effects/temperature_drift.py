"""Warm-up: a bias that grows and settles after power-on."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import number
from tofmix.simulation.effects.prior import StudentPrior, about


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureDrift(Effect):
    """Bias ``amplitude_mm * (1 - exp(-t / time_constant_s))``, t the time since the first frame.

    The delay of the light source's driver and of the pixel changes with temperature, and both warm up after power-on.
    Some mm to some ten mm over 20 to 40 minutes are reported. The time constant is the housing's.

    References
    ----------
    Kahlmann, Remondino and Ingensand, ISPRS Archives XXXVI-5, 2006: warm-up of the SwissRanger.
    """

    kind: ClassVar[str] = "temperature_drift"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias of the whole image against time, settling"
    typical: ClassVar[str] = "some mm to some ten mm over 20 to 40 minutes"
    basis: ClassVar[str] = "reported"
    target: ClassVar[Target] = Target.TREND
    shows_in: ClassVar[tuple[str, ...]] = ("trend", "common_mode")
    changes_in_time: ClassVar[bool] = True
    static_partner: ClassVar[str] = "range_offset"

    amplitude_mm: float = number(
        "Final bias; negative if ranges become shorter.",
        unit="mm",
        low=-1000,
        high=1000,
        zero=0,
        typical=(2, 50),
        prior=StudentPrior(scale=25, dof=3),
    )
    time_constant_s: float = number(
        "Time until 63 % of the final bias.",
        unit="s",
        low=0,
        high=1e6,
        low_open=True,
        typical=(60, 1800),
        prior=about(120, 10),
    )

    def explain(self) -> str:
        """One sentence."""
        return f"ranges drift by {self.amplitude_mm:+g} mm in all, 63 % of it within {self.time_constant_s:g} s"

    def frame_bias(self, time_s: FloatArray) -> FloatArray:
        """Bias at some times, mm."""
        return np.asarray(self.amplitude_mm * -np.expm1(-time_s / self.time_constant_s))

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias of this time."""
        echoes.add_bias(self.frame_bias(np.array(context.time_s)))
