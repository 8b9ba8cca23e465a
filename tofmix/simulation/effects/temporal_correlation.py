"""Noise with memory from frame to frame."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Latent, Level, Target
from tofmix.simulation.effects.parameter import number

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class TemporalCorrelation(Effect):
    """Each pixel's standardised noise is AR(1) from frame to frame: e_t = rho e_(t-1) + sqrt(1 - rho^2) w_t.

    Charge that stays behind in the pixel, flicker noise of the read-out, or a filter in the camera's software link a
    frame to the one before. A software filter reaches 0.5 and more; charge that lags, some 0.01. The memory runs on
    across changes of surface, lost samples and random values. Where the camera's noise has a shape of its own, this is
    so of its normal scores. The spread of a sample is unchanged; averages of n
    frames have a variance larger by about (1 + rho) / (1 - rho).
    """

    kind: ClassVar[str] = "temporal_correlation"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "memory: autocorrelation rho^k at a lag of k frames"
    typical: ClassVar[str] = "0.5 and more for a software filter, some 0.01 for charge that lags"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("memory", "neighbour_correlation", "common_mode")
    latent: ClassVar[Latent] = Latent.MEMORY
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
