"""Random values in addition to the sensor's own."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import UniformPrior, number
from tofmix.simulation.effects.search import Problem, SearchFacts, of_logarithm

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class Outliers(Effect):
    """Samples are uniform over the working range with this probability, in addition to `outlier_probability`.

    Causes are bit errors, cosmic rays, switching disturbances, and changes of the exposure time. The paper gives 1e-4
    for the SR-3000; a worn or disturbed camera has 1e-3 to 1e-2. A random value replaces the pixel's sample after all
    effects but stuck pixels and quantisation. It is never lost.
    """

    kind: ClassVar[str] = "outliers"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "tails: samples anywhere in the working range"
    typical: ClassVar[str] = "1e-4 in the paper; 1e-3 to 1e-2 for a disturbed camera"
    basis: ClassVar[str] = "the paper supplies it; the rest assumed"
    target: ClassVar[Target] = Target.VALUES
    shows_in: ClassVar[tuple[str, ...]] = ("tails", "skew", "spread", "memory")
    averages: ClassVar[bool] = False

    probability: float = number(
        "Share of the samples.",
        unit="1",
        low=0,
        high=1,
        high_open=True,
        zero=0,
        typical=(0.001, 0.05),
        prior=UniformPrior(low=0, high=0.5),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:  # noqa: ARG003
        """By the logarithm of the probability."""
        yield of_logarithm(cls, "probability", (0.0005, 0.01), most=0.5)  # half of the samples

    @property
    def outlier_share(self) -> float:
        """Probability."""
        return self.probability

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:  # noqa: ARG002
        """Refuse to leave no sample to the surfaces."""
        rest = 1 - float(np.max(sensor.random_share))
        if self.probability >= rest:
            raise ValueError(
                f"probability: {self.probability:g} is not below {rest:g}, 1 less the sensor's random values"
            )

    def explain(self) -> str:
        """One sentence."""
        return f"{100 * self.probability:g} % more samples are random values anywhere in the working range"

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Replace samples that are not random values yet."""
        rng, sensor = context.frame_rng(self), context.sensor
        others = 1 - np.broadcast_to(sensor.random_share, sensor.shape).ravel()
        hit = rng.random(samples.shape) * others < self.probability
        value = rng.uniform(sensor.range_min_mm, sensor.range_max_mm, samples.shape)
        replaced = hit & ~samples.outlier
        samples.outlier_mm = np.where(replaced, value, samples.outlier_mm)

    def predict(self, prediction: "Prediction", context: Context) -> None:  # noqa: ARG002
        """Move weight from all else to the random values."""
        prediction.replace_by_outliers(self.probability)
