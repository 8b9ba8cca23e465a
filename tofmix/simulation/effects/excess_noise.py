"""More noise than the sensor's curve gives: everywhere, on one surface, in a spot, or by the angle of incidence."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects import spot
from tofmix.simulation.effects.base import Basic, Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import PixelMap, Prior, StudentPrior, about, number, pixel_map, surface
from tofmix.simulation.effects.search import (
    EFFECT_NATS,
    SMALL_LOG,
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    bounded,
    image_places,
    spread_of,
    spread_of_factor,
)

_STARTS = (0.9, 1.1, 1.5)  # factors

_EXPONENTS = (0.3, 1.0)
"""Where searches for the exponent of the cosine begin."""

_STEEPER = 0.05
"""Exponent, for slopes."""

_BY_ANGLE, _IN_A_PART = "by angle", "in a part of the image"
"""Names of the forms."""

_ADDED = StudentPrior(scale=math.log(2), log=True, half=True)
"""Of one surface, or of a part of the image: light that falls on it adds noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExcessNoise(Effect):
    """Sigma times `factor` / cos(incidence)^`angle_exponent`, of every sample with a return or of one surface.

    Phase noise is sqrt(B) / A: if the background dominates, more ambient light or a weaker emitter increases every
    sigma by the same factor. Four times the background electrons double sigma. Light that falls on one surface, such as
    the sun through a window, does so for this surface alone: its ranges and its amplitudes remain as they are. Light
    that falls on a part of a wall is a spot: sigma is times the root of 1 + (`factor`^2 - 1) light, with a Gaussian of
    the pixel's place as the light, 1 in the middle and exp(-1/2) at the radii. `reconcile` looks for a spot at the
    price of one more effect. A second camera that lights a part of the image (`interference`) is told from it only
    where sigma differs within the spot. A map gives each pixel a further factor; `reconcile` looks for none.

    A sensor's curve is measured on a board that faces the camera. A slanted surface returns less light, as the cosine
    of incidence: sigma grows with an exponent of 1 where the background dominates, and of 1/2 where the signal's own
    electrons do. A pixel of the slanted surface also covers more ranges. The noise of depth cameras is reported to grow
    with the angle, strongly above 60 degrees. The angle is that between a beam and the surface's normal, by the model.
    `reconcile` looks for the exponent of all surfaces, beside the factor, at the price of one more effect.

    References
    ----------
    Lange and Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448: sigma is sqrt(B) / A.
    Nguyen, Izadi and Lovell, Modeling Kinect sensor noise for improved 3D reconstruction and tracking, 3DIMPVT 2012.
    """

    kind: ClassVar[str] = "excess_noise"
    level: ClassVar[Level] = Level.LIGHT
    signature: ClassVar[str] = (
        "spread, by the same factor everywhere or on one surface, or more on slanted surfaces; no bias"
    )
    typical: ClassVar[str] = "2 for four times the background electrons; 1 / cos of the angle, 2 at 60 degrees"
    basis: ClassVar[str] = "physics"
    target: ClassVar[Target] = Target.SPREAD
    basic: ClassVar[Basic | None] = Basic.NOISE
    shows_in: ClassVar[tuple[str, ...]] = ("spread", "tails", "skew", "spread_pattern", "memory")
    separated_from: ClassVar[Mapping[str, str]] = {
        "vignetting": "a flat wall that fills the image; and the same wall at another angle",
    }

    factor: float = number(
        "Factor on sigma.", unit="1", low=0.01, high=100, zero=1, typical=(1.05, 3), prior=about(1, 2)
    )
    surface: str = surface("The only surface with more noise; all surfaces if it is left out.", required=False)
    map: PixelMap | None = pixel_map(  # noqa: RUF009
        "Further factor of each pixel, such as of a part of the image in the sun.", unit="1"
    )
    angle_exponent: float = number(
        "Sigma is divided by the cosine of incidence to the power of this.",
        unit="1",
        low=0,
        high=10,
        default=0,
        zero=0,
        typical=(0.5, 1.5),
        prior=StudentPrior(scale=1, half=True),
    )

    spot_across: float | None = spot.place("to the right of")
    spot_down: float | None = spot.place("below")
    spot_radius_across: float | None = spot.radius("rows")
    spot_radius_down: float | None = spot.radius("columns")

    def __post_init__(self) -> None:
        Effect.__post_init__(self)
        spot.of(self)

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """By the logarithm of the factor: of all surfaces, and of each if there are several; of a spot; by the angle.

        The spot begins where the noise shows it.
        """

        def made(surface: str, x: FloatArray) -> "ExcessNoise":
            low, high = (
                math.log(1.0 if surface else cls.parameters()["factor"].low),
                math.log(cls.parameters()["factor"].high),
            )
            return cls(surface=surface, factor=math.exp(bounded(x[0], low, high)))

        for name in _alone(s.name for s in facts.surfaces):
            starts = tuple((math.log(f),) for f in _STARTS if f > 1 or not name)
            yield Problem(make=partial(made, name), starts=starts, steps=(0.2,))

        def by_angle(x: FloatArray) -> Effect:
            return replace(made("", x), angle_exponent=bounded(x[1], 0, cls.parameters()["angle_exponent"].high))

        yield Problem(
            make=by_angle,
            starts=tuple((0.0, exponent) for exponent in _EXPONENTS),
            steps=(0.2, 0.2),
            form=_BY_ANGLE,
            price_nats=EFFECT_NATS,
        )

        def in_a_part(x: FloatArray) -> Effect:
            factor = math.exp(bounded(x[0], 0.0, math.log(cls.parameters()["factor"].high)))
            return cls(factor=factor, **spot.from_vector(x[1:]))

        spots = tuple((0.5 * math.log1p(size), *x) for size, x in spot.measured(facts, np.ones(facts.noise_mm.size)))
        if spots:
            yield Problem(
                make=in_a_part, starts=spots, steps=(0.2, *spot.STEPS), form=_IN_A_PART, price_nats=EFFECT_NATS
            )

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """The logarithm of the factor: of all surfaces, and of each if there are several. Then with the exponent."""

        def made(surface: str, c: FloatArray) -> "ExcessNoise":
            return cls(surface=surface, factor=math.exp(max(c[0], 0.0) if surface else c[0]))

        spread = spread_of_factor(cls, "factor")
        for name in _alone(s.name for s in facts.surfaces):
            make = partial(made, name)
            wider = Coefficient(effect=make(np.array([SMALL_LOG])), size=SMALL_LOG, spread=spread)
            yield LinearForm(coefficients=(wider,), make=make, surface=name)

        def by_angle(c: FloatArray) -> Effect:
            return replace(made("", c), angle_exponent=max(float(c[1]), 0.0))

        of_all = Coefficient(effect=made("", np.array([SMALL_LOG])), size=SMALL_LOG, spread=spread)
        steeper = Coefficient(
            effect=cls(factor=1.0, angle_exponent=_STEEPER), size=_STEEPER, spread=spread_of(cls, "angle_exponent")
        )
        yield LinearForm(coefficients=(of_all, steeper), make=by_angle, form=_BY_ANGLE)

    def is_basic(self, error: Basic) -> bool:
        """The noise of all surfaces is what every model may have wrong; that of one surface is not."""
        return Effect.is_basic(self, error) and not self.surface and self.spot_across is None

    def priors(self) -> dict[str, Prior]:
        """That of all surfaces is larger or smaller; that of one surface is larger. Without an exponent it has none."""
        own = Effect.priors(self) | ({"factor": _ADDED} if self.surface or self.spot_across is not None else {})
        return {name: prior for name, prior in own.items() if name != "angle_exponent" or self.angle_exponent}

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:
        """Refuse a map with values that are no factors."""
        Effect.check(self, sensor, surfaces)
        if self.map is not None and not (np.isfinite(self.map.values) & (self.map.values > 0)).all():
            raise ValueError("map: every pixel needs a finite factor above 0")

    def explain(self) -> str:
        """One sentence."""
        of = f' of "{self.surface}"' if self.surface else ""
        mapped = "" if self.map is None else f", and a factor of each pixel from {self.map.path or 'a map'}"
        divided = f", divided by the cosine of incidence to the power of {self.angle_exponent:g}"
        own = spot.of(self)
        of += "" if own is None else f" {spot.words_of(own)}"
        return f"the noise{of} is {self.factor:g} times the sensor's{divided if self.angle_exponent else ''}{mapped}"

    def act(self, echoes: Echoes, context: Context) -> None:
        """Scale sigma."""
        own, factor = spot.of(self), np.asarray(self.factor)
        if own is not None:
            factor = np.sqrt(1 + (self.factor**2 - 1) * spot.light_of(own, image_places(context.sensor.shape)))
        if self.map is not None:
            factor = factor * self.map.values.ravel().astype(np.float64)
        if self.angle_exponent:
            factor = factor * context.incidence(echoes) ** -self.angle_exponent
        if self.surface:
            factor = np.where(echoes.surface == context.number_of(self.surface), factor, 1.0)
        echoes.scale_sigma(factor)


def _alone(names: Iterable[str]) -> list[str]:
    """The surfaces that may have noise of their own, after all together (empty): none where there is one."""
    each = list(names)
    return ["", *each] if len(each) > 1 else [""]
