"""Mixed pixels: the rival of equation (1), in which one sample mixes all that the pixel sees."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tofmix.arrays import BoolArray
from tofmix.simulation.echoes import ComplexArray, Echoes, FrameSamples
from tofmix.simulation.effects.base import Context, Effect, Level
from tofmix.simulation.effects.parameter import number

if TYPE_CHECKING:
    from tofmix.simulation.prediction import Prediction

_SEVERAL = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyingPixels(Effect):
    """With `probability`, a pixel that sees several surfaces returns the phasor sum of all instead of one of them.

    A pixel collects the light of its whole beam, so the physics of one exposure is the phasor sum,
    z = sum_i share_i A_i exp(2 pi i r_i / d_u): a range between the surfaces. Equation (1) instead lets each sample
    come from one surface. 0 is equation (1), 1 the phasor sum. Each pixel and frame decides by itself, where its
    event is a surface. The surfaces' phasors are those that the light effects before this one in the file give.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008: the "comet tail" of on-board averaging.
    """

    kind: ClassVar[str] = "flying_pixels"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "samples between the surfaces of a pixel"

    probability: float = number("Share of the samples that mix.", unit="1", low=0, high=1, zero=0, typical=(0.05, 1))

    def explain(self) -> str:
        """One sentence."""
        return (
            f"in pixels that see several surfaces, {100 * self.probability:g} % of the samples are the phasor sum of "
            "all, at a range where nothing stands"
        )

    def expect(self, prediction: "Prediction", context: Context) -> tuple[ComplexArray, BoolArray]:  # noqa: ARG002
        """The phasor sum (pixel,), and which pixels see several surfaces."""
        area = prediction.area()
        seen = np.zeros(prediction.shape[1], dtype=np.int64)
        for number_ in np.unique(prediction.surface[area > 0]):
            seen += ((prediction.surface == number_) & (area > 0)).any(axis=0)
        return (area * prediction.phasor()).sum(axis=0), seen >= _SEVERAL

    def act(self, echoes: Echoes, context: Context) -> None:
        """Mix every echo of a pixel that sees several surfaces."""
        mixed, several = context.expected
        z = echoes.phasor()
        echoes.replace_phasor(z, np.where(several, mixed, z))

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Mix those that chance picks."""
        mixed, several = context.expected
        picked = several & (context.frame_rng(self).random(samples.shape) < self.probability)
        z = samples.phasor()
        samples.replace_phasor(z, np.where(picked, mixed, z))

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """Every surface's component splits in two."""
        _, several = context.expected
        plain, flying = prediction.split(np.where(prediction.returned & several, self.probability, 0.0))
        self.act(flying, context)
        prediction.join(plain, flying)
