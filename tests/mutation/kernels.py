"""Give a changed package the compiled kernels of the unchanged one, but those of some modules.

Run in the changed package's own environment: python -m mutation.kernels FROM_CACHE MODULE... A kernel's file is named
by the kernel and its types, and the folder by the sources of all kernels: a copy in the changed package's folder is
found.
"""

import shutil
import sys
from pathlib import Path

from tofmix.compiled.kept import SUFFIX, cache_folder


def main() -> None:
    cache, *modules = sys.argv[1:]
    again = {name.removeprefix("tofmix.") for name in modules}
    origin = max(Path(cache).glob("tofmix-kernels-*"), key=lambda found: sum(1 for _ in found.glob(f"*{SUFFIX}")))
    target = cache_folder()
    assert target is not None, "NUMBA_CACHE_DIR names a folder of the study"
    for file in origin.glob(f"*{SUFFIX}"):
        if file.name.rpartition("-")[0].rpartition(".")[0] not in again:
            shutil.copy(file, target / file.name)


if __name__ == "__main__":
    main()
