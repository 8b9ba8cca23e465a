"""A constant bias of every range."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Basic, Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number
from tofmix.simulation.effects.search import (
    OUT_OF_SIGHT,
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    of_sigma,
    spread_of,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeOffset(Effect):
    """Every range is longer by `offset_mm`.

    Signals have a delay in the driver of the light source, the cables and the pixel. A calibration removes most of it
    and leaves a constant. 10 mm correspond to a delay of 67 ps. So some mm to some cm remain if the camera was never
    calibrated at its own temperature and settings.

    References
    ----------
    Kahlmann, Remondino and Ingensand, ISPRS Archives XXXVI-5, 2006: offset of a fixed pattern and of the device.
    """

    kind: ClassVar[str] = "range_offset"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias, the same at every range, amplitude, place and time"
    typical: ClassVar[str] = (
        "some mm to some cm where the camera was never calibrated at its own temperature; 10 mm are 67 ps of delay"
    )
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.BIAS
    basic: ClassVar[Basic | None] = Basic.OFFSET
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "trend", "common_mode")

    offset_mm: float = number(
        "Added to every range.",
        unit="mm",
        low=-10_000,
        high=10_000,
        zero=0,
        typical=(2, 50),
        prior=StudentPrior(scale=25, dof=2),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """Below and above 0, and where most samples lie."""
        own = of_sigma(cls, "offset_mm", (-0.3, 0.3), facts.sigma_mm)
        away = facts.typical_residual_mm / facts.sigma_mm
        far = abs(away) > OUT_OF_SIGHT
        yield replace(own, starts=(*own.starts, (away,)), shown=True) if far else own

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """Every range moves by the coefficient."""
        size = facts.sigma_mm
        one = Coefficient(effect=cls(offset_mm=size), size=size, spread=spread_of(cls, "offset_mm"))
        yield LinearForm(coefficients=(one,), make=lambda c: cls(offset_mm=float(c[0])))

    def explain(self) -> str:
        """One sentence."""
        return f"every range is {abs(self.offset_mm):g} mm {'longer' if self.offset_mm >= 0 else 'shorter'}"

    def act(self, echoes: Echoes, context: Context) -> None:  # noqa: ARG002
        """Add the offset."""
        echoes.add_bias(self.offset_mm)
