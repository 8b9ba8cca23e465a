"""A surface that moves during the recording."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from tofmix.arrays import FloatArray
from tofmix.simulation.effects.base import Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number, surface
from tofmix.simulation.effects.search import (
    OUT_OF_SIGHT,
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    spread_of,
)
from tofmix.simulation.effects.surface_pose import SurfacePose

if TYPE_CHECKING:
    from tofmix.simulation.surface import Surface


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion(Effect):
    """The surface moves along its normal, from its position in the model at time 0.

    Each frame is cast again: ranges, shares and edges follow. Within a frame the surface stands still, and the four
    correlation samples see one scene. A camera that takes them one after the other has errors at moving edges; these
    are not simulated. A person walks at about 1400 mm/s; a settling tripod moves by micrometres a second.
    """

    kind: ClassVar[str] = "motion"
    level: ClassVar[Level] = Level.GEOMETRY
    signature: ClassVar[str] = "bias on one surface in proportion to time, shares at its edges"
    typical: ClassVar[str] = "a walking person 1400 mm/s; a settling tripod some micrometres a second"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.TREND
    shows_in: ClassVar[tuple[str, ...]] = ("trend", "common_mode")
    changes_in_time: ClassVar[bool] = True

    surface: str = surface("The surface that moves.")
    velocity_mm_s: float = number(
        "Velocity along the surface's normal R (0, 0, 1): away from the sensor for a board that faces it.",
        unit="mm/s",
        low=-100_000,
        high=100_000,
        zero=0,
        typical=(0.1, 1000),
        prior=StudentPrior(scale=2, dof=0.5),  # speeds of all magnitudes, from a tripod's to a car's
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """The way of each surface within the recordings, in sigma."""

        def moving(surface: str, scale: float, x: FloatArray) -> Effect:
            return cls(surface=surface, velocity_mm_s=float(x[0]) * scale)

        for seen in facts.surfaces:
            way = seen.speed_mm_s * facts.duration_s / seen.sigma_mm
            far = abs(way) > OUT_OF_SIGHT
            there = ((way,),) if far else ()
            make = partial(moving, seen.name, seen.sigma_mm / facts.duration_s)
            yield Problem(make=make, starts=((-1.5,), (1.5,), *there), steps=(0.3,), shown=far)

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The way within the recordings. It has the prior of a pose."""
        size, duration_s = facts.sigma_mm, facts.duration_s

        def moving(surface: str, c: FloatArray) -> Effect:
            return cls(surface=surface, velocity_mm_s=float(c[0]) / duration_s)

        for seen in facts.surfaces:
            at_once = SurfacePose.tilted(seen, size)
            way = Coefficient(
                effect=at_once, size=size, spread=spread_of(SurfacePose, "shift_mm"), course=lambda t: t / duration_s
            )
            yield LinearForm(coefficients=(way,), make=partial(moving, seen.name), surface=seen.name)

    def explain(self) -> str:
        """One sentence."""
        return f'"{self.surface}" moves along its normal at {self.velocity_mm_s:+.4g} mm/s'

    @property
    def moves(self) -> bool:
        """Unless it stands still."""
        return self.velocity_mm_s != 0

    def place(self, surface: "Surface", time_s: float) -> "Surface":
        """The surface at that time."""
        return surface.shifted(self.velocity_mm_s * time_s) if surface.name == self.surface else surface
