"""What the fixture `record` of tests/reconcile returns."""

from collections.abc import Callable
from typing import TypeAlias

from tofmix.reconcile.evidence import Evidence

Record: TypeAlias = Callable[..., Evidence]
