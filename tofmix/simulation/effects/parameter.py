"""A parameter of an effect, declared once: unit, bounds, default, a sentence, and the prior of its size.

A parameter of an effect, declared once: unit, bounds, default and a sentence.

The parser, the error messages, the tables of docs/reference/effects.md, ``--explain`` and the fits use this
declaration.

Prior densities of the numbers of effects: the magnitudes that real cameras and scenes have.

Each effect declares them in its own file, beside the sentence (`Effect.typical`) and the source (`Effect.basis`) of
these magnitudes. `simulate` ignores them. `reconcile` adds their log density to the log-likelihood of its fits, takes
the scale of linear coefficients from them, and names no effect with a number that lies beyond `FARTHEST` standard
deviations.

References
----------
Gelman, Carlin, Stern, Dunson, Vehtari and Rubin, Bayesian Data Analysis, 3rd ed. 2013, section 2.9: weakly informative
priors.
"""

import math
from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, field, fields
from enum import Enum
from typing import Any

import numpy as np
from scipy.special import log_ndtr, ndtri_exp, stdtr, stdtrit

from tofmix.arrays import Float32Array

FARTHEST = 3.0
"""Normal deviate of the largest magnitude that real cameras have: 1 of 370 draws of the prior lies beyond it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StudentPrior:
    """Student's t density of a number or of its logarithm; a Gaussian for infinite degrees of freedom.

    Use few degrees of freedom for magnitudes that people set, such as the place of a board, and none for magnitudes
    that physics limits.

    Parameters
    ----------
    scale : float
        Scale, in the unit of the number, or of its natural logarithm.
    center : float
        Centre in the same unit.
    dof : float
        Degrees of freedom.
    log : bool
        Whether it is the density of the logarithm.
    half : bool
        Whether the number is never below the centre.
    """

    scale: float
    center: float = 0.0
    dof: float = math.inf
    log: bool = False
    half: bool = False

    def log_density(self, value: float) -> float:
        """Log density of a value, per unit of the number; minus infinity where it cannot be."""
        if self.log and value <= 0:
            return -math.inf
        away = self._away(value)
        if self.half and away < 0:
            return -math.inf
        jacobian = math.log(value) if self.log else 0.0
        return self._log_standard(away) - math.log(self.scale) - jacobian + (math.log(2) if self.half else 0.0)

    def deviate(self, value: float) -> float:
        """Normal deviate of a value: a Gaussian number is as rarely beyond it as the number is beyond the value."""
        if self.log and value <= 0:
            return math.inf
        if self.half and self._away(value) < 0:
            return math.inf
        away = abs(self._away(value))
        if math.isinf(self.dof):
            return away
        below = float(stdtr(self.dof, -away))
        return float(-ndtri_exp(math.log(below))) if below > 0 else math.inf

    def tail_width(self, value: float) -> float:
        """Standard deviation of the Gaussian whose mean falls by as much at a value; 0 for a Gaussian.

        A t density is a mixture of Gaussians of unknown variance: this is the square root of the most likely variance
        in the weights of Lange, Little and Taylor, J. American Statistical Association 84 (1989) 881.
        """
        if math.isinf(self.dof):
            return 0.0
        return self.scale * math.sqrt((self.dof + self._away(value) ** 2) / (self.dof + 1))

    @property
    def spread(self) -> float:
        """Standard deviation of the Gaussian that stands for it in linear fits, of the logarithm if `log`."""
        return self.scale

    @property
    def mode(self) -> float:
        """The most likely value; of the logarithm, if `log` is set."""
        return math.exp(self.center) if self.log else self.center

    @property
    def farthest(self) -> tuple[float, float]:
        """The smallest and the largest value that is not beyond `FARTHEST`."""
        reach = self.scale * self._quantile()
        low, high = self.center - (0.0 if self.half else reach), self.center + reach
        return (math.exp(low), math.exp(high)) if self.log else (low, high)

    def words(self, unit: str) -> str:
        """The density in words, with the interval of possible magnitudes."""
        family = "normal" if math.isinf(self.dof) else f"Student's t of {self.dof:g} degrees of freedom"
        of = "its logarithm is " if self.log else ""
        unit_word = "" if unit in ("", "1") else f" {unit}"
        middle = math.exp(self.center) if self.log else self.center
        center = "" if self.half and not self.center else f" about {'log ' if self.log else ''}{middle:.4g}"
        half = ", positive half" if self.half else ""
        low, high = self.farthest
        interval = f"{low:.3g} to {high:.3g}{unit_word}"
        return f"{of}{family}{center} with scale {self.scale:.3g}{'' if self.log else unit_word}{half} ({interval})"

    def _away(self, value: float) -> float:
        return ((math.log(value) if self.log else value) - self.center) / self.scale

    def _log_standard(self, x: float) -> float:
        if math.isinf(self.dof):
            return -0.5 * x * x - 0.5 * math.log(2 * math.pi)
        n = self.dof
        norm = math.lgamma((n + 1) / 2) - math.lgamma(n / 2) - 0.5 * math.log(n * math.pi)
        return norm - (n + 1) / 2 * math.log1p(x * x / n)

    def _quantile(self) -> float:
        """The value of `FARTHEST`, in scales."""
        if math.isinf(self.dof):
            return FARTHEST
        return float(-stdtrit(self.dof, math.exp(log_ndtr(-FARTHEST))))


@dataclass(frozen=True, slots=True, kw_only=True)
class UniformPrior:
    """A number, or its logarithm, that is anywhere between two limits.

    Parameters
    ----------
    low, high : float
        Limits, in the unit of the number.
    log : bool
        Whether the logarithm is uniform.
    """

    low: float
    high: float
    log: bool = False

    def log_density(self, value: float) -> float:
        """Log density of a value, per unit of the number; minus infinity outside the limits."""
        if not self.low <= value <= self.high:
            return -math.inf
        if self.log:
            return -math.log(math.log(self.high / self.low)) - math.log(value)
        return -math.log(self.high - self.low)

    def deviate(self, value: float) -> float:
        """0 within the limits, else infinite."""
        return 0.0 if self.low <= value <= self.high else math.inf

    @property
    def spread(self) -> float:
        """Standard deviation of the Gaussian that stands for it in linear fits: half of the largest magnitude."""
        return 0.5 * (math.log(self.high) if self.log else self.high)

    @property
    def mode(self) -> float:
        """A most likely value: the middle of the interval."""
        return math.sqrt(self.low * self.high) if self.log else 0.5 * (self.low + self.high)

    @property
    def farthest(self) -> tuple[float, float]:
        """The limits."""
        return self.low, self.high

    def words(self, unit: str) -> str:
        """The density in words."""
        unit_word = "" if unit in ("", "1") else f" {unit}"
        of = "its logarithm is " if self.log else ""
        return f"{of}uniform ({self.low:.3g} to {self.high:.3g}{unit_word})"


Prior = StudentPrior | UniformPrior
"""The density of a number of an effect before a recording is seen."""


def about(median: float, factor: float) -> StudentPrior:
    """Lognormal: two thirds of all magnitudes are within this factor of the median.

    Raises
    ------
    ValueError
        If the median is not positive or the factor is not above 1.
    """
    if median <= 0 or factor <= 1:
        raise ValueError(
            f"a lognormal prior needs a median above 0 and a factor above 1, not {median:g} and {factor:g}"
        )
    return StudentPrior(center=math.log(median), scale=math.log(factor), log=True)


_METADATA = "tofmix"

MOST_SINES = 2
"""Most sines in a list: with more, a sine of range describes any bias."""

_SINE = ((1.0, 64.0), (0.0, 1000.0), (-2 * math.pi, 2 * math.pi))
"""Bounds of its periods a turn, its amplitude, mm, and its phase, rad."""


class Holds(Enum):
    """Type of a parameter's value."""

    NUMBER = "number"
    SURFACE = "name of a surface"
    MAP = "map"
    SINES = "list of [periods a turn, mm, rad]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One parameter of an effect.

    Parameters
    ----------
    name : str
        Name of the field; the key in the model file, ending in the unit, but for an underscore after a word of Python.
    unit : str
        Unit as in the formats: ``mm``, ``rad``, ``s``, ``1``; empty for a name.
    sentence : str
        Description in one sentence.
    low, high : float
        Bounds of a number; infinite without a bound.
    low_open, high_open : bool
        Whether the bound itself is refused.
    default : float, str or None
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
    default: float | str | None = None
    required: bool = True
    zero: float | None = None
    typical: tuple[float, float] = (math.nan, math.nan)
    prior: Prior | None = None
    holds: Holds = Holds.NUMBER

    @property
    def key(self) -> str:
        """Key in a model file: its name, without the underscore that a word of Python has."""
        return self.name.removesuffix("_")

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
        if self.holds is Holds.SINES:
            return _refusal_of_sines(self.name, value)
        if self.holds is not Holds.NUMBER or (value is None and not self.required):
            return ""
        if not isinstance(value, int | float) or not math.isfinite(value):
            return f"{self.name}: {value} is not a finite number"
        below = value <= self.low if self.low_open else value < self.low
        above = value >= self.high if self.high_open else value > self.high
        return f"{self.name}: {value:g} is not in {self.bounds}" if below or above else ""


def _refusal_of_sines(name: str, value: object) -> str:
    """Why a list of sines is refused, beginning with the key; empty if it is not."""
    if not isinstance(value, tuple) or len(value) > MOST_SINES:
        return f"{name}: expected at most {MOST_SINES} lists of three numbers"
    for sine in value:
        if len(sine) != len(_SINE) or not all(math.isfinite(number) for number in sine):
            return f"{name}: expected lists of three finite numbers, got {list(sine)}"
        for unit, number, (low, high) in zip(("periods a turn", "mm", "rad"), sine, _SINE, strict=True):
            if not low <= number <= high:
                return f"{name}: {number:g} {unit} is not in [{low:g}, {high:g}]"
    periods = [sine[0] for sine in value]
    return f"{name}: {max(periods, key=periods.count):g} periods twice" if len(set(periods)) < len(periods) else ""


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
        Values, in the unit of its parameter. The effect defines the meaning of NaN.
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


def surface(sentence: str, *, required: bool = True) -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field that holds the name of one of the model's surfaces; empty for all, where it may be left out."""
    default = None if required else ""
    declared = {"sentence": sentence, "unit": "", "holds": Holds.SURFACE, "required": required, "default": default}
    return field(default=MISSING if required else default, metadata={_METADATA: declared})


def pixel_map(sentence: str, *, unit: str = "mm") -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field that holds a `PixelMap`, or None."""
    declared = {"sentence": sentence, "unit": unit, "holds": Holds.MAP, "required": False}
    return field(default=None, compare=False, metadata={_METADATA: declared})


def sines(sentence: str) -> Any:  # noqa: ANN401  as dataclasses.field
    """A dataclass field that holds a tuple of sines of range: periods a turn, mm, rad; empty if it is left out."""
    declared = {"sentence": sentence, "unit": "", "holds": Holds.SINES, "required": False}
    return field(default=(), metadata={_METADATA: declared})


def declared_parameters(kind: type) -> Iterator[Parameter]:
    """The parameters of an effect's class, in the order of their declaration."""
    item: Field[Any]
    for item in fields(kind):
        yield Parameter(name=item.name, **item.metadata[_METADATA])
