"""A parameter of an effect, declared once: unit, bounds, default and a sentence.

The parser, the error messages, the tables of docs/reference/effects.md, ``--explain`` and the fits use this
declaration.
"""

import math
from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, field, fields
from enum import Enum
from typing import Any

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.simulation.effects.prior import Prior

_METADATA = "tofmix"


class Holds(Enum):
    """Type of a parameter's value."""

    NUMBER = "number"
    SURFACE = "name of a surface"
    MAP = "map"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter of an effect.

    Parameters
    ----------
    name : str
        Key in the model file, ending in the unit.
    unit : str
        Unit as in the formats: ``mm``, ``rad``, ``s``, ``1``; empty for a name.
    sentence : str
        Description in one sentence.
    low, high : float
        Bounds of a number; infinite without a bound.
    low_open, high_open : bool
        Whether the bound itself is refused.
    default : float or None
        Value if the key is left out; None without a default.
    required : bool
        Whether the key must be given.
    zero : float or None
        Value at which the effect vanishes for all other parameters; None without such a value.
    typical : (float, float)
        Magnitudes of real cameras, the start of a search. NaN for none.
    prior : Prior or None
        Density of the magnitudes of real cameras; None for a number of any magnitude.
    holds : Holds
        A number, a surface's name, or a map.
    """

    name: str
    unit: str
    sentence: str
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False
    default: float | None = None
    required: bool = True
    zero: float | None = None
    typical: tuple[float, float] = (math.nan, math.nan)
    prior: Prior | None = None
    holds: Holds = Holds.NUMBER

    @property
    def bounds(self) -> str:
        """The interval in which it must lie, such as ``(0, 1000]``; empty if it is not a number."""
        if self.holds is not Holds.NUMBER:
            return ""
        left = "(" if self.low_open or math.isinf(self.low) else "["
        right = ")" if self.high_open or math.isinf(self.high) else "]"
        return f"{left}{_shown(self.low)}, {_shown(self.high)}{right}"

    def refusal(self, value: object) -> str:
        """Why `value` is refused, beginning with the key; empty if it is not."""
        if self.holds is not Holds.NUMBER or (value is None and not self.required):
            return ""
        if not isinstance(value, int | float) or not math.isfinite(value):
            return f"{self.name}: {value} is not a finite number"
        below = value <= self.low if self.low_open else value < self.low
        above = value >= self.high if self.high_open else value > self.high
        return f"{self.name}: {value:g} is not in {self.bounds}" if below or above else ""


def _shown(value: float) -> str:
    return f"{value:g}" if math.isfinite(value) else ("-inf" if value < 0 else "inf")


@dataclass(frozen=True, slots=True, eq=False)
class PixelMap:
    """A map with a value for each pixel.

    Parameters
    ----------
    path : str
        Path of the file, as in the model; empty for a map without a file.
    values : (row, col) float32
        Values, mm. The effect defines the meaning of NaN.
    """

    path: str
    values: Float32Array

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float32, copy=True)
        values.setflags(write=False)
        object.__setattr__(self, "values", values)


def number(
    sentence: str,
    *,
    unit: str,
    low: float = -math.inf,
    high: float = math.inf,
    low_open: bool = False,
    high_open: bool = False,
    default: float | None = None,
    required: bool = True,
    zero: float | None = None,
    typical: tuple[float, float] = (math.nan, math.nan),
    prior: Prior | None = None,
) -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field that holds a number; see `Parameter`. One with a default is not required."""
    required = required and default is None
    declared = {
        "sentence": sentence,
        "unit": unit,
        "low": low,
        "high": high,
        "low_open": low_open,
        "high_open": high_open,
        "default": default,
        "required": required,
        "zero": zero,
        "typical": typical,
        "prior": prior,
    }
    return field(default=MISSING if required else default, metadata={_METADATA: declared})


def surface(sentence: str) -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field that holds the name of one of the model's surfaces."""
    return field(metadata={_METADATA: {"sentence": sentence, "unit": "", "holds": Holds.SURFACE}})


def pixel_map(sentence: str) -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field that holds a `PixelMap`, mm, or None."""
    declared = {"sentence": sentence, "unit": "mm", "holds": Holds.MAP, "required": False}
    return field(default=None, compare=False, metadata={_METADATA: declared})


def declared_parameters(kind: type) -> Iterator[Parameter]:
    """The parameters of an effect's class, in the order of their declaration."""
    item: Field[Any]
    for item in fields(kind):
        yield Parameter(name=item.name, **item.metadata[_METADATA])
