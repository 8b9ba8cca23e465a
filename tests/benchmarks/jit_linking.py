"""What `tofmix.compiled.jit` gains: the first compile and the time of an estimate, with it and with plain numba.

Usage: python tests/benchmarks/jit_linking.py [--rounds 3]

Prints a Markdown table; docs/results/performance.md holds a copy. Each round takes both in turn, each in a process of
its own: an estimate of the built-in three boards with an empty cache of kernels, then with the full one. The least
of the rounds counts. The layers files must have the same bytes. Asserts nothing else.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LINKED = "from tofmix.cli.start import run; run()"
PLAIN = f"import tofmix.compiled.jit as j; j.LINKS_WITH = (999, 0), (999, 0); {LINKED}"
WAYS = {"linked into callers": LINKED, "plain numba": PLAIN}
FRAMES = "100"


def seconds(code: str, folder: Path, *arguments: str) -> float:
    """Wall-clock time of a command."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "kernels")}
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=folder, env=environment, check=True, capture_output=True
    )
    return time.perf_counter() - start


def rounds(number: int) -> dict[str, tuple[float, float]]:
    """First and later estimate of each way, s: the least of some rounds."""
    least = dict.fromkeys(WAYS, (float("inf"), float("inf")))
    written: set[bytes] = set()
    for _ in range(number):
        for name, code in WAYS.items():
            with tempfile.TemporaryDirectory() as made:
                folder = Path(made)
                seconds(code, folder, "simulate", "three-boards", "--frames", FRAMES, "-o", "boards.h5")
                arguments = ("estimate", "boards.h5", "--workers", "1", "--overwrite")
                first, later = (seconds(code, folder, *arguments) for _ in range(2))
                least[name] = min(least[name][0], first), min(least[name][1], later)
                written.add((folder / "boards.layers.h5").read_bytes())
    print(f"{len(written)} different layers files\n")
    return least


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    least = rounds(parser.parse_args().rounds)
    print("| kernels | first estimate, s | later, s | first / linked | later / linked |")
    print("|---|---|---|---|---|")
    best = least["linked into callers"]
    for name, (first, later) in least.items():
        print(f"| {name} | {first:.1f} | {later:.2f} | {first / best[0]:.2f} | {later / best[1]:.2f} |")


if __name__ == "__main__":
    main()
