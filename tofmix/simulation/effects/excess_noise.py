"""More noise than the sensor's curve gives."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Basic, Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import about, number
from tofmix.simulation.effects.search import (
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    of_logarithm,
    spread_of_factor,
)

_WIDER = 0.05
"""Logarithm of a factor, for slopes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExcessNoise(Effect):
    """Sigma times `factor`.

    Phase noise is sqrt(B) / A: if the background dominates, more ambient light or a weaker emitter increases every
    sigma by the same factor. Four times the background electrons double sigma.

    References
    ----------
    Lange and Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448.
    """

    kind: ClassVar[str] = "excess_noise"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "spread, by the same factor everywhere"
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

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:  # noqa: ARG003
        """By the logarithm of the factor."""
        yield of_logarithm(cls, "factor", (0.9, 1.1, 1.5))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:  # noqa: ARG003
        """The logarithm of the factor."""
        wider = Coefficient(effect=cls(factor=math.exp(_WIDER)), size=_WIDER, spread=spread_of_factor(cls, "factor"))
        yield LinearForm(coefficients=(wider,), make=lambda c: cls(factor=math.exp(c[0])))

    def explain(self) -> str:
        """One sentence."""
        return f"the noise is {self.factor:g} times the sensor's"

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        """Scale sigma."""
        echoes.scale_sigma(self.factor)
