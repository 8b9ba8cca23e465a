"""What the fixture `tofmix` of tests/cli returns."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class Outcome:
    """Exit code and streams of one call."""

    code: int
    out: str
    err: str


Tofmix: TypeAlias = Callable[..., Outcome]
