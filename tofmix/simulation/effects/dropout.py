"""Samples that are lost at random, or because they are dark."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.special import ndtr

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import UniformPrior, number
from tofmix.simulation.effects.search import Problem, SearchFacts, bounded

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class Dropout(Effect):
    """Samples are invalid with `probability`, and where amplitude plus Gaussian noise falls below `threshold`.

    Cameras mark samples of low amplitude as invalid. At the default threshold of a camera, far or dark surfaces lose
    some or all of their samples, and open space loses all. Lost packets and read-out conflicts remove samples at
    random. The amplitude is the light's, after all light effects. A threshold of 0 removes none.
    """

    kind: ClassVar[str] = "dropout"
    level: ClassVar[Level] = Level.READ_OUT
    signature: ClassVar[str] = "invalid share, the same everywhere or against amplitude"
    typical: ClassVar[str] = "any share, by the camera's amplitude threshold"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.LOSS
    shows_in: ClassVar[tuple[str, ...]] = ("invalid",)
    separated_from: ClassVar[Mapping[str, str]] = {
        "saturation": "surfaces of other reflectivities",
    }

    probability: float = number(
        "Share of the samples that is lost at random.",
        unit="1",
        low=0,
        high=1,
        default=0,
        zero=0,
        typical=(0.001, 0.2),
        prior=UniformPrior(low=0, high=1),
    )
    threshold: float = number(
        "Smallest valid amplitude; 0 for no limit.", unit="1", low=0, high=1e9, default=0, zero=0, typical=(1, 200)
    )
    threshold_noise: float = number(
        "Standard deviation of the noise on the compared amplitude.", unit="1", low=0, high=1e9, default=0
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """At random, and with a threshold; only if samples are lost."""
        lost = float(facts.lost_shares.mean())
        if lost <= 0:
            return

        def by_chance(x: FloatArray) -> Effect:
            return cls(probability=math.exp(bounded(x[0], -20, -0.01)))

        def weak(x: FloatArray) -> Effect:
            threshold = math.exp(x[0])
            return cls(
                probability=math.exp(bounded(x[1], -20, -0.01)),
                threshold=threshold,
                threshold_noise=threshold * math.exp(bounded(x[2], -7, 1)),
            )

        yield Problem(make=by_chance, starts=((math.log(lost),),), steps=(0.1,))
        levels = np.quantile(facts.lit_amplitudes, (0.005, 0.02, 0.06, 0.15, 0.4))
        starts = tuple(
            (math.log(level * part), math.log(rest * lost), width)
            for level in levels
            for part in (0.8, 1.0)
            for rest in (0.02, 0.5)
            for width in (-3.5, -2.0)
        )
        yield Problem(make=weak, starts=starts, steps=(0.05, 0.4, 0.4))

    def explain(self) -> str:
        """One sentence."""
        dark = f"those of amplitude below {self.threshold:g} (+-{self.threshold_noise:g})" if self.threshold else ""
        chance = f"{100 * self.probability:g} % of the samples" if self.probability or not dark else ""
        return f"{' and '.join(part for part in (chance, dark) if part)} are lost"

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Lose samples at random and by threshold."""
        rng = context.frame_rng(self)
        lost = rng.random(samples.shape) < self.probability
        if self.threshold > 0:
            noise = rng.standard_normal(samples.shape) * self.threshold_noise
            lost |= samples.amplitude + noise < self.threshold
        samples.lose(lost)

    def predict(self, prediction: "Prediction", context: Context) -> None:  # noqa: ARG002
        """Move weight to the invalid samples."""
        prediction.lose(self.probability)
        if self.threshold > 0:
            short = self.threshold - prediction.amplitude
            lost = ndtr(short / self.threshold_noise) if self.threshold_noise > 0 else (short > 0).astype(np.float64)
            prediction.lose(lost)
