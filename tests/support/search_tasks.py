"""The task of a search, as tests make it."""

from collections.abc import Callable
from typing import TypeAlias

from tofmix.reconciliation.one.recordings import SearchTask

MakeTask: TypeAlias = Callable[..., SearchTask]
"""What the fixture `make_task` of tests/reconciliation/one returns."""
