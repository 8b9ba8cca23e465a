"""A bias that goes by the square of the range."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeSquare(Effect):
    """Ranges are longer by ``bias_mm`` times the square of the range in metres."""

    kind: ClassVar[str] = "range_square"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias against the square of range"
    typical: ClassVar[str] = "some mm at 1 m"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")
    separated_from: ClassVar[Mapping[str, str]] = {"range_offset": "a second surface at twice the distance"}
    remedy: ClassVar[str] = "A bias by the square of range is taken off with a table of the ranges of one board."

    bias_mm: float = number(
        "At 1 m.", unit="mm", low=-1000, high=1000, zero=0, typical=(1, 20), prior=StudentPrior(scale=10, dof=3)
    )

    def explain(self) -> str:
        """One sentence."""
        return f"ranges are off by {self.bias_mm:+g} mm at 1 m, and by the square of the range"

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        """Add the bias."""
        echoes.add_bias(self.bias_mm * (echoes.range_mm / 1000.0) ** 2)
