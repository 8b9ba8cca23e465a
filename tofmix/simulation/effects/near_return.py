"""Samples of a direct sensor that are of its own cover glass or housing."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import UniformPrior, about, number
from tofmix.simulation.effects.search import Problem, SearchFacts, bounded

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class NearReturn(Effect):
    """With `share`, a sample is a return near the camera: of mean `range_mm` and standard deviation `sigma_mm`.

    A sensor that times single returns (SPAD, pulsed laser) now and then times the light that its cover glass or housing
    reflects. The way is short and the same in every pixel, whatever the scene. Each pixel and frame is drawn
    independently, also where the pixel would have returned nothing. Biases, light effects and excess noise do not act
    on such a sample, and its amplitude is 0, as without a surface. Shares and ranges of the recording's truth are those
    of the scene. In a lock-in camera the same light adds its phasor to every sample: `internal_reflection`.

    References
    ----------
    STMicroelectronics, VL53L0X ranging module cover window guidelines, AN4907: crosstalk by the air gap and the
    transmission of the cover glass.
    """

    kind: ClassVar[str] = "near_return"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "samples at one short range, in the same share in every pixel"
    typical: ClassVar[str] = "0.5 to 30 % of the samples at 10 to 100 mm, by smudges and the gap below the glass"
    basis: ClassVar[str] = "assumed"
    remedy: ClassVar[str] = (
        "Returns of the cover glass are before everything else: narrow the gap between sensor and glass, clean the"
        " glass, or discard samples nearer than the scene. `tofmix estimate` marks their layer in the flags of"
        " `suspect`."
    )
    target: ClassVar[Target] = Target.VALUES
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "tails", "skew", "spread")
    averages: ClassVar[bool] = False

    share: float = number(
        "Share of the samples.",
        unit="1",
        low=0,
        high=1,
        zero=0,
        typical=(0.005, 0.3),
        prior=UniformPrior(low=0, high=0.5),
    )
    range_mm: float = number("Their mean range.", unit="mm", low=1, high=60_000, typical=(10, 100), prior=about(40, 2))
    sigma_mm: float = number(
        "Standard deviation of their ranges.",
        unit="mm",
        low=0,
        high=10_000,
        low_open=True,
        typical=(1, 20),
        prior=about(5, 2.5),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """From the samples before the scene; none without such samples."""
        likely = cls.parameters()["range_mm"].prior
        found = facts.nearer(*((0.0, math.inf) if likely is None else likely.farthest))
        if found is None:
            return

        def make(x: FloatArray) -> Effect:
            share, range_mm, sigma_mm = (math.exp(bounded(v, -25, 12)) for v in x)
            return cls(share=share, range_mm=range_mm, sigma_mm=sigma_mm)

        yield Problem(make=make, starts=(tuple(math.log(v) for v in found),), steps=(0.2, 0.05, 0.2))

    def explain(self) -> str:
        """One sentence."""
        return (
            f"{100 * self.share:g} % of the samples are of the camera's own cover glass or housing: "
            f"{self.range_mm:g} +- {self.sigma_mm:g} mm"
        )

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Replace samples by near returns; random values stay."""
        near = context.frame_rng(self).random(samples.shape) < self.share
        samples.surface = np.where(near, -1, samples.surface)
        samples.true_range_mm = np.where(near, self.range_mm, samples.true_range_mm)
        samples.range_mm = np.where(near, self.range_mm, samples.range_mm)
        samples.amplitude = np.where(near, 0.0, samples.amplitude)
        samples.sigma_mm = np.where(near, self.sigma_mm, samples.sigma_mm)

    def predict(self, prediction: "Prediction", context: Context) -> None:  # noqa: ARG002
        """One more component, which takes its share from every other."""
        scene, near = prediction.split(self.share)
        pixels = prediction.shape[1]
        near.weight = near.weight.sum(axis=0, keepdims=True)
        near.surface = np.full((1, pixels), -1)
        near.true_range_mm = near.range_mm = np.full((1, pixels), float(self.range_mm))
        near.amplitude = np.zeros((1, pixels))
        near.sigma_mm = np.full((1, pixels), float(self.sigma_mm))
        prediction.join(scene, near)
