"""Wall time and peak memory of simulate, estimate and report on a full-size recording, file to file.

Usage: python tests/benchmarks/whole_command.py [--repeat 3]

The best of several runs of each, kernels compiled before. As a yardstick from the same run: starting Python and
importing numba and h5py, which every one of them does.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path


def measure(command: Sequence[str]) -> tuple[float, float]:
    """Seconds and peak resident MB of one run."""
    start = time.perf_counter()
    null = os.open(os.devnull, os.O_WRONLY)
    child = os.posix_spawn(command[0], list(command), os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, null, 1)])
    os.close(null)
    _, status, usage = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status) != 0:
        sys.exit(f"failed: {' '.join(command)}")
    return time.perf_counter() - start, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3)
    repeat = parser.parse_args().repeat
    python = sys.executable
    tofmix = [python, "-m", "tofmix"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording, layers, page = (str(folder / part) for part in ("b.h5", "b.layers.h5", "b.html"))
        commands = {
            "import numba, h5py": [python, "-c", "import numba, h5py"],
            "simulate": [*tofmix, "simulate", "three-boards", "-o", recording, "--overwrite"],
            "estimate": [*tofmix, "estimate", recording, "--overwrite"],
            "report --html": [*tofmix, "report", layers, "--recording", recording, "--html", page, "--overwrite"],
        }
        print("| 144 x 176 x 100 | seconds | peak MB |\n|---|---|---|")
        total = 0.0
        for label, command in commands.items():
            measure(command)
            runs = [measure(command) for _ in range(repeat)]
            seconds, memory = min(run[0] for run in runs), max(run[1] for run in runs)
            total += seconds if "import" not in label else 0.0
            print(f"| {label} | {seconds:.2f} | {memory:.0f} |")
        print(f"| the three commands | {total:.2f} | |")


if __name__ == "__main__":
    main()
