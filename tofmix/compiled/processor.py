"""The class of processors that kernels are compiled for, so that kept code serves all machines of the class.

numba compiles for the very processor that it runs on, and other machines of a container image or a cluster would
compile again. x86-64-v3 (AVX2 and FMA) is the class of most x86 processors since 2013. A process has one compiler:
where another package has used it before, where `NUMBA_CPU_NAME` is set, and on all other processors, code is for the
machine's own.

References
----------
x86-64 psABI, section 3.1.1, table 3.1: micro-architecture levels.
"""

from functools import cache
from typing import Any

import numba
import numba.core.codegen
import numba.core.registry

V3 = "x86-64-v3"
_OF_V3 = (
    "avx",
    "avx2",
    "bmi",
    "bmi2",
    "cx16",
    "f16c",
    "fma",
    "lzcnt",
    "movbe",
    "popcnt",
    "sahf",
    "sse3",
    "sse4.1",
    "sse4.2",
    "ssse3",
    "xsave",
)

config: Any = numba.config  # its settings are made at run time, unknown to a type checker
_core: Any = numba.core  # it has no types
_binding: Any = _core.codegen.ll  # llvmlite's


@cache
def processor_class() -> str:
    """Set the process's compiler up, unless another package has; return what it compiles for."""
    cpu = _core.registry.cpu_target
    named = config.CPU_NAME is None and config.CPU_FEATURES is None
    if "_toplevel_target_context" in cpu.__dict__ or not named or not _is_v3():
        codegen = cpu.target_context.codegen()
        return ":".join(codegen.magic_tuple())
    config.CPU_NAME, config.CPU_FEATURES = V3, ""
    try:
        codegen = cpu.target_context.codegen()
    finally:
        config.CPU_NAME = config.CPU_FEATURES = None
    codegen._tm_features = _core.codegen.get_host_cpu_features()  # noqa: SLF001  other packages' caches go by these
    return V3


def _is_v3() -> bool:
    """Whether this machine runs code of the class, and numba may use all of it."""
    if not _binding.get_process_triple().startswith("x86_64") or not config.ENABLE_AVX:
        return False
    try:
        features = _binding.get_host_cpu_features()
    except RuntimeError:
        return False
    return all(features.get(name, False) for name in _OF_V3)
