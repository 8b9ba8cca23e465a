"""A constant bias of one surface, by the material of which it is."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number, surface
from tofmix.simulation.effects.search import Coefficient, FormFacts, LinearForm, Problem, SearchFacts, spread_of

_ELSEWHERE = "the same surface at a second distance, its place measured again"


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceOffset(Effect):
    """Every range of one surface is longer by `offset_mm`; its amplitude and its noise stay as they are.

    Wax, skin, foam, marble and many plastics are translucent: a part of the light enters the material, is scattered and
    comes out later. The surface appears farther by the mean extra way, some mm to some cm, whatever its distance. The
    simulator takes any bias; `reconcile` looks for surfaces that appear farther, as light is never early.

    On one board before the camera, its pose and a second path say the same. A pose moves the board's edges too, and is
    another one whenever the board is put elsewhere, and a second path changes the amplitude. With one surface in the
    image it is `range_offset`.

    References
    ----------
    Su, Heide, Swanson, Klein, Callenberg, Hullin and Heidrich, Material classification using raw time-of-flight
    measurements, CVPR 2016: the response in time, and with it the range, depends on the material.
    """

    kind: ClassVar[str] = "surface_offset"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias on one surface, its edges where they were; no change of amplitude or noise"
    typical: ClassVar[str] = "some mm to some cm farther for translucent materials"
    basis: ClassVar[str] = "reported; the size assumed"
    remedy: ClassVar[str] = (
        "On one surface its material, its place in the model and a second path may give the same bias. Put opaque matt"
        " paper on it: the bias of the material goes. At a second distance, with its place measured again, an error of"
        " the place is another one; a second path changes the amplitude too."
    )
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "trend", "common_mode")
    separated_from: ClassVar[Mapping[str, str]] = {
        "surface_pose": _ELSEWHERE,
        "multipath": "the same surface alone, without others around it, with amplitudes",
        "range_offset": "a second surface of another material",
        "wiggling": _ELSEWHERE,
        "amplitude_walk": "an opaque surface of the same brightness beside it",
        "scattering": "the same scene without its brightest surface",
        "internal_reflection": _ELSEWHERE,
        "motion": "a longer recording",
    }

    surface: str = surface("The surface of this material.")
    offset_mm: float = number(
        "Added to its ranges.",
        unit="mm",
        low=-10_000,
        high=10_000,
        zero=0,
        typical=(2, 50),
        prior=StudentPrior(scale=25, dof=3, half=True),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """By the bias of each surface, if there are several, from its median and from a third of sigma."""

        def made(surface: str, sigma_mm: float, x: FloatArray) -> Effect:
            return cls(surface=surface, offset_mm=float(x[0]) * sigma_mm)

        for seen in facts.surfaces if len(facts.surfaces) > 1 else ():
            starts = ((0.3,), (max(seen.residual_mm / seen.sigma_mm, 0.0),))
            yield Problem(make=partial(made, seen.name, seen.sigma_mm), starts=starts, steps=(0.2,))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The ranges of a surface move by the coefficient."""

        def made(surface: str, c: FloatArray) -> Effect:
            return cls(surface=surface, offset_mm=float(c[0]))

        for seen in facts.surfaces if len(facts.surfaces) > 1 else ():
            make = partial(made, seen.name)
            one = Coefficient(
                effect=make(np.array([facts.sigma_mm])), size=facts.sigma_mm, spread=spread_of(cls, "offset_mm")
            )
            yield LinearForm(coefficients=(one,), make=make, surface=seen.name)

    def explain(self) -> str:
        """One sentence."""
        side = "farther" if self.offset_mm >= 0 else "nearer"
        return f'"{self.surface}" appears {abs(self.offset_mm):g} mm {side} than it is, by its material'

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias to the surface's echoes."""
        echoes.add_bias(np.where(echoes.surface == context.number_of(self.surface), self.offset_mm, 0.0))
