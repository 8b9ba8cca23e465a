"""What a first and a later run take.

Usage: python tests/benchmarks/start_up.py [--rounds 3] [--later 5]

The package is copied to a temporary folder, so nothing that it has compiled before counts. In each round every job runs
in a process of its own:

- first: an estimate with an empty folder of compiled kernels;
- later: an estimate with all kernels there;
- kept: the same in a new copy of the package, whose kernels another one has compiled;
- `tofmix --help` and `import tofmix`.

Prints CPU and wall-clock time, least and median of the rounds. docs/results/performance.md has it.
"""

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

TOP = Path(__file__).parents[2]
RECORDINGS = ("three_boards.h5", "tmf8829_edge.h5")


def taken(folder: Path, kernels: Path, *arguments: str) -> tuple[float, float]:
    """Run Python with the copy of the package; return CPU and wall-clock time, s."""
    hidden = ("NUMBA_", "TOFMIX_", "PYTHON")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
    nowhere = str(folder / "no-cache")
    own = {
        "PYTHONPATH": str(folder / "copy"),
        "NUMBA_CACHE_DIR": str(kernels),
        "XDG_CACHE_HOME": nowhere,
        "HOME": nowhere,
    }
    begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-P", *arguments], env=kept | own, cwd=folder, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, time.perf_counter() - begun


def copied(folder: Path) -> None:
    """Copy the package anew, without byte code and kernels."""
    shutil.rmtree(folder / "copy", ignore_errors=True)
    shutil.copytree(TOP / "tofmix", folder / "copy/tofmix", ignore=shutil.ignore_patterns("__pycache__"))


def measure(rounds: int, later: int, folder: Path) -> dict[str, list[tuple[float, float]]]:
    """CPU and wall-clock times of each job."""
    found: dict[str, list[tuple[float, float]]] = defaultdict(list)
    copied(folder)
    for number in range(rounds):
        for name in RECORDINGS:
            estimate = "-m", "tofmix", "estimate", str(TOP / "sample_data" / name), "-o", "a.layers.h5", "--overwrite"
            kernels = folder / f"kernels-{number}-{name}"
            found[f"first {name}"].append(taken(folder, kernels, *estimate))
            found[f"later {name}"] += [taken(folder, kernels, *estimate) for _ in range(later)]
            copied(folder)
            found[f"kept {name}"].append(taken(folder, kernels, *estimate))
            shutil.rmtree(kernels)
        found["--help"] += [taken(folder, folder, "-m", "tofmix", "--help") for _ in range(later)]
        found["import"] += [taken(folder, folder, "-c", "import tofmix") for _ in range(later)]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--later", type=int, default=5)
    chosen = parser.parse_args()
    print("| job | CPU | wall |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for job, times in measure(chosen.rounds, chosen.later, Path(folder)).items():
            cells = (f"{min(kind):.2f} ({statistics.median(kind):.2f})" for kind in zip(*times, strict=True))
            print(f"| {job} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
