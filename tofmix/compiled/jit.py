"""The one JIT decorator, with the reasons for its options.

``cache=True``: a second run compiles nothing. numba checks only the file of a cached function, not those of the
functions that it calls. So after a change to one kernel its callers would still run the old one. The cache folder
therefore carries a fingerprint of all kernel sources. It lies in the package folder, or where that is not writable in
the user's cache folder, or else in the temporary folder; ``NUMBA_CACHE_DIR`` overrides all three. ``nogil=True``:
threads run kernels side by side on one process's memory. ``error_model="numpy"``: a division by zero gives inf or NaN
as in NumPy, and the loop vectorises; kernels never rely on an exception. Kernels that others call are compiled as a
part of these (`linking`), with the versions of numba that this was tested with; others compile each by itself. No
``fastmath``: sums must not depend on how the compiler reorders them on another machine.
"""

import hashlib
import os
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba

from tofmix.compiled import linking

P = ParamSpec("P")
R = TypeVar("R")

LINKS_WITH = (0, 60), (0, 68)
"""Oldest and newest version of numba that compiles callees as a part of their callers."""

config: Any = numba.config  # its settings are made at run time, unknown to a type checker
_PACKAGE = Path(__file__).parents[1]
_KERNEL_FOLDERS = ("compiled", "estimation", "mapping", "reconciliation", "simulation", "surfaces", "unmixing")
_KERNEL_FILES = "learnt_noise.py", "optics/cells.py"
"""Files of other folders with a kernel, or a constant that kernels use."""
_WITHOUT_KERNELS = ("reading.py", "sequence.py")
"""Modules above the kernels, which no kernel takes a constant from."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` in nopython mode with the package's options."""
    theirs = config.CACHE_DIR  # numba reads it while it decorates; other packages keep their own
    config.CACHE_DIR = str(cache_folder())
    try:
        compiled: Callable[P, R] = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    finally:
        config.CACHE_DIR = theirs
    _link_into_callers(compiled, borrows=False)
    _bear_faults_of_the_cache(compiled)
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
    if hasattr(compiled, "get_call_template") and LINKS_WITH[0] <= numba.version_info.short <= LINKS_WITH[1]:
        callee = linking.Callee(compiled, borrows=borrows)
        compiled.get_call_template, compiled.get_overload = callee.template, callee.code


def _bear_faults_of_the_cache(compiled: Any) -> None:  # noqa: ANN401  likewise
    """Compile again where the cache is damaged, and go on where the disk is full: a cache is never why a run fails."""
    kept = getattr(compiled, "_cache", None)
    if kept is None:
        return
    load, save = kept.load_overload, kept.save_overload

    def load_if_whole(*args: Any) -> Any:  # noqa: ANN401  numba's own
        try:
            return load(*args)
        except Exception:  # noqa: BLE001  whatever a damaged file makes of its reader
            return None

    def save_if_possible(*args: Any) -> None:  # noqa: ANN401  numba's own
        try:
            save(*args)
        except OSError:
            return
        except Exception:  # noqa: BLE001  its index is damaged
            with suppress(OSError):
                kept.flush()
                save(*args)

    kept.load_overload, kept.save_overload = load_if_whole, save_if_possible


@cache
def cache_folder() -> Path:
    """Folder in which compiled kernels are kept."""
    return _base_folder() / f"tofmix-kernels-{_fingerprint()}"


def _base_folder() -> Path:
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen)
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    for folder in (_PACKAGE / "__pycache__", home):
        if _writable(folder):
            return folder
    return _private_folder(Path(tempfile.gettempdir()) / f"tofmix-{os.getuid()}")


def _private_folder(folder: Path) -> Path:
    """Make `folder` for this user alone; if another user owns it, make a new one.

    Compiled kernels are run without a check, so no other user may write to their folder.
    """
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022:
        return folder
    return Path(tempfile.mkdtemp(prefix="tofmix-"))


def _writable(folder: Path) -> bool:
    """Whether a file can be made in `folder`: permissions alone do not show it, especially for root."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _fingerprint() -> str:
    """Hash of every source file that may hold a kernel, or a constant that one has compiled in."""
    digest = hashlib.sha256(b"".join((_PACKAGE / name).read_bytes() for name in _KERNEL_FILES))
    for name in _KERNEL_FOLDERS:
        for source in sorted((_PACKAGE / name).rglob("*.py")):
            if source.name in _WITHOUT_KERNELS:
                continue
            digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()[:16]
