"""Compiled kernels, kept in files: a later run, another user and another machine of the same class compile nothing.

Each compiled signature of a kernel is a file. It lies in a folder named by all that its code depends on: the versions
of Python, numba and tofmix, the source of all kernels, and the class of processors. numba's own cache
checks only the file of a kernel, not those of the kernels that it calls, so that callers would run stale code; and it
ends a run where no folder can be written. None of it is used here.

Base folders, in this order: `NUMBA_CACHE_DIR`; the `__pycache__` beside the package, which other users read (in the
package itself, what an uninstallation leaves could still be imported); the user's cache folder; the temporary folder.
Code is read from each that has it, and written to the first that can be written. A damaged or foreign file counts as
none, and a full disk is no error: a cache is never why a run fails.

The class of processors that kernels are compiled for, so that kept code serves all machines of the class.

numba compiles for the very processor that it runs on, and other machines of a container image or a cluster would
compile again. x86-64-v3 (AVX2 and FMA) is the class of most x86 processors since 2013. A process has one compiler:
where another package has used it before, where `NUMBA_CPU_NAME` is set, and on all other processors, code is for the
machine's own.

References
----------
x86-64 psABI, section 3.1.1, table 3.1: micro-architecture levels.
"""

import hashlib
import os
import pickle
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite  # type: ignore[import-untyped]
import numba
import numba.core.codegen
import numba.core.compiler
import numba.core.registry
import numba.core.runtime
import numba.core.serialize

from tofmix.compiled.watching import watcher
from tofmix.version import __version__

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


PACKAGE = Path(__file__).parents[1]
SUFFIX = ".nbc"

CANNOT_KEEP = (
    "no folder can be written, so compiled kernels are not kept and each run compiles them again; set NUMBA_CACHE_DIR"
    " to a folder that can be written"
)

_KERNEL_FOLDERS = (
    "compiled",
    "estimation",
    "image",
    "mapping",
    "reconciliation",
    "simulation",
    "surfaces",
    "suspicion",
    "unmixing",
)
_KERNEL_FILES = "noise_shape.py", "optics/cells.py"
"""Files of other folders with a kernel, or a constant that kernels use."""
_WITHOUT_KERNELS = ("reading.py", "sequence.py")
"""Modules above the kernels, which no kernel takes a constant from."""

_HEADER = b"tofmix kernel 1\n"
_CHECKSUM = hashlib.sha256


class Kept:
    """The kept code of a kernel, in place of numba's cache of a dispatcher.

    Parameters
    ----------
    function : callable
        The kernel in Python.
    is_linked : bool
        Whether the kernels that it calls are compiled as a part of it.
    """

    def __init__(self, function: Callable[..., Any], *, is_linked: bool) -> None:
        module = function.__module__.removeprefix("tofmix.")
        self.kernel = f"{module}.{function.__qualname__.rpartition('.')[2]}"
        self._code = function.__code__.co_code + bytes([is_linked])

    @property
    def cache_path(self) -> str:
        """Folder of the kept code, for numba's statistics."""
        return str(cache_folder() or "")

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401  numba's own
        """Compiled code for a signature, or None where it is to be compiled.

        To load it none of numba's tables of types are needed, which `target_context.refresh()` fills by importing much
        of numba: they are filled when something is compiled.
        """
        found = self._read(sig, target_context)
        if found is not None:
            return found
        watcher().begins(self.kernel)
        for wait in _elsewhere:
            if wait(self.kernel) and (found := self._read(sig, target_context)) is not None:
                watcher().ends(self.kernel)
                return found
        target_context.refresh()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401  numba's own
        """Keep the compiled code of a signature."""
        watcher().ends(self.kernel)
        if data.lifted or data.library.has_dynamic_globals:
            return  # it holds addresses of this process
        payload = _core.serialize.dumps(data._reduce())  # noqa: SLF001  as numba's cache does
        content = _HEADER + _CHECKSUM(payload).digest() + payload
        for folder in _folders():
            with suppress(OSError):
                _write(folder / self._name(sig), content)
                return
        _say_that_nothing_is_kept()

    def flush(self) -> None:
        """Nothing is held back."""

    def _read(self, sig: Any, context: Any) -> Any:  # noqa: ANN401  numba's own
        for folder in _folders():
            # A fault here is a damaged or foreign file, whatever it makes of its reader.
            with suppress(Exception):
                content = (folder / self._name(sig)).read_bytes()
                head = len(_HEADER) + _CHECKSUM().digest_size
                payload = content[head:]
                if content[:head] == _HEADER + _CHECKSUM(payload).digest():
                    _core.runtime.rtsys.initialize(context)  # arrays are allocated by it
                    return _core.compiler.CompileResult._rebuild(context, *pickle.loads(payload))  # noqa: S301, SLF001
        return None

    def _name(self, sig: Any) -> str:  # noqa: ANN401  numba's own
        return f"{self.kernel}-{hashlib.sha256(str(sig).encode() + self._code).hexdigest()[:16]}{SUFFIX}"


_elsewhere: list[Callable[[str], bool]] = []


def compiled_elsewhere(wait: Callable[[str], bool]) -> None:
    """Ask `wait` before a kernel is compiled: it returns whether another process has compiled the kernel meanwhile."""
    _elsewhere.append(wait)


def is_kept(kernel: str) -> bool:
    """Whether code of the kernel is kept, for some signature."""
    return any(next(folder.glob(f"{kernel}-*{SUFFIX}"), None) is not None for folder in _folders())


def cache_folder() -> Path | None:
    """The folder that compiled kernels are written to; None where no folder can be written."""
    for folder in _folders():
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
    return None


class KeptCode(NamedTuple):
    """A folder of compiled code: how many kernels it has, and its size."""

    folder: Path
    kernels: int
    size_bytes: int


def gather() -> KeptCode | None:
    """Copy the code of all folders that has been read so far to the one that is written; None where there is none."""
    target = cache_folder()
    if target is None:
        return None
    for folder in _folders():
        for file in folder.glob(f"*{SUFFIX}"):
            if not (target / file.name).exists():
                _write(target / file.name, file.read_bytes())
    sizes = [file.stat().st_size for file in target.glob(f"*{SUFFIX}")]
    return KeptCode(target, len(sizes), sum(sizes))


@cache
def sources() -> str:
    """Hash of every source file that may hold a kernel, or a constant that one has compiled in."""
    digest = hashlib.sha256()
    for source in kernel_files():
        digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()[:16]


def kernel_files() -> Iterator[Path]:
    """Source files that may hold a kernel, or a constant that one has compiled in."""
    yield from (PACKAGE / name for name in _KERNEL_FILES)
    for name in _KERNEL_FOLDERS:
        yield from (file for file in sorted((PACKAGE / name).rglob("*.py")) if file.name not in _WITHOUT_KERNELS)


@cache
def _key() -> str:
    """Hash of all that compiled code depends on."""
    config: Any = numba.config
    parts = (
        sys.implementation.cache_tag,
        numba.__version__,
        llvmlite.__version__,
        __version__,
        sources(),
        processor_class(),
        config.USING_SVML,
        config.OPT,
        config.LOOP_VECTORIZE,
        config.SLP_VECTORIZE,
        config.BOUNDSCHECK,
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


@cache
def _folders() -> tuple[Path, ...]:
    """Folders of this key, in the order of their use."""
    return tuple(base / f"tofmix-kernels-{_key()}" for base in _bases())


def _bases() -> list[Path]:
    bases = [PACKAGE.parent / "__pycache__"]
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        bases.insert(0, Path(chosen).absolute())
    if home := os.environ.get("XDG_CACHE_HOME"):
        bases.append(Path(home).absolute())
    else:
        with suppress(RuntimeError):  # a user without a home
            bases.append(Path("~/.cache").expanduser())
    if (temporary := _temporary()) is not None:
        bases.append(temporary)
    return bases


def _temporary() -> Path | None:
    """A folder of this user alone in the temporary folder; None where there is none, or another user may write to it.

    Compiled kernels are run without a check.
    """
    try:
        parent = Path(tempfile.gettempdir())
        named = {os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP")} | {"/tmp", "/var/tmp", "/usr/tmp"}  # noqa: S108  compared
        if str(parent) not in named:
            return None  # Python takes the working folder where there is no other
        folder = parent / f"tofmix-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    is_own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022
    return folder if is_own else None


def _write(path: Path, content: bytes) -> None:
    """Write a file as a whole, or not at all.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        unfinished.write_bytes(content)
        unfinished.replace(path)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink()
        raise


@cache
def _say_that_nothing_is_kept() -> None:
    watcher().cannot_keep(CANNOT_KEEP)
