"""Light that reaches a surface twice: directly, and through another surface."""

import cmath
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import number, surface
from tofmix.simulation.effects.prior import Prior, StudentPrior, about

_SHARE = 0.25
"""Scale of the share of a short second path: half of the light of a bright wall beside the surface."""

_NEAR_MM = 2000.0
"""Distance of a surface in a room, from which the light of a second path spreads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipath(Effect):
    """z of one surface becomes z (1 + share exp(i pi extra_path / d_u)).

    Light that is reflected by a wall, a floor or another board on its way arrives later. The surface appears farther:
    by 44 mm at 20 MHz for 10 % of light on a path 1 m longer. In corners, some cm to some ten cm are reported. Share
    and path are constant over the surface; near a real corner both vary from pixel to pixel. A path that is longer by a
    whole turn of the modulation, 15 m at 20 MHz, changes no range, only the noise.

    A priori, the light of a longer second path is weaker, as it spreads over more area: the scale of the share falls
    with the square of 1 + half the extra path over 2 m.

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
        "Amplitude of the second path over that of the first.",
        unit="1",
        low=0,
        high=1,
        zero=0,
        typical=(0.02, 0.5),
        prior=StudentPrior(scale=_SHARE, half=True),
    )
    extra_path_mm: float = number(
        "Extra length of the second path, there and back.",
        unit="mm",
        low=0,
        high=200_000,
        typical=(200, 4000),
        prior=about(1000, 1.9),
    )

    def priors(self) -> dict[str, Prior]:
        """A longer path has less light: it spreads over a square of the whole way, as from a surface at `_NEAR_MM`."""
        spread_out = (1 + 0.5 * self.extra_path_mm / _NEAR_MM) ** 2
        return Effect.priors(self) | {"share": StudentPrior(scale=_SHARE / spread_out, half=True)}

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
