"""A separate program that reads a .mat up to version 7: SciPy's reader can crash on a damaged one.

``python mat_child.py FILE FOLDER`` prints the arrays and their shapes as one line of JSON, reads a line with the names
of those that are wanted, and stores them as FOLDER/0.npy and so on. `tofmix.io.importers.matlab` starts it; nothing
imports it.
"""

import json
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat

_MEMORY_BYTES = 6 << 30
"""Memory that one file may take, bytes: its arrays are read whole."""


def main() -> None:
    """List and unpack; a failure is one line on stderr and exit code 1."""
    path, folder = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    seconds = 600  # limit of computing time, if no parent process is left to end this one
    for what, limit in ((resource.RLIMIT_AS, _MEMORY_BYTES), (resource.RLIMIT_CPU, seconds)):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
    try:
        sys.stdout.write(json.dumps({name: (shape, kind) for name, shape, kind in whosmat(path)}) + "\n")
        sys.stdout.flush()
        names = json.loads(sys.stdin.readline() or "[]")
        held = loadmat(path, variable_names=names) if names else {}
        for number, name in enumerate(names):
            if not isinstance(held.get(name), np.ndarray):
                sys.exit(f"{name}: not a full array of numbers")
            _save(Path(folder) / f"{number}.npy", held[name])
    except MemoryError:
        sys.exit(f"its arrays take more than {_MEMORY_BYTES >> 30} GB")
    except Exception as error:  # noqa: BLE001  a damaged file can raise any error
        sys.exit(" ".join(str(error).split()) or type(error).__name__)


def _save(path: Path, values: "np.ndarray[Any, Any]") -> None:
    """Store an array; a full disk has a separate exit code."""
    try:
        np.save(path, values, allow_pickle=False)
    except OSError as error:
        sys.stderr.write(f"{error.strerror or error}\n")
        # Exit code of a full disk, as in `tofmix.errors.ExitCode`: this process imports no more than it needs.
        storage = 4
        sys.exit(storage)


if __name__ == "__main__":
    main()
