"""Ranges beyond the unambiguous one, folded back."""

from dataclasses import dataclass
from typing import ClassVar

from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target, refuse_without_phase
from tofmix.simulation.effects.parameter import number


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
