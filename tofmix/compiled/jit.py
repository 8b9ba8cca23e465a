"""The one JIT decorator, with the reasons for its options.

Compiled code is kept by `kept`, not by numba's own cache. ``nogil=True``: threads run kernels side by side on one
process's memory. ``error_model="numpy"``: a division by zero gives inf or NaN as in NumPy, and the loop vectorises;
kernels never rely on an exception. Kernels that others call are compiled as a part of these (`Callee`), with the
versions of numba that this was tested with; others compile each by itself. No ``fastmath``: sums must not depend on how
the compiler reorders them on another machine.

Compile a kernel that other kernels call once, as a part of them, and not a second time alone.

numba optimises every function together with all that it calls, makes machine code of
that and two wrappers, and does so again for each caller of the function, up to the
top: most of this is thrown away. Here a callee is translated to LLVM's form and left
so. It is optimised, and becomes machine code, inside the kernel that Python calls. The
first estimate takes 26 s instead of 68, later ones 2.30 instead of 2.43 s, and the
results are the same to the last bit. This reaches
into numba's private parts. So `tofmix.compiled.jit.LINKS_WITH` names the versions of numba that
it was tried with; with any other, kernels are compiled by numba alone.

A kernel that Python calls too, as in a test, is then compiled by itself as usual.

A callee that borrows its arrays does not count references to them: its caller holds
them. Counting, for each slice and row, took up to a third of a pixel's time.
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numba
import numba.core.codegen
import numba.core.compiler
import numba.core.types
import numba.core.typing

from tofmix.compiled.kept import Kept, config, processor_class

core: Any = numba.core  # it has no types


class _Part(core.codegen.JITCodeLibrary):  # type: ignore[misc]
    """A library that is only linked into others: there is nothing to optimise or to load yet."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


def _counted(kind: Any) -> bool:  # noqa: ANN401  a type of numba
    """Whether values of a type are, or hold, anything with a count of references."""
    if isinstance(kind, core.types.BaseTuple):
        return any(_counted(part) for part in kind)
    return not isinstance(kind, core.types.Number | core.types.Boolean | core.types.NoneType)


class Callee:
    """Interface of a kernel for the compiler of its caller: a type for its arguments, and the code to link."""

    def __init__(self, dispatcher: Any, *, borrows: bool) -> None:  # noqa: ANN401  numba's own
        self._borrows = borrows
        self._compiler = dispatcher._compiler  # noqa: SLF001  numba shows it nowhere else
        self._compiled: dict[tuple[Any, ...], Any] = {}
        self._keys: dict[tuple[Any, ...], object] = {}

    def template(self, args: tuple[Any, ...], kws: dict[str, Any]) -> tuple[Any, Any, tuple[Any, ...], dict[str, Any]]:
        """Compile for these types; in place of a dispatcher's `get_call_template`.

        A constant counts as any other number: `grow(samples, 1, ...)` does not compile the callee once more for it.
        """
        general = core.types.unliteral
        pysig, folded = self._compiler.fold_argument_types(
            tuple(general(kind) for kind in args), {name: general(kind) for name, kind in kws.items()}
        )
        self._compile(tuple(folded))
        name = self._compiler.py_func.__name__
        signatures = [result.signature for result in self._compiled.values()]
        template = core.typing.make_concrete_template(f"CallTemplate({name})", key=name, signatures=signatures)
        return template, pysig, folded, {}

    def code(self, args: tuple[Any, ...]) -> object:
        """Name under which the compiler finds the code for these types; in place of `get_overload`."""
        return self._keys[tuple(args)]

    def _compile(self, args: tuple[Any, ...]) -> None:
        # Inside the caller's own compilation, which holds the compiler's lock.
        if args in self._compiled:
            return
        theirs = self._compiler
        description = theirs.targetdescr
        flags, context = core.compiler.Flags(), description.target_context
        description.options.parse_as_flags(flags, theirs.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        if self._borrows:
            flags.nrt = False
        library = _Part(context.codegen(), theirs.py_func.__qualname__)
        result = core.compiler.compile_extra(
            description.typing_context, context, theirs.py_func, args, None, flags, theirs.locals, library
        )
        library.finalize()
        if self._borrows and _counted(result.signature.return_type):
            raise TypeError(f"{library.name} borrows its arrays: it cannot return {result.signature.return_type}")
        self._compiled[args], self._keys[args] = result, object()
        context.insert_user_function(self._keys[args], result.fndesc, [library])


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
        callee = Callee(compiled, borrows=borrows)
        compiled.get_call_template, compiled.get_overload = callee.template, callee.code


def _links() -> bool:
    """Whether this version of numba compiles callees as a part of their callers."""
    return bool(LINKS_WITH[0] <= numba.version_info.short <= LINKS_WITH[1])
