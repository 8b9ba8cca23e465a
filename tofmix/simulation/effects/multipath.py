"""Light that reaches a surface twice: directly, and through another surface."""

import cmath
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.sensors.profile import SensorProfile
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import number, surface

_LONGEST = 0.95
"""Of a whole turn: a longer path moves ranges by less than a third of its share, and mostly changes the noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipath(Effect):
    """z of one surface becomes z (1 + share exp(i pi extra_path / d_u)).

    Light that is reflected by a wall, a floor or another board on its way arrives later. The surface appears farther:
    by 44 mm at 20 MHz for 10 % of light on a path 1 m longer. In corners, some cm to some ten cm are reported. Share
    and path are constant over the surface; near a real corner both vary from pixel to pixel. A path that is longer by a
    whole turn of the modulation, 15 m at 20 MHz, changes no range, only the noise.

    References
    ----------
    Fuchs, Multipath interference compensation in time-of-flight camera images, ICPR 2010.
    """

    kind: ClassVar[str] = "multipath"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "bias and amplitude of one surface; its noise with its amplitude"
    typical: ClassVar[str] = "10 % on a path 1 m longer: +44 mm at 20 MHz; some cm to some ten cm in corners"
    basis: ClassVar[str] = "physics; the corners reported"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern", "spread")
    acts_on_phase: ClassVar[bool] = True

    surface: str = surface("The surface that the second path leads to.")
    share: float = number(
        "Amplitude of the second path over that of the first.", unit="1", low=0, high=1, zero=0, typical=(0.02, 0.5)
    )
    extra_path_mm: float = number(
        "Extra length of the second path, there and back.",
        unit="mm",
        low=0,
        high=200_000,
        typical=(100, 4000),
    )

    def plausible(self, sensor: SensorProfile) -> bool:
        """Not nearly a whole turn."""
        return Effect.plausible(self, sensor) and self.extra_path_mm < _LONGEST * 2 * sensor.turn_mm("multipath")

    def explain(self) -> str:
        """One sentence."""
        return (
            f'"{self.surface}" is also lit through another surface: {100 * self.share:g} % more light on a path '
            f"that is {self.extra_path_mm:g} mm longer"
        )

    def act(self, echoes: Echoes, context: Context) -> None:
        """Multiply the surface's phasors."""
        factor = 1 + self.share * cmath.exp(1j * math.pi * self.extra_path_mm / context.turn_mm)
        z = echoes.phasor()
        echoes.replace_phasor(z, z * np.where(echoes.surface == context.number_of(self.surface), factor, 1.0))
