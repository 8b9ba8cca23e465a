"""How often the standard errors of `tofmix reconcile` cover the truth, on the package's own simulator.

    PYTHONPATH=tests python tests/benchmarks/coverage.py [--recordings 60] [--by-number] [KIND ...]

For each kind, recordings of a small scene with that effect, alone and beside noise that remembers the frame before
(`temporal_correlation` of 0.5); the effect is fitted on the fitting frames, as `reconcile` does, and the share of its
numbers that lie within 1, 2 and 3 standard errors is printed. Normal errors give 0.683, 0.954 and 0.997. Each row has
recordings of its own. Numbers of one recording go together, so that the error of the spread is by recordings.
Kinds that only the whole search fits are tried alone: of two effects it would have to name both.
"""

import argparse
import math
import sys
import zlib
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.reconcile_errors import EFFECTS_OF, LATENT, MEMORY, deviations, scene

from tofmix.arrays import FloatArray


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("kinds", nargs="*", default=[], help="kinds to try; all if left out")
    parser.add_argument("--recordings", type=int, default=60)
    parser.add_argument("--by-number", action="store_true", help="also each number's spread and signed distances")
    options = parser.parse_args(arguments)
    model = scene()
    print("| effect | noise | numbers | within 1 | within 2 | within 3 | spread |")
    print("|---|---|---|---|---|---|---|")
    for kind in options.kinds or list(EFFECTS_OF):
        for noise, beside in (("independent", ()), ("with a memory", (MEMORY,))):
            if beside and any(e.kind in LATENT for e in EFFECTS_OF[kind]):
                continue
            first = zlib.crc32(f"{kind}, {noise}".encode())
            seeds = range(first, first + options.recordings)
            found = [d for seed in seeds if (d := deviations(model, EFFECTS_OF[kind], beside, seed=seed))]
            print(f"| {kind} | {noise} | {_row([np.array(list(d.values())) for d in found])} |", flush=True)
            for name in found[0] if options.by_number and found else ():
                off = np.array([d[name] for d in found if name in d])
                print(f"    {name}, {math.sqrt((off**2).mean()):.2f}:", *(f"{d:+.2f}" for d in off), flush=True)


def _row(found: list[FloatArray]) -> str:
    """How many numbers, shares within 1, 2 and 3 errors, and root mean square, with its error by recordings."""
    off = np.concatenate([np.zeros(0), *found])
    if not off.size:
        return "0 | | | | "
    shares = " | ".join(f"{(np.abs(off) < n).mean():.3f}" for n in (1, 2, 3))
    spread = math.sqrt((off**2).mean())
    sums = np.array([(d**2 - spread**2).sum() for d in found])
    error = math.sqrt((sums**2).sum()) / off.size / (2 * spread) if spread else 0.0
    return f"{off.size} | {shares} | {spread:.2f} +- {error:.2f}"


if __name__ == "__main__":
    main()
