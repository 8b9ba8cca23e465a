"""Ranges beyond the unambiguous one, folded back."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Basic, Context, Effect, Level, Target, refuse_without_phase
from tofmix.simulation.effects.parameter import number
from tofmix.simulation.effects.search import Problem, SearchFacts


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseWrapping(Effect):
    """Ranges, noise and bias included, modulo `unambiguous_range_mm`.

    A phase is known up to whole turns. Surfaces beyond d_u = c / (2 f) appear near, and noise moves samples across the
    fold in both directions. This is a property of the measurement, not an error. Samples without a return are not
    measured phases and stay at `range_max_mm`. Random values stay too. A range that folds to 0 is stored as 1 mm.
    """

    kind: ClassVar[str] = "phase_wrapping"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "far samples appear near"
    typical: ClassVar[str] = "surfaces beyond c / (2 f), 7.495 m at 20 MHz, appear nearer by this length"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.VALUES
    basic: ClassVar[Basic | None] = Basic.FOLD
    exact_law: ClassVar[bool] = True
    averages: ClassVar[bool] = False

    unambiguous_range_mm: float = number(
        "Range of one turn of the phase. Default: c / (2 f) of the sensor.",
        unit="mm",
        low=0,
        high=1e6,
        low_open=True,
        required=False,
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """At the camera's own turn, because a free one absorbs an offset; only if samples can fold.

        They can if a surface is near enough to the turn, or if pixels are off by a whole turn, so closely that chance
        gives this in 1 of 20.
        """
        if math.isnan(facts.turn_mm):
            return
        turns = facts.residual_mm / facts.turn_mm
        # so near a whole number in 5 % by chance
        whole = (np.rint(turns) != 0) & (np.abs(turns - np.rint(turns)) < 0.5 * 0.05)
        # sigma below the turn, from which noise folds
        if facts.farthest_mm + 4.0 * facts.sigma_mm > facts.turn_mm or whole.any():
            yield Problem(make=lambda _: cls(unambiguous_range_mm=facts.turn_mm), starts=((),), steps=())

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:
        """A camera without phase folds only at a given range."""
        Effect.check(self, sensor, surfaces)
        if self.unambiguous_range_mm is None:
            refuse_without_phase(self.kind, sensor)

    def explain(self) -> str:
        """One sentence."""
        shown = (
            "the sensor's unambiguous range"
            if self.unambiguous_range_mm is None
            else f"{self.unambiguous_range_mm:g} mm"
        )
        return f"ranges fold: surfaces beyond {shown} appear nearer by this length"

    def act(self, echoes: Echoes, context: Context) -> None:
        """Set the range of the fold; it is applied after noise and bias."""
        echoes.period_mm = context.turn_mm if self.unambiguous_range_mm is None else self.unambiguous_range_mm
