"""Noise with memory from frame to frame."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Latent, Level, Target
from tofmix.simulation.effects.hidden import HiddenState, RememberedNoise
from tofmix.simulation.effects.parameter import UniformPrior, number

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class TemporalCorrelation(Effect):
    """Each pixel's standardised noise is AR(1) from frame to frame: e_t = rho e_(t-1) + sqrt(1 - rho^2) w_t.

    Charge that remains in the pixel, flicker noise of the read-out, or a filter in the camera's software links a frame
    to the one before. rho is 0.5 and more for a software filter, and some 0.01 for remaining charge. The memory
    continues across changes of surface, lost samples and random values. If the camera's noise has a shape, the normal
    scores of the errors are AR(1). The spread of a sample does not change. The variance of averages of n frames
    increases by about (1 + rho) / (1 - rho).
    """

    kind: ClassVar[str] = "temporal_correlation"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "memory: autocorrelation rho^k at a lag of k frames"
    typical: ClassVar[str] = "0.5 and more for a software filter, some 0.01 for charge that lags"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("memory", "neighbour_correlation", "common_mode")
    latent: ClassVar[Latent] = Latent.MEMORY
    hidden: ClassVar[HiddenState | None] = RememberedNoise(("coefficient",))
    predicts: ClassVar[str] = (
        "the distribution of single samples stays the same; after an error e, the next error of the pixel is normal"
        " about rho e with variance 1 - rho^2"
    )
    averages: ClassVar[bool] = False

    coefficient: float = number(
        "rho, the correlation of the noise in consecutive frames.",
        unit="1",
        low=-1,
        high=1,
        low_open=True,
        high_open=True,
        zero=0,
        typical=(0.05, 0.8),
        prior=UniformPrior(low=-1, high=1),
    )

    def explain(self) -> str:
        """One sentence."""
        return f"the noise of each pixel correlates with its noise in the frame before, by {self.coefficient:g}"

    def colour(self, noise: FloatArray, before: FloatArray) -> FloatArray:
        """One step of the AR(1) process."""
        coloured: FloatArray = self.coefficient * before + math.sqrt(1 - self.coefficient**2) * noise
        return coloured

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Nothing: the noise has its memory already."""

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """Nothing: the marginal distribution is unchanged."""
