"""Ranges beyond the unambiguous one, folded back."""

from dataclasses import dataclass
from typing import ClassVar

from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level
from tofmix.simulation.effects.parameter import number


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseWrapping(Effect):
    """Ranges, noise and bias included, modulo `unambiguous_range_mm`.

    A phase is known up to whole turns: what is beyond d_u = c / (2 f) seems near, and noise carries samples across
    the turn both ways. This is no error but how such a camera measures (physics). Samples without a return are no
    measured phases and stay at `range_max_mm`; random values stay too. A range that folds to 0 is stored as 1 mm.
    """

    kind: ClassVar[str] = "phase_wrapping"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "far samples appear near"
    averages: ClassVar[bool] = False

    unambiguous_range_mm: float = number(
        "Range at which the phase has turned once; c / (2 f) of the sensor if it is left out.",
        unit="mm", low=0, high=1e6, low_open=True, required=False,
    )  # fmt: skip

    def explain(self) -> str:
        """One sentence."""
        shown = (
            "the sensor's unambiguous range"
            if self.unambiguous_range_mm is None
            else f"{self.unambiguous_range_mm:g} mm"
        )
        return f"ranges fold: what is beyond {shown} appears that much nearer"

    def act(self, echoes: Echoes, context: Context) -> None:
        """Say where ranges fold; it is done once noise and bias are in."""
        echoes.period_mm = context.turn_mm if self.unambiguous_range_mm is None else self.unambiguous_range_mm
