"""Wall time and peak memory of simulate, estimate and report on a full-size recording, file to file.

Usage: PYTHONPATH=tests python tests/benchmarks/whole_command.py [--repeat 3]

The best of several runs of each, kernels compiled before. As a yardstick from the same run: starting Python and
importing numba and h5py, which every one of them does.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from support.costs import cost, least_cost


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
            cost(command)
            least = least_cost(command, repeat)
            total += least.seconds if "import" not in label else 0.0
            print(f"| {label} | {least.seconds:.2f} | {least.peak_mb:.0f} |")
        print(f"| the three commands | {total:.2f} | |")


if __name__ == "__main__":
    main()
