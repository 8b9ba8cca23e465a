"""Some pixels have more noise than the others: a hidden state of each pixel."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tofmix.arrays import BoolArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, EffectTruth, Latent, Level, Target
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.hidden import AffectedPixels, HiddenState
from tofmix.simulation.effects.parameter import UniformPrior, about, number

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class _Noisy(ExcessNoise):
    """A noisy pixel, as if all were."""

    kind: ClassVar[str] = "noisy_pixels"


@dataclass(frozen=True, slots=True, kw_only=True)
class NoisyPixels(Effect):
    """A share of the pixels, drawn once a recording, has ``factor`` times the noise of the others."""

    kind: ClassVar[str] = "noisy_pixels"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "spread of some pixels"
    typical: ClassVar[str] = "some per cent of the pixels"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("spread", "spread_pattern", "tails")
    latent: ClassVar[Latent] = Latent.PIXEL
    hidden: ClassVar[HiddenState | None] = AffectedPixels(("share",))
    remedy: ClassVar[str] = "Noisy pixels are found in the dark: leave them out by a mask."

    share: float = number(
        "Share of the pixels.",
        unit="1",
        low=0,
        high=1,
        zero=0,
        typical=(0.01, 0.2),
        prior=UniformPrior(low=0, high=0.5),
    )
    factor: float = number("Factor on their noise.", unit="1", low=1, high=100, typical=(1.5, 6), prior=about(2.5, 2))

    def explain(self) -> str:
        """One sentence."""
        return f"{100 * self.share:g} % of the pixels have {self.factor:g} times the noise of the others"

    def prepare(self, context: Context, n_frames: int) -> BoolArray:  # noqa: ARG002
        """Which pixels (pixel,) are noisy."""
        drawn = context.recording_rng(self).random(context.sensor.rows * context.sensor.cols)
        return np.asarray(drawn < self.share)

    def truth(self, prepared: Any) -> tuple[EffectTruth, ...]:  # noqa: ANN401
        """The map."""
        values = prepared.astype(np.uint8)
        return (EffectTruth(name=self.kind, dims=("row", "col"), values=values, unit="1", long_name="1 where noisy"),)

    def in_affected(self) -> Effect:
        """More noise."""
        return _Noisy(factor=self.factor)

    def act(self, echoes: Echoes, context: Context) -> None:
        """Scale the noise of these pixels."""
        echoes.scale_sigma(np.where(context.prepared, self.factor, 1.0))

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """The same."""
        self.act(prediction, context)
