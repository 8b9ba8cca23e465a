"""Light that reaches a surface twice: directly, and through another surface, of the model or not."""

import cmath
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.bounce import one_bounce, sees
from tofmix.simulation.effects.parameter import Prior, StudentPrior, UniformPrior, about, number, surface
from tofmix.simulation.effects.parameter import surface as another
from tofmix.simulation.effects.search import (
    EFFECT_NATS,
    SMALL_SHARE,
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    spread_of,
)

if TYPE_CHECKING:
    from tofmix.simulation.surface import Surface

_SHARE = 0.25
"""Scale of the share of a short second path: half of the light of a bright wall beside the surface."""


_FULL_SHARE = 0.5
"""Scale of the share of one bounce at full form factor: half of the light that a bright surface gets, it returns."""

_SHARES = (0.1, 0.5)
"""Where searches for it begin."""

_FALLOFFS = (1.0, 0.0)
"""Of the lamp, that are tried."""

_BOUNCE = "one bounce"
"""Name of the forms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipath(Effect):
    """z of one surface becomes z (1 + share exp(i pi extra_path / d_u)), the same in all its pixels or of one bounce.

    Light that is reflected by a wall, a floor or another board on its way arrives later. The surface appears farther:
    by 44 mm at 20 MHz for 10 % of light on a path 1 m longer. In corners, some cm to some ten cm are reported. With
    `extra_path_mm`, share and path are constant over the surface, as if the light came from something far that the
    model does not have. A path that is longer by a whole turn of the modulation, 15 m at 20 MHz, changes no range, only
    the noise.

    With `from`, the light comes by one bounce from another surface of the model, which returns light in all directions
    by the cosine law: share exp(i pi extra_path / d_u) becomes the integral over that rectangle of `share` times its
    form factor at the point that the pixel sees, with the path of each of its parts. It is most at the seam of both
    (half of `share` where two long walls meet at a right angle), and the extra path is 0 there. `share` is what a point
    would get if the other surface were all that it faces: the reflectivity of this surface, times its light over the
    point's own. A source that the camera's own lamp lights is not lit evenly: with a `lamp_falloff` of 1, each of its
    parts is weighted by the lamp's light there over that at the point, by the square of the distance and the cosine of
    incidence, and `share` is the reflectivity of the source. `reconcile` tries 0 and 1. All of the rectangle that faces
    the point counts as lit, whatever stands before it. One surface can get light from one other; two walls of a corner
    light each other by two effects.

    A priori, the light of a longer second path is weaker, as it spreads over more area: the scale of the share falls
    with the square of 1 + half the extra path over 2 m. `reconcile` looks for one bounce from the other surface that
    explains a surface best, at the price of one more effect.

    References
    ----------
    Fuchs, Multipath interference compensation in time-of-flight camera images, ICPR 2010: light between the surfaces of
    a scene, by patches and the cosine law.
    """

    kind: ClassVar[str] = "multipath"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "bias and amplitude of one surface; its noise with its amplitude"
    typical: ClassVar[str] = "10 % on a path 1 m longer: +44 mm at 20 MHz; some cm to some ten cm in corners"
    basis: ClassVar[str] = "physics; the corners reported"
    target: ClassVar[Target] = Target.BIAS
    remedy: ClassVar[str] = (
        "Cover the other surface with something dark: the light that comes by way of it goes. A pose stays."
    )
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern", "spread")
    acts_on_phase: ClassVar[bool] = True
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
    extra_path_mm: float | None = number(
        "Extra length of the second path, there and back; without `from` only.",
        unit="mm",
        low=0,
        high=200_000,
        required=False,
        typical=(200, 4000),
        prior=about(1000, 1.9),
    )
    from_: str = another(
        "The surface from which the light comes by one bounce; needed without `extra_path_mm`.", required=False
    )

    lamp_falloff: float = number(
        "With `from`: power of the lamp's light on that surface, part by part, over the light at the point.",
        unit="1",
        low=0,
        high=1,
        default=0,
        prior=UniformPrior(low=0, high=1),
    )

    def __post_init__(self) -> None:
        Effect.__post_init__(self)
        if self.lamp_falloff and not self.from_:
            raise ValueError("lamp_falloff: it needs from, the surface that the lamp lights")
        if (self.extra_path_mm is None) == (not self.from_):
            known = "there beside from" if self.from_ else "missing"
            raise ValueError(f"extra_path_mm: it is {known}; give it, or the surface from which the light comes")
        if self.from_ == self.surface:
            raise ValueError(f'from: "{self.from_}" is the surface itself, and a flat surface does not light itself')

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """Two components: in phase, which changes the amplitude, and a quarter turn off, which changes the range.

        Then the share of one bounce from the other surface that explains the ranges best.
        """

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

        def bounced(small: "Multipath", x: FloatArray) -> Effect:
            return replace(small, share=bounded(x[0], 0.0, 1.0))

        for small, _ in _bounces(cls, [seen.surface for seen in facts.surfaces], facts.gain):
            yield Problem(
                make=partial(bounced, small),
                starts=tuple((share,) for share in _SHARES),
                steps=(0.1,),
                form=_form(small),
                price_nats=EFFECT_NATS,
            )

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """Components of the second path's phasor: in phase, which changes the noise, and a quarter turn off.

        Then the share of one bounce from the other surface that explains the ranges best.
        """

        def made(surface: str, c: FloatArray) -> Effect:
            path_mm = math.atan2(c[1], c[0]) % (2 * math.pi) / math.pi * facts.turn_mm
            return cls(surface=surface, share=math.hypot(c[0], c[1]), extra_path_mm=path_mm)

        spread = spread_of(cls, "share")
        for seen in facts.surfaces:
            make = partial(made, seen.name)
            both = tuple(
                Coefficient(effect=make(np.array(c)), size=SMALL_SHARE, spread=spread)
                for c in ((SMALL_SHARE, 0.0), (0.0, SMALL_SHARE))
            )
            yield LinearForm(coefficients=both, make=make, surface=seen.name)

        def bounced(unit: "Multipath", c: FloatArray) -> Effect:
            return replace(unit, share=max(float(c[0]), 0.0))

        for unit, sources in _bounces(cls, facts.surfaces, facts.gain):
            one = Coefficient(effect=unit, size=SMALL_SHARE, spread=_FULL_SHARE)
            yield LinearForm(
                coefficients=(one,),
                make=partial(bounced, unit),
                surface=unit.surface,
                choices=sources,
                form=_form(unit),
            )

    def priors(self) -> dict[str, Prior]:
        """A longer path has less light: it spreads over a square of the whole way, as from a surface at 2 m.

        Light of one bounce has its form factor.
        """
        if self.extra_path_mm is None:
            return Effect.priors(self) | {"share": StudentPrior(scale=_FULL_SHARE, half=True)}
        # mm, distance of a surface in a room, from which the light of a second path spreads
        spread_out = (1 + 0.5 * self.extra_path_mm / 2000.0) ** 2
        return Effect.priors(self) | {"share": StudentPrior(scale=_SHARE / spread_out, half=True)}

    def explain(self) -> str:
        """One sentence."""
        if self.extra_path_mm is None:
            light = f"{100 * self.share:g} % more light times the form factor of each point, most at their seam"
            light += f", by the lamp's light there to the power of {self.lamp_falloff:g}" if self.lamp_falloff else ""
            return f'"{self.surface}" is also lit by one bounce from "{self.from_}": {light}'
        return (
            f'"{self.surface}" is also lit through another surface: {100 * self.share:g} % more light on a path '
            f"that is {self.extra_path_mm:g} mm longer"
        )

    def amplitude_factor(self, turn_mm: float) -> float | None:
        """The length of the sum of both phasors; None for one bounce, which changes each pixel by another factor."""
        if self.extra_path_mm is None:
            return None
        return abs(1 + self.share * cmath.exp(1j * math.pi * self.extra_path_mm / turn_mm))

    def act(self, echoes: Echoes, context: Context) -> None:
        """Multiply the surface's phasors."""
        if self.extra_path_mm is None:
            here, there = (context.placed[context.number_of(name)] for name in (self.surface, self.from_))
            optics: Any = context.sensor.optics  # a frozen dataclass, by which results are kept
            light = self.share * one_bounce(
                here, there, optics, context.sensor.shape, context.turn_mm, self.lamp_falloff
            )
        else:
            light = np.asarray(self.share * cmath.exp(1j * math.pi * self.extra_path_mm / context.turn_mm))
        z = echoes.phasor()
        echoes.replace_phasor(z, z * np.where(echoes.surface == context.number_of(self.surface), 1 + light, 1.0))


def _form(bounce: Multipath) -> str:
    """Name of the form of a bounce."""
    return f"{_BOUNCE}, light to the power of {bounce.lamp_falloff:g}"


def _bounces(
    kind: type[Multipath], surfaces: "Sequence[Surface]", gain: Callable[[Effect], float]
) -> Iterator[tuple[Multipath, int]]:
    """A small bounce to each surface, in the lamp's and in even light, from the other one that explains most.

    And how many there are, of either light.
    """
    for here in surfaces:
        others = [other for other in surfaces if other is not here and sees(here, other)]
        for falloff in _FALLOFFS if others else ():
            small = (kind(surface=here.name, share=SMALL_SHARE, from_=o.name, lamp_falloff=falloff) for o in others)
            units = list(small)
            yield (units[0] if len(units) == 1 else max(units, key=gain)), len(_FALLOFFS) * len(units)
