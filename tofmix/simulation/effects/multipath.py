"""Light that reaches a surface twice: directly, and through another surface."""

import cmath
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import Prior, StudentPrior, about, number, surface
from tofmix.simulation.effects.search import (
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    spread_of,
)

_SHARE = 0.25
"""Scale of the share of a short second path: half of the light of a bright wall beside the surface."""

_NEAR_MM = 2000.0
"""Distance of a surface in a room, from which the light of a second path spreads."""


_SMALL = 0.01
"""Share for slopes."""


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
    yields_to: ClassVar[str] = "surface_pose"
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "a scene without a surface beside the one that is too far",
        "wiggling": "the same surface at a second distance, without others around it",
        "excess_noise": "the same surface alone, without others around it",
    }

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

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """Two components: in phase, which changes the amplitude, and a quarter turn off, which changes the range."""

        def made(surface: str, unit: float, x: FloatArray) -> Effect:
            path = bounded(math.atan2(x[1], x[0]) % (2 * math.pi) / math.pi, 0.02, 1.98) * facts.turn_mm
            share = bounded(math.hypot(x[0], x[1]) * unit, 1e-4, 0.99)
            return cls(surface=surface, share=share, extra_path_mm=path)

        turns = [math.pi * path for path in (0.15, 0.35, 0.6, 0.85, 1.15, 1.5, 1.85)]
        for seen in facts.surfaces:
            unit = min(0.2, max(0.006, 2 * math.pi * seen.sigma_mm / facts.turn_mm))  # moves the range by about sigma
            starts = [(size * math.cos(t), size * math.sin(t)) for size in (1.5, 4.5) for t in turns]
            if seen.far:
                slope = math.tan(2 * math.pi * min(max(seen.residual_mm / facts.turn_mm, -0.2), 0.2))
                starts += [(along / unit, (1 + along) * slope / unit) for along in (-0.3, 0.0, 0.3)]
            yield Problem(make=partial(made, seen.name, unit), starts=tuple(starts), steps=(0.3, 0.3))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """Components of the second path's phasor: in phase, which changes the noise, and a quarter turn off."""

        def made(surface: str, c: FloatArray) -> Effect:
            path_mm = math.atan2(c[1], c[0]) % (2 * math.pi) / math.pi * facts.turn_mm
            return cls(surface=surface, share=math.hypot(c[0], c[1]), extra_path_mm=path_mm)

        spread = spread_of(cls, "share")
        for seen in facts.surfaces:
            make = partial(made, seen.name)
            both = tuple(
                Coefficient(effect=make(np.array(c)), size=_SMALL, spread=spread)
                for c in ((_SMALL, 0.0), (0.0, _SMALL))
            )
            yield LinearForm(coefficients=both, make=make, surface=seen.name)

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

    def amplitude_factor(self, turn_mm: float) -> float:
        """The length of the sum of both phasors."""
        return abs(1 + self.share * cmath.exp(1j * math.pi * self.extra_path_mm / turn_mm))

    def act(self, echoes: Echoes, context: Context) -> None:
        """Multiply the surface's phasors."""
        factor = 1 + self.share * cmath.exp(1j * math.pi * self.extra_path_mm / context.turn_mm)
        z = echoes.phasor()
        echoes.replace_phasor(z, z * np.where(echoes.surface == context.number_of(self.surface), factor, 1.0))
