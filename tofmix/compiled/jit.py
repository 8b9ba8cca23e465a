"""The one JIT decorator, with the reasons for its options.

Compiled code is kept by `kept`, not by numba's own cache. ``nogil=True``: threads run kernels side by side on one
process's memory. ``error_model="numpy"``: a division by zero gives inf or NaN as in NumPy, and the loop vectorises;
kernels never rely on an exception. Kernels that others call are compiled as a part of these (`linking`), with the
versions of numba that this was tested with; others compile each by itself. No ``fastmath``: sums must not depend on how
the compiler reorders them on another machine.
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numba

from tofmix.compiled import linking
from tofmix.compiled.kept import Kept
from tofmix.compiled.processor import config, processor_class

P = ParamSpec("P")
R = TypeVar("R")

LINKS_WITH = (0, 60), (0, 68)
"""Oldest and newest version of numba that compiles callees as a part of their callers."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` in nopython mode with the package's options."""
    if not config.DISABLE_JIT:
        processor_class()  # before the first kernel
    compiled: Callable[P, R] = numba.njit(nogil=True, error_model="numpy")(function)
    _link_into_callers(compiled, borrows=False)
    if hasattr(compiled, "_cache"):  # without the JIT it is the function itself
        compiled._cache = Kept(function, is_linked=_links())  # noqa: SLF001  numba shows it nowhere else
    return compiled


def borrowing(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as `jit` does, without counting references to arrays where other kernels call it.

    For kernels that make no array, return none, and call none that returns one: such an array would never be freed.
    They may take slices and rows of their arguments.
    """
    compiled = jit(function)
    _link_into_callers(compiled, borrows=True)
    return compiled


def _link_into_callers(compiled: Any, *, borrows: bool) -> None:  # noqa: ANN401  a dispatcher, or without the JIT a function
    if hasattr(compiled, "get_call_template") and _links():
        callee = linking.Callee(compiled, borrows=borrows)
        compiled.get_call_template, compiled.get_overload = callee.template, callee.code


def _links() -> bool:
    """Whether this version of numba compiles callees as a part of their callers."""
    return bool(LINKS_WITH[0] <= numba.version_info.short <= LINKS_WITH[1])
