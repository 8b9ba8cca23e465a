"""Smooth laws without a name: a polynomial over the image, or over range. They are members of sets like effects.

The nearest effect imitates most of an unknown law. So such laws compete with effects, at the same price, and where one
is clearly better than every named set, no effect is named.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, Level, Target
from tofmix.simulation.effects.parameter import StudentPrior, number
from tofmix.simulation.effects.search import Coefficient, LinearForm, Problem

_SPREAD_MM = 25.0  # of a coefficient: as large as an offset of a camera
_MIDDLE_MM, _UNIT_MM = 2500.0, 1000.0  # of range, so that coefficients are biases within a room
PLACE, RANGE = "place in the image", "range"
LAWS = ((PLACE, 3), (PLACE, 6), (RANGE, 3))
"""Axes, each with a number of coefficients: over the image a plane, or a curved surface."""

_PRIOR = StudentPrior(scale=_SPREAD_MM)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unnamed(Effect):
    """A smooth bias that is no known effect. No model file can have it."""

    kind: ClassVar[str] = "unnamed"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias"
    typical: ClassVar[str] = "any"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")

    over_range: float = number("1 over range, 0 over the image.", unit="1", default=0)
    c0_mm: float = number("Constant.", unit="mm", default=0, prior=_PRIOR)
    c1_mm: float = number("By column, or by range.", unit="mm", default=0, prior=_PRIOR)
    c2_mm: float = number("By row, or by the square of range.", unit="mm", default=0, prior=_PRIOR)
    c3_mm: float = number("By the square of the column.", unit="mm", default=0, prior=_PRIOR)
    c4_mm: float = number("By column times row.", unit="mm", default=0, prior=_PRIOR)
    c5_mm: float = number("By the square of the row.", unit="mm", default=0, prior=_PRIOR)

    def explain(self) -> str:
        """One sentence."""
        return f"the bias is a smooth function of {RANGE if self.over_range else PLACE}"

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add the bias."""
        if self.over_range:
            r = (echoes.true_range_mm - _MIDDLE_MM) / _UNIT_MM
            echoes.add_bias(self.c0_mm + self.c1_mm * r + self.c2_mm * r * r)
            return
        rows, cols = context.sensor.rows, context.sensor.cols
        row, col = np.divmod(np.arange(rows * cols), cols)
        v, u = 2 * row / max(rows - 1, 1) - 1, 2 * col / max(cols - 1, 1) - 1
        plane = self.c0_mm + self.c1_mm * u + self.c2_mm * v
        echoes.add_bias(plane + self.c3_mm * u * u + self.c4_mm * u * v + self.c5_mm * v * v)


def _made(axis: str, unit_mm: float, x: FloatArray) -> Unnamed:
    return Unnamed(over_range=float(axis == RANGE), **{f"c{k}_mm": float(v) * unit_mm for k, v in enumerate(x)})


def unnamed_laws(sigma_mm: float) -> Iterator[tuple[str, Problem, LinearForm]]:
    """Each axis with its search, in sigma, and its linear form."""
    for axis, size in LAWS:
        problem = Problem(make=partial(_made, axis, sigma_mm), starts=((0.0,) * size,), steps=(0.3,) * size)
        small = (partial(_made, axis, 1.0)(sigma_mm * row) for row in np.eye(size))
        coefficients = tuple(Coefficient(effect=e, size=sigma_mm, spread=_SPREAD_MM) for e in small)
        yield axis, problem, LinearForm(coefficients=coefficients, make=partial(_made, axis, 1.0), surface=axis)
