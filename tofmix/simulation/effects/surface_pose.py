"""A surface with another pose than in the model."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from tofmix.arrays import FloatArray
from tofmix.simulation.effects.base import Basic, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number, surface
from tofmix.simulation.effects.search import Coefficient, FormFacts, LinearForm, Problem, SearchFacts, spread_of
from tofmix.simulation.surface import angle_changes

if TYPE_CHECKING:
    from tofmix.simulation.surface import Surface


_TURN_DEG = 0.1
"""Tilt for slopes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfacePose(Effect):
    """The surface, with its edges, is shifted along its normal in the model and turned about its centre.

    This is not an error of the camera: the scene was measured wrongly, or something moved later. The alternative
    explanation is `range_offset`; a second surface separates the two. On a surface at an angle, ranges change by shift
    / cos(incidence). Boards placed by hand are right to some mm or some cm, and to a degree or two. An error of metres
    means another scene.
    """

    kind: ClassVar[str] = "surface_pose"
    level: ClassVar[Level] = Level.GEOMETRY
    signature: ClassVar[str] = "bias on one surface, shares at its edges"
    typical: ClassVar[str] = "some mm to some cm for boards placed by hand"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.BIAS
    basic: ClassVar[Basic | None] = Basic.POSE
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "trend", "common_mode")
    magnitudes: ClassVar[tuple[str, ...]] = ("shift_mm", "yaw_deg", "pitch_deg")
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "a second surface",
        "multipath": "the same surface alone, without others around it",
        "motion": "a longer recording",
        "wiggling": "the same surface at a second distance",
        "amplitude_walk": "the same surface with another reflectivity",
        "scattering": "the same scene without its brightest surface",
    }

    surface: str = surface("The surface that is moved.")
    shift_mm: float = number(
        "Shift along the surface's normal R (0, 0, 1): away from the sensor for a board that faces it.",
        unit="mm",
        low=-100_000,
        high=100_000,
        zero=0,
        typical=(2, 100),
        prior=StudentPrior(scale=50, dof=2),
    )
    yaw_deg: float = number(
        "Added to the surface's `yaw_deg`.",
        unit="degree",
        low=-180,
        high=180,
        default=0,
        typical=(0.2, 4),
        prior=StudentPrior(scale=2, dof=2),
    )
    pitch_deg: float = number(
        "Added to the surface's `pitch_deg`.",
        unit="degree",
        low=-180,
        high=180,
        default=0,
        typical=(0.2, 4),
        prior=StudentPrior(scale=2, dof=2),
    )
    roll_deg: float = number(
        "Added to the surface's `roll_deg`; a side wall leans by it.",
        unit="degree",
        low=-180,
        high=180,
        default=0,
        typical=(0.2, 4),
        prior=StudentPrior(scale=2, dof=2),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """A shift; and a shift with tilts, if the plane of the surface is clearly tilted."""

        def shifted_by(surface: str, sigma_mm: float, x: FloatArray) -> Effect:
            return cls(surface=surface, shift_mm=float(x[0]) * sigma_mm)

        def made(surface: "Surface", scales: tuple[float, float, float], x: FloatArray) -> Effect:
            shift, about_u, about_v = (float(v) * scale for v, scale in zip(x, scales, strict=True))
            return cls.tilted(surface, shift, (about_u, about_v))

        for seen in facts.surfaces:
            there = ((seen.residual_mm / seen.sigma_mm,),) if seen.far else ()
            make = partial(shifted_by, seen.name, seen.sigma_mm)
            yield Problem(make=make, starts=((-1.0,), (1.0,), *there), steps=(0.3,))
        two_more = 6.0  # nats, least evidence for two more numbers
        for seen in facts.surfaces:
            if seen.turn_nats < two_more or min(seen.turned_deg) <= 0:
                continue
            scales = seen.sigma_mm, *seen.turned_deg
            measured = (seen.shift_mm, *seen.tilts_deg)
            start = tuple(value / scale for value, scale in zip(measured, scales, strict=True))
            yield Problem(make=partial(made, seen.surface, scales), starts=(start,), steps=(0.3, 0.3, 0.3))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """A shift alone, or a shift with both tilts."""
        size, shift, turn = facts.sigma_mm, spread_of(cls, "shift_mm"), spread_of(cls, "yaw_deg")

        def made(surface: "Surface", c: FloatArray) -> Effect:
            shift_mm, about_u, about_v = (*(float(v) for v in c), 0.0, 0.0)[:3]
            return cls.tilted(surface, shift_mm, (about_u, about_v))

        for seen in facts.surfaces:
            away = Coefficient(effect=cls.tilted(seen, size), size=size, spread=shift)
            tilts = tuple(
                Coefficient(effect=cls.tilted(seen, 0.0, about), size=_TURN_DEG, spread=turn)
                for about in ((_TURN_DEG, 0.0), (0.0, _TURN_DEG))
            )
            for coefficients in ((away,), (away, *tilts)):
                yield LinearForm(coefficients=coefficients, make=partial(made, seen), surface=seen.name, choices=2)

    @classmethod
    def tilted(cls, surface: "Surface", shift_mm: float, tilts_deg: tuple[float, float] = (0.0, 0.0)) -> "SurfacePose":
        """The pose of a surface that is shifted, and tilted about its own u and v axes.

        Raises
        ------
        ValueError
            If the surface cannot be tilted so, or a number is out of bounds.
        """
        yaw, pitch, roll = angle_changes(surface, tilts_deg)
        return cls(surface=surface.name, shift_mm=shift_mm, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)

    def explain(self) -> str:
        """One sentence."""
        turns = (("yaw", self.yaw_deg), ("pitch", self.pitch_deg), ("roll", self.roll_deg))
        said = " and ".join(f"{angle:+.4g} degrees in {name}" for name, angle in turns if angle)
        turn = f", turned by {said}" if said else ""
        return f'"{self.surface}" lies {self.shift_mm:+.4g} mm along its normal from its position in the model{turn}'

    def place(self, surface: "Surface", time_s: float) -> "Surface":  # noqa: ARG002
        """Move the surface."""
        if surface.name != self.surface:
            return surface
        moved = surface.shifted(self.shift_mm)
        if not (self.yaw_deg or self.pitch_deg or self.roll_deg):
            return moved
        return replace(
            moved,
            yaw_deg=surface.yaw_deg + self.yaw_deg,
            pitch_deg=surface.pitch_deg + self.pitch_deg,
            roll_deg=surface.roll_deg + self.roll_deg,
        )
