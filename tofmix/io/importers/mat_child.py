"""A program of its own that reads a .mat up to version 7: SciPy's reader can crash on a damaged one.

``python mat_child.py FILE FOLDER`` prints the arrays and their shapes as one line of JSON, reads a line with the names
of those that are wanted, and stores them as FOLDER/0.npy and so on. `tofmix.io.importers.matlab` starts it; nothing
imports it.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat, whosmat


def main() -> None:
    """List and unpack; a failure is one line on stderr and exit code 1."""
    path, folder = sys.argv[1:]
    try:
        sys.stdout.write(json.dumps({name: shape for name, shape, _ in whosmat(path)}) + "\n")
        sys.stdout.flush()
        names = json.loads(sys.stdin.readline() or "[]")
        held = loadmat(path, variable_names=names) if names else {}
        for number, name in enumerate(names):
            if not isinstance(held.get(name), np.ndarray):
                sys.exit(f"{name}: not a full array of numbers")
            np.save(Path(folder) / f"{number}.npy", held[name], allow_pickle=False)
    except Exception as error:  # noqa: BLE001  whatever a damaged file makes of the library
        sys.exit(" ".join(str(error).split()) or type(error).__name__)


if __name__ == "__main__":
    main()
