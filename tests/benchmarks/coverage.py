"""How often the standard errors of `tofmix reconcile` cover the truth, on the package's own simulator.

    PYTHONPATH=tests python tests/benchmarks/coverage.py [--recordings 60] [KIND ...]

For each kind, recordings of a small scene with that effect, alone and beside noise that remembers the frame before
(`temporal_correlation` of 0.5); the effect is fitted on the fitting frames, as `reconcile` does, and the share of its
numbers that lie within 1, 2 and 3 standard errors is printed. Normal errors give 0.683, 0.954 and 0.997.
"""

import argparse
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from reconcile_errors import EFFECTS_OF, MEMORY, deviations, scene


def main(arguments: list[str] | None = None) -> None:
    """Print the shares, kind by kind."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("kinds", nargs="*", default=[], help="kinds to try; all if left out")
    parser.add_argument("--recordings", type=int, default=60)
    options = parser.parse_args(arguments)
    model = scene()
    print("| effect | noise | numbers | within 1 | within 2 | within 3 | spread |")
    print("|---|---|---|---|---|---|---|")
    for kind in options.kinds or list(EFFECTS_OF):
        for noise, beside in (("independent", ()), ("with a memory", (MEMORY,))):
            off = np.concatenate(
                [deviations(model, EFFECTS_OF[kind], beside, seed=seed) for seed in range(options.recordings)]
            )
            shares = " | ".join(f"{(np.abs(off) < n).mean():.3f}" for n in (1, 2, 3))
            print(f"| {kind} | {noise} | {off.size} | {shares} | {math.sqrt((off**2).mean()):.2f} |", flush=True)


if __name__ == "__main__":
    main()
