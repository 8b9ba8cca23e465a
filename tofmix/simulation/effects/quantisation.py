"""Ranges in coarse steps."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Latent, Level, Target
from tofmix.simulation.effects.hidden import HiddenState, RangeStep
from tofmix.simulation.effects.parameter import UniformPrior, number

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantisation(Effect):
    """Every range, also without a return, is rounded to a multiple of `step_mm`, then to whole mm.

    A phase word of b bits has steps of d_u / 2^b: 1.8 mm for 12 bits at 20 MHz, 7.3 mm for 10, 29 mm for 8. Steps well
    below sigma add a variance of step^2 / 12, and no bias. A step of 0 rounds to whole mm only.
    """

    kind: ClassVar[str] = "quantisation"
    level: ClassVar[Level] = Level.READ_OUT
    signature: ClassVar[str] = "discreteness: ranges are multiples of one step"
    typical: ClassVar[str] = "steps of d_u / 2^b: 1.8, 7.3, 29 mm for 12, 10, 8 bits at 20 MHz"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.VALUES
    shows_in: ClassVar[tuple[str, ...]] = ("discreteness",)
    latent: ClassVar[Latent] = Latent.STEP
    hidden: ClassVar[HiddenState | None] = RangeStep(("step_mm",))
    exact_law: ClassVar[bool] = True

    step_mm: float = number(
        "Step between values; 0 for none.",
        unit="mm",
        low=0,
        high=10_000,
        zero=0,
        typical=(2, 60),
        prior=UniformPrior(low=0, high=1000),
    )

    def explain(self) -> str:
        """One sentence."""
        return f"ranges are rounded to multiples of {self.step_mm:g} mm"

    def sample(self, samples: FrameSamples, context: Context) -> None:  # noqa: ARG002
        """Round."""
        samples.measured_mm = self._rounded(samples.measured_mm)

    def predict(self, prediction: "Prediction", context: Context) -> None:  # noqa: ARG002
        """Remember the step; pixels stuck before it are rounded too."""
        if self.step_mm > 0:
            prediction.step_mm = self.step_mm
            prediction.stuck_mm = self._rounded(prediction.stuck_mm)

    def _rounded(self, range_mm: FloatArray) -> FloatArray:
        return np.rint(range_mm / self.step_mm) * self.step_mm if self.step_mm > 0 else range_mm
