"""Illumination and lens that are weaker towards the corners of the image."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number
from tofmix.simulation.effects.search import (
    SMALL_LOG,
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    spread_of_factor,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Vignetting(Effect):
    """Amplitude times (cos az cos el)^n, and sigma divided by it; the angles are those of the pixel's direction.

    The brightness of a lens falls with cos^4 of the angle off its axis, and the emitter's lobe falls too. For cos^4
    alone, the corner of 47 x 39 degrees has 1.78 times the sigma of the centre. n follows from `corner_factor`, the
    ratio of sigma in the corner of the image.
    """

    kind: ClassVar[str] = "vignetting"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = "spread against the distance from the image's centre, and amplitude"
    typical: ClassVar[str] = "1.8 in the corner of 47 x 39 degrees for cos^4 of the lens alone"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.SPREAD
    shows_in: ClassVar[tuple[str, ...]] = ("spread", "tails", "skew", "spread_pattern", "memory")

    corner_factor: float = number(
        "Sigma in the corner of the image, divided by sigma on the axis.",
        unit="1",
        low=1,
        high=100,
        zero=1,
        typical=(1.1, 4),
        prior=StudentPrior(scale=0.5 * math.log(4), log=True, half=True),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:  # noqa: ARG003
        """By the logarithm of the factor in the corner."""

        def make(x: FloatArray) -> Effect:
            return cls(corner_factor=math.exp(bounded(x[0], 0, 4)))

        yield Problem(make=make, starts=((0.05,), (0.3,), (0.8,)), steps=(0.1,))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:  # noqa: ARG003
        """The logarithm of the factor in the corner."""
        wider = Coefficient(
            effect=cls(corner_factor=math.exp(SMALL_LOG)), size=SMALL_LOG, spread=spread_of_factor(cls, "corner_factor")
        )
        yield LinearForm(coefficients=(wider,), make=lambda c: cls(corner_factor=math.exp(c[0])))

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:  # noqa: ARG002
        """An image of one pixel has no corner."""
        if sensor.rows == sensor.cols == 1:
            raise ValueError("corner_factor: an image of one pixel has no corner")

    def explain(self) -> str:
        """One sentence."""
        return f"light falls off towards the corners, where the noise is {self.corner_factor:g} times that on the axis"

    def prepare(self, context: Context, n_frames: int) -> FloatArray:  # noqa: ARG002
        """The illumination (pixel,) over that on the axis."""
        cosine = context.cosine()
        power = -math.log(self.corner_factor) / math.log(context.corner_cosine())
        illumination: FloatArray = np.maximum(cosine, 0.0) ** power
        return illumination

    def act(self, echoes: Echoes, context: Context) -> None:
        """Scale amplitude and sigma."""
        _scale(echoes, context.prepared)


def _scale(echoes: Echoes, illumination: Any) -> None:  # noqa: ANN401
    echoes.amplitude = echoes.amplitude * illumination
    echoes.scale_sigma(1.0 / illumination)
