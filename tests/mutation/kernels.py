"""Give a changed package the compiled kernels of the unchanged one that the change does not concern.

Run in the changed package's own environment: python -m mutation.kernels FROM_CACHE FROM_CHECKOUT CHANGED_FILE KERNEL...
(`KERNEL` as folder/module.name, those to compile again). numba finds a kernel by the path and the content of its file,
`tofmix.compiled.jit` by the content of all; a copy for another path and content has other names and another stamp.
"""

import io
import pickle
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba.core.caching
import numba.core.serialize

import tofmix
from tofmix.compiled.jit import cache_folder

_LOCATOR: Any = numba.core.caching.UserProvidedCacheLocator  # numba has no types for either
_PICKLING: Any = numba.core.serialize


def main() -> None:
    """Copy, and stamp the index of each kernel of the changed file anew."""
    cache, checkout, changed, *concerned = sys.argv[1:]
    here, there = Path(tofmix.__file__).parents[1], Path(checkout)
    origin = max(Path(cache).glob("tofmix-kernels-*"), key=lambda found: sum(1 for _ in found.rglob("*.nbc")))
    for folder in [here / "tofmix", *(path for path in (here / "tofmix").rglob("*") if path.is_dir())]:
        inner = folder.relative_to(here)
        kept = origin / _name(there / inner)
        if not kept.exists():
            continue
        target = cache_folder() / _name(folder)
        target.mkdir(parents=True, exist_ok=True)
        for file in kept.iterdir():
            kernel = (inner / file.name.rpartition("-")[0]).as_posix()
            if kernel in concerned:
                continue
            if (here / inner / f"{file.name.split('.')[0]}.py") == here / changed and file.suffix == ".nbi":
                (target / file.name).write_bytes(_stamped(file.read_bytes(), here / changed))
            else:
                shutil.copy(file, target / file.name)


def _name(folder: Path) -> str:
    return str(_LOCATOR.get_suitable_cache_subpath(str(folder / "module.py")))


def _stamped(index: bytes, source: Path) -> bytes:
    """The index with the stamp of the changed file."""
    stream = io.BytesIO(index)
    version = pickle.load(stream)  # noqa: S301  numba's own file, made by this study
    _, overloads = pickle.load(stream)  # noqa: S301  likewise
    stamp = _LOCATOR.get_source_stamp(SimpleNamespace(_py_file=str(source)))
    return pickle.dumps(version, protocol=-1) + bytes(_PICKLING.dumps((stamp, overloads)))


if __name__ == "__main__":
    main()
