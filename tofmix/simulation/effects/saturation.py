"""Bright samples that exceed the full well of the pixel."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.special import ndtr

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import number
from tofmix.simulation.effects.search import Problem, SearchFacts

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction


_NEAR, _FAR = 0.03, 0.1
"""Relative noise of an amplitude; relative size of a gap between amplitudes, from which it is an error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Saturation(Effect):
    """Samples with an amplitude above `full_well_amplitude` are invalid.

    A pixel holds a limited number of electrons. Bright or near surfaces fill it, the taps lose their difference, and
    the camera marks the sample as invalid. The limit depends on exposure and reflectivity: in the units of a model, a
    white board at 1 m and 1.2 ms has an amplitude of about 1000. The amplitude is the light's, after all light effects.
    Ambient light also fills the well; it is not simulated.
    """

    kind: ClassVar[str] = "saturation"
    level: ClassVar[Level] = Level.CORRELATION
    signature: ClassVar[str] = "invalid share of bright samples"
    typical: ClassVar[str] = "a white board nearer than some 0.5 to 1 m, by exposure"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.LOSS
    shows_in: ClassVar[tuple[str, ...]] = ("invalid",)
    averages: ClassVar[bool] = False
    loses_by_noise: ClassVar[bool] = True

    full_well_amplitude: float = number(
        "Largest amplitude that is valid.", unit="1", low=0, high=1e9, low_open=True, zero=1e9, typical=(100, 5000)
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """By the logarithm of the well, from amplitudes; only if samples are lost."""
        if not facts.lost_shares.any():
            return

        def make(x: FloatArray) -> Effect:
            return cls(full_well_amplitude=math.exp(x[0]))

        most = 0.5  # a pixel that loses most samples is saturated
        hit = (facts.lost_shares > most) & (facts.amplitudes > 0)
        spare = np.quantile(facts.lit_amplitudes, (0.5, 0.8, 0.9, 0.95, 0.98, 0.995))
        of_hit = np.quantile(facts.amplitudes[hit], (0.0, 0.02, 0.1)) if hit.any() else spare[:0]
        levels = np.concatenate([of_hit, spare])
        yield Problem(make=make, starts=tuple((math.log(level),) for level in levels), steps=(0.02,))

    def explain(self) -> str:
        """One sentence."""
        return f"samples of amplitude over {self.full_well_amplitude:g} are invalid"

    def sample(self, samples: FrameSamples, context: Context) -> None:  # noqa: ARG002
        """Lose samples that are too bright."""
        samples.lose(samples.amplitude > self.full_well_amplitude)

    def least_errors(self, amplitude: FloatArray) -> dict[str, float]:
        """Half of the distance to the next amplitude, up or down, if it is large: no sample lies between."""
        full = self.full_well_amplitude
        below, above = amplitude[amplitude < full * (1 - _NEAR)], amplitude[amplitude > full * (1 + _NEAR)]
        ways = [full - below.max() if below.size else 0.0, above.min() - full if above.size else 0.0]
        return {"full_well_amplitude": 0.5 * max([float(step) for step in ways if step > _FAR * full], default=0.0)}

    def lose_by_noise(self, prediction: "Prediction") -> None:
        """A smooth edge: the amplitude of a sample has the noise of its phase."""
        noise = prediction.amplitude * prediction.sigma_mm * (2 * np.pi / prediction.turn_mm)
        over = (prediction.amplitude - self.full_well_amplitude) / np.maximum(noise, 1e-9)
        prediction.lose(np.where(prediction.returned, ndtr(over), 0.0))

    def predict(self, prediction: "Prediction", context: Context) -> None:  # noqa: ARG002
        """Move the weight of components that are too bright to the invalid samples."""
        prediction.lose((prediction.amplitude > self.full_well_amplitude).astype(np.float64))
