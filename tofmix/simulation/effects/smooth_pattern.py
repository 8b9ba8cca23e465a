"""A bias that is a smooth function of place in the image: of the lens, or of the lines that feed the pixels."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, EffectTruth, Level, Target, truth_of_bias
from tofmix.simulation.effects.parameter import StudentPrior, number
from tofmix.simulation.effects.search import (
    Coefficient,
    FormFacts,
    LinearForm,
    Problem,
    SearchFacts,
    image_places,
    spread_of,
)

_ELSEWHERE = "another scene: the pattern stays with its pixels"

_FORMS = (
    ("radial_2_mm",),
    ("radial_2_mm", "radial_4_mm"),
    ("across_mm", "down_mm"),
    ("across_mm", "down_mm", "across_2_mm", "down_2_mm"),
)
"""Coefficients that are fitted together: of a lens, of lines, of lines that bend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothPattern(Effect):
    """Every range is longer by a polynomial of the pixel's place, the same in every frame.

    x and y are the place, right and down of the image's centre in half diagonals, so that rho^2 = x^2 + y^2 is 1 in the
    corners. The bias is across x + down y + across_2 x^2 + down_2 y^2 + radial_2 rho^2 + radial_4 rho^4. It is 0 in the
    centre: the bias there is `range_offset`.

    A model of the lens that is not the camera's turns each beam by a little, and a lens of wide angle has longer ways
    at its rim: a bias that grows with the radius. Clock lines feed the pixels from one side, and light of the lamp
    takes some time from its place beside the lens: a bias along columns or rows. Calibrations fit such a function of
    row and column, of some mm, beside the pattern of single pixels (`fixed_pattern`).

    References
    ----------
    Fuchs and Hirzinger, Extrinsic and depth calibration of ToF-cameras, CVPR 2008: a bias that is linear in row and
    column. Kahlmann, Remondino and Ingensand, ISPRS Archives XXXVI-5, 2006: the pattern grows towards the corners.
    """

    kind: ClassVar[str] = "smooth_pattern"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias as a smooth function of row and column, the same in every frame and every scene"
    typical: ClassVar[str] = "some mm from the centre to the corner or from side to side"
    basis: ClassVar[str] = "reported"
    remedy: ClassVar[str] = (
        "A smooth bias over the image is that of the lens or of the read-out: give the model the camera's own"
        " intrinsics and distortion, or measure the ranges of a flat wall and subtract their difference from it."
    )
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "a scene that fills the image",
        "surface_pose": _ELSEWHERE,
        "surface_offset": _ELSEWHERE,
        "multipath": _ELSEWHERE,
        "scattering": _ELSEWHERE,
        "internal_reflection": _ELSEWHERE,
        "wiggling": _ELSEWHERE,
        "amplitude_walk": _ELSEWHERE,
        "fixed_pattern": "more frames of the same scene",
    }

    radial_2_mm: float = number(
        "Bias in the corners that grows with the square of the radius.",
        unit="mm",
        low=-10_000,
        high=10_000,
        default=0,
        zero=0,
        typical=(1, 30),
        prior=StudentPrior(scale=10, dof=4),
    )
    radial_4_mm: float = number(
        "Bias in the corners that grows with its fourth power.",
        unit="mm",
        low=-10_000,
        high=10_000,
        default=0,
        zero=0,
        typical=(1, 30),
        prior=StudentPrior(scale=10, dof=4),
    )
    across_mm: float = number(
        "Bias of half a diagonal to the right of the centre.",
        unit="mm",
        low=-10_000,
        high=10_000,
        default=0,
        zero=0,
        typical=(1, 20),
        prior=StudentPrior(scale=6, dof=4),
    )
    down_mm: float = number(
        "Bias of half a diagonal below the centre.",
        unit="mm",
        low=-10_000,
        high=10_000,
        default=0,
        zero=0,
        typical=(1, 20),
        prior=StudentPrior(scale=6, dof=4),
    )
    across_2_mm: float = number(
        "Bias of half a diagonal to either side, that grows with the square.",
        unit="mm",
        low=-10_000,
        high=10_000,
        default=0,
        zero=0,
        typical=(1, 20),
        prior=StudentPrior(scale=10, dof=4),
    )
    down_2_mm: float = number(
        "Bias of half a diagonal above and below, that grows with the square.",
        unit="mm",
        low=-10_000,
        high=10_000,
        default=0,
        zero=0,
        typical=(1, 20),
        prior=StudentPrior(scale=10, dof=4),
    )

    @classmethod
    def problems(cls, facts: SearchFacts) -> Iterator[Problem]:
        """By some of the coefficients, from those that explain most residuals, with and without an offset."""

        def made(names: tuple[str, ...], x: FloatArray) -> Effect:
            return cls(**dict(zip(names, (float(v) * facts.sigma_mm for v in x), strict=True)))

        known = ~np.isnan(facts.residual_mm)
        wanted = facts.residual_mm[known] / facts.noise_mm[known]
        for names in _FORMS if known.any() else ():
            columns = np.stack([of_place(facts.place[known])[name] for name in names], axis=1)
            starts = []
            for taken in (columns, np.column_stack([columns, np.ones(len(columns))])):
                found = np.linalg.lstsq(taken / facts.noise_mm[known, None], wanted, rcond=None)[0]
                starts.append(tuple(float(v) for v in found[: len(names)] / facts.sigma_mm))
            yield Problem(make=partial(made, names), starts=tuple(starts), steps=(0.2,) * len(names))

    @classmethod
    def linear_forms(cls, facts: FormFacts) -> Iterator[LinearForm]:
        """Its coefficients."""

        def made(names: tuple[str, ...], c: FloatArray) -> Effect:
            return cls(**dict(zip(names, map(float, c), strict=True)))

        size = facts.sigma_mm
        each = {
            name: Coefficient(effect=cls(**{name: size}), size=size, spread=spread_of(cls, name))
            for name in cls.parameters()
        }
        for names in _FORMS:
            yield LinearForm(
                coefficients=tuple(each[name] for name in names), make=partial(made, names), choices=len(_FORMS)
            )

    def explain(self) -> str:
        """One sentence."""
        values = {f.name.removesuffix("_mm"): getattr(self, f.name) for f in fields(self)}
        named = ", ".join(f"{name} {value:g} mm" for name, value in values.items() if value) or "0 mm"
        return f"the bias is a smooth function of place in the image: {named}"

    def prepare(self, context: Context, n_frames: int) -> FloatArray:  # noqa: ARG002
        """The bias (pixel,), mm."""
        laws = of_place(image_places(context.sensor.shape))
        return np.asarray(sum(getattr(self, name) * law for name, law in laws.items()))

    def truth(self, prepared: Any) -> tuple[EffectTruth, ...]:  # noqa: ANN401
        """The map of the bias."""
        return truth_of_bias(self.kind, prepared)

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add each pixel's bias."""
        echoes.add_bias(context.prepared)


def of_place(place: FloatArray) -> dict[str, FloatArray]:
    """What each coefficient multiplies (pixel,), at some places (pixel, 2)."""
    x, y = place.T
    square = x**2 + y**2
    return {
        "radial_2_mm": square,
        "radial_4_mm": square**2,
        "across_mm": x,
        "down_mm": y,
        "across_2_mm": x**2,
        "down_2_mm": y**2,
    }
