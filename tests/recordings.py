"""What the fixture `record` of tests/reconciliation returns, and how tests make effects."""

from collections.abc import Callable, Mapping
from typing import TypeAlias

from tofmix.reconciliation.evidence import Evidence
from tofmix.simulation.effects import EFFECTS, Effect

Record: TypeAlias = Callable[..., Evidence]
MAKE: Mapping[str, Callable[..., Effect]] = EFFECTS
