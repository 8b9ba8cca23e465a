"""Bounds of settings, declared beside each field and checked at construction.

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Settings:
        alpha: Share = 0.01
        rounds: Count = 3

        def __post_init__(self) -> None:
            check_bounds(self)

A named tuple, which kernels take, is decorated with `checked` instead.
"""

import math
from dataclasses import dataclass
from functools import cache, wraps
from itertools import pairwise
from numbers import Integral, Real
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from tofmix.errors import UsageError


@dataclass(frozen=True, slots=True)
class Bounds:
    """Least and greatest value of a number; with `inside`, the ends themselves are out of bounds.

    With `infinite`, inf is a value too: a threshold that nothing exceeds.
    """

    low: float
    high: float = math.inf
    inside: bool = False
    infinite: bool = False

    def hold(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        if not math.isfinite(value):
            return self.infinite and value == math.inf
        return self.low < value < self.high if self.inside else self.low <= value <= self.high

    def __str__(self) -> str:
        if self.low == -math.inf:
            return "that is finite"
        if self.high == math.inf:
            least = f"above {self.low:g}" if self.inside else f"of at least {self.low:g}"
            return f"{least}, or inf" if self.infinite else least
        return f"between {self.low:g} and {self.high:g}" if self.inside else f"from {self.low:g} to {self.high:g}"


Count = Annotated[int, Bounds(1)]
AtLeastTwo = Annotated[int, Bounds(2)]
WholeNumber = Annotated[int, Bounds(0)]
Positive = Annotated[float, Bounds(0.0, inside=True)]
NotNegative = Annotated[float, Bounds(0.0)]
Factor = Annotated[float, Bounds(1.0)]
RatioAbove1 = Annotated[float, Bounds(1.0, inside=True)]
Threshold = Annotated[float, Bounds(0.0, infinite=True)]
PositiveThreshold = Annotated[float, Bounds(0.0, inside=True, infinite=True)]
FactorThreshold = Annotated[float, Bounds(1.0, infinite=True)]
Share = Annotated[float, Bounds(0.0, 1.0)]
Finite = Annotated[float, Bounds(-math.inf)]


@dataclass(frozen=True, slots=True)
class Declared:
    """What is declared for a field.

    Parameters
    ----------
    kind : type
        Type of the value, or of each of a tuple's.
    bounds : Bounds or None
        Bounds of numbers.
    is_tuple : bool
        Whether it is a tuple of such values.
    length : int or None
        Length of the tuple; None if it may have any.
    """

    kind: type
    bounds: Bounds | None
    is_tuple: bool
    length: int | None


@cache
def declared(settings: type) -> dict[str, Declared]:
    """What is declared for each field of a class of settings."""
    found: dict[str, Declared] = {}
    for name, hint in get_type_hints(settings, include_extras=True).items():
        is_tuple = get_origin(hint) is tuple
        parts = get_args(hint)
        part = parts[0] if is_tuple else hint
        length = len(parts) if is_tuple and parts[-1] is not Ellipsis else None
        if get_origin(part) is Annotated:
            kind, bounds = get_args(part)
            found[name] = Declared(kind, bounds, is_tuple, length)
        elif isinstance(part, type):
            found[name] = Declared(part, None, is_tuple, length)
    return found


def check_bounds(settings: Any) -> None:  # noqa: ANN401  of any class
    """Refuse settings with a value out of its bounds.

    Raises
    ------
    UsageError
        If a field has another type or length than declared, or a number that is NaN or out of bounds.
    """
    made_by: Any = type(settings)
    for name, field in declared(made_by).items():
        value, kind = getattr(settings, name), field.kind
        if field.is_tuple and not isinstance(value, tuple):
            raise _refusal(settings, name, "give a tuple")
        if field.length is not None and len(value) != field.length:
            raise _refusal(settings, name, f"give {field.length} values")
        for part in value if field.is_tuple else (value,):
            if field.bounds is None:
                if not isinstance(part, kind):
                    raise _refusal(settings, name, f"give {'a text' if kind is str else f'values of {kind.__name__}'}")
            elif not _is_number(part, kind) or not field.bounds.hold(part):
                number = "whole number" if kind is int else "number"
                several = "numbers" if field.is_tuple else f"a {number}"
                raise _refusal(settings, name, f"give {several} {field.bounds}")


def check_ascending(settings: Any, *names: str) -> None:  # noqa: ANN401  of any class
    """Refuse tuples, the fields `names`, whose values do not ascend.

    Raises
    ------
    UsageError
        If a value is not above the one before it.
    """
    for name in names:
        values = getattr(settings, name)
        if any(not low < high for low, high in pairwise(values)):
            raise _refusal(settings, name, "give ascending values")


def _is_number(value: object, kind: type) -> bool:
    return isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)


def _refusal(settings: Any, name: str, remedy: str) -> UsageError:  # noqa: ANN401  of any class
    return UsageError(f"{type(settings).__name__}: {name} is {getattr(settings, name)!r}; {remedy}")


T = TypeVar("T", bound=tuple[Any, ...])


def checked(settings: type[T]) -> type[T]:
    """Check the bounds of a named tuple where one is made, also by `_replace`; a decorator."""
    make = settings.__new__

    @wraps(make)  # so that the signature shows the fields
    def new(cls: type[T], *args: Any, **kwargs: Any) -> T:  # noqa: ANN401  those of the tuple
        made = make(cls, *args, **kwargs)
        check_bounds(made)
        return made

    named: Any = settings
    named.__new__ = new
    named._make = classmethod(lambda cls, values: cls(*values))  # `_replace` calls it
    return settings
