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
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from numbers import Integral, Real
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from tofmix.errors import UsageError


@dataclass(frozen=True, slots=True)
class Bounds:
    """Least and greatest value of a number; with `inside`, the ends themselves are out of bounds."""

    low: float
    high: float = math.inf
    inside: bool = False

    def hold(self, value: float) -> bool:
        """Whether a finite number is within the bounds."""
        if not math.isfinite(value):
            return False
        return self.low < value < self.high if self.inside else self.low <= value <= self.high

    def __str__(self) -> str:
        if self.low == -math.inf:
            return "that is finite"
        if self.high == math.inf:
            return f"above {self.low:g}" if self.inside else f"of at least {self.low:g}"
        return f"between {self.low:g} and {self.high:g}" if self.inside else f"from {self.low:g} to {self.high:g}"


Count = Annotated[int, Bounds(1)]
AtLeastTwo = Annotated[int, Bounds(2)]
WholeNumber = Annotated[int, Bounds(0)]
Positive = Annotated[float, Bounds(0.0, inside=True)]
NotNegative = Annotated[float, Bounds(0.0)]
Factor = Annotated[float, Bounds(1.0)]
RatioAbove1 = Annotated[float, Bounds(1.0, inside=True)]
Share = Annotated[float, Bounds(0.0, 1.0)]
Probability = Annotated[float, Bounds(0.0, 1.0, inside=True)]
Finite = Annotated[float, Bounds(-math.inf)]


@cache
def declared(settings: type) -> dict[str, tuple[type, Bounds | None, bool]]:
    """Type, bounds and whether it is a tuple of such values, by the field of a class of settings."""
    found: dict[str, tuple[type, Bounds | None, bool]] = {}
    for name, hint in get_type_hints(settings, include_extras=True).items():
        several = get_origin(hint) is tuple
        part = get_args(hint)[0] if several else hint
        if get_origin(part) is Annotated:
            kind, bounds = get_args(part)
            found[name] = kind, bounds, several
        elif isinstance(part, type):
            found[name] = part, None, several
    return found


def check_bounds(settings: Any) -> None:  # noqa: ANN401  of any class
    """Refuse settings with a value out of its bounds.

    Raises
    ------
    UsageError
        If a field has another type than declared, or a number that is not finite or out of bounds.
    """
    made_by: Any = type(settings)
    for name, (kind, bounds, several) in declared(made_by).items():
        value = getattr(settings, name)
        if several and not isinstance(value, tuple):
            raise _refusal(settings, name, "give a tuple")
        for part in value if several else (value,):
            if bounds is None:
                if not isinstance(part, kind):
                    raise _refusal(settings, name, f"give {'a text' if kind is str else f'values of {kind.__name__}'}")
            elif not _is_number(part, kind) or not bounds.hold(part):
                number = "whole number" if kind is int else "number"
                raise _refusal(settings, name, f"give {'numbers' if several else f'a {number}'} {bounds}")


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


def check_one_of(settings: Any, name: str, known: Iterable[str]) -> None:  # noqa: ANN401  of any class
    """Refuse a text, the field `name`, that is not among the known ones.

    Raises
    ------
    UsageError
        If it is none of them.
    """
    texts = tuple(known)
    if getattr(settings, name) not in texts:
        raise _refusal(settings, name, f"give one of {', '.join(texts)}")


def _is_number(value: object, kind: type) -> bool:
    return isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)


def _refusal(settings: Any, name: str, remedy: str) -> UsageError:  # noqa: ANN401  of any class
    return UsageError(f"{type(settings).__name__}: {name} is {getattr(settings, name)!r}; {remedy}")


T = TypeVar("T", bound=tuple[Any, ...])


def checked(settings: type[T]) -> type[T]:
    """Check the bounds of a named tuple where one is made, also by `_replace`; a decorator."""
    make = settings.__new__

    def new(cls: type[T], *args: Any, **kwargs: Any) -> T:  # noqa: ANN401  those of the tuple
        made = make(cls, *args, **kwargs)
        check_bounds(made)
        return made

    named: Any = settings
    named.__new__ = new
    named._make = classmethod(lambda cls, values: cls(*values))  # `_replace` calls it
    return settings
