"""More noise than the sensor's curve gives: everywhere, or on one surface."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Basic, Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import PixelMap, Prior, StudentPrior, about, number, pixel_map, surface
from tofmix.simulation.effects.search import (
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    spread_of_factor,
)

_WIDER = 0.05
"""Logarithm of a factor, for slopes."""

_STARTS = (0.9, 1.1, 1.5)  # factors

_ADDED = StudentPrior(scale=math.log(2), log=True, half=True)
"""Of one surface: light that falls on it adds noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExcessNoise(Effect):
    """Sigma times `factor`: of every sample with a return, or of those of one surface.

    Phase noise is sqrt(B) / A: if the background dominates, more ambient light or a weaker emitter increases every
    sigma by the same factor. Four times the background electrons double sigma. Light that falls on one surface, such as
    the sun through a window, does so for this surface alone: its ranges and its amplitudes remain as they are. A map
    gives each pixel a further factor; `reconcile` looks for none.

    References
    ----------
    Lange and Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448.
    """

    kind: ClassVar[str] = "excess_noise"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "spread, by the same factor everywhere or on one surface; no bias"
    typical: ClassVar[str] = "2 for four times the background electrons"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.SPREAD
    basic: ClassVar[Basic | None] = Basic.NOISE
    shows_in: ClassVar[tuple[str, ...]] = ("spread", "tails", "skew", "spread_pattern", "memory")
    separated_from: ClassVar[Mapping[str, str]] = {
        "vignetting": "a flat wall that fills the image",
    }

    factor: float = number(
        "Factor on sigma.", unit="1", low=0.01, high=100, zero=1, typical=(1.05, 3), prior=about(1, 2)
    )
    surface: str = surface("The only surface with more noise; all surfaces if it is left out.", required=False)
    map: PixelMap | None = pixel_map(  # noqa: RUF009
        "Further factor of each pixel, such as of a part of the image in the sun.", unit="1"
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """By the logarithm of the factor: of all surfaces, and of each if there are several."""

        def made(surface: str, x: FloatArray) -> Effect:
            low, high = (
                math.log(1.0 if surface else cls.parameters()["factor"].low),
                math.log(cls.parameters()["factor"].high),
            )
            return cls(surface=surface, factor=math.exp(bounded(x[0], low, high)))

        for name in _alone(s.name for s in facts.surfaces):
            starts = tuple((math.log(f),) for f in _STARTS if f > 1 or not name)
            yield Problem(make=partial(made, name), starts=starts, steps=(0.2,))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The logarithm of the factor: of all surfaces, and of each if there are several."""

        def made(surface: str, c: FloatArray) -> Effect:
            return cls(surface=surface, factor=math.exp(max(c[0], 0.0) if surface else c[0]))

        spread = spread_of_factor(cls, "factor")
        for name in _alone(s.name for s in facts.surfaces):
            make = partial(made, name)
            wider = Coefficient(effect=make(np.array([_WIDER])), size=_WIDER, spread=spread)
            yield LinearForm(coefficients=(wider,), make=make, surface=name)

    def is_basic(self, error: Basic) -> bool:
        """The noise of all surfaces is what every model may have wrong; that of one surface is not."""
        return Effect.is_basic(self, error) and not self.surface

    def priors(self) -> dict[str, Prior]:
        """That of all surfaces is larger or smaller; that of one surface is larger."""
        return Effect.priors(self) | ({"factor": _ADDED} if self.surface else {})

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:
        """Refuse a map with values that are no factors."""
        Effect.check(self, sensor, surfaces)
        if self.map is not None and not (np.isfinite(self.map.values) & (self.map.values > 0)).all():
            raise ValueError("map: every pixel needs a finite factor above 0")

    def explain(self) -> str:
        """One sentence."""
        of = f' of "{self.surface}"' if self.surface else ""
        mapped = "" if self.map is None else f", and a factor of each pixel from {self.map.path or 'a map'}"
        return f"the noise{of} is {self.factor:g} times the sensor's{mapped}"

    def act(self, echoes: Echoes, context: Context) -> None:
        """Scale sigma."""
        factor = self.factor if self.map is None else self.factor * self.map.values.ravel().astype(np.float64)
        if self.surface:
            factor = np.where(echoes.surface == context.number_of(self.surface), factor, 1.0)
        echoes.scale_sigma(factor)


def _alone(names: Iterable[str]) -> list[str]:
    """The surfaces that may have noise of their own, after all together (empty): none where there is one."""
    each = list(names)
    return ["", *each] if len(each) > 1 else [""]
