"""Layers that are not there: situations of real recordings that equation (1) leaves out.

Usage: PYTHONPATH=tests:. python tests/benchmarks/not_there.py PART ...

Each part simulates its situation with code of its own, estimates it, and prints Markdown tables of what came out beside
the truth; `PART --help` tells its options. docs/results/not-there.md holds copies. Asserts nothing.
"""

import argparse
import sys
from importlib import import_module

PARTS = {
    "clutter": "fog, rain and uniform dark counts before a net and a wall",
    "filters": "averages, medians and means over time or pixels in the camera; memory that is no filter",
    "lost": "a box that returns no valid sample, or few, before a wall; samples lost by chance",
    "shares": "edges where samples are drawn by brightness, or the strongest return is kept",
    "suspects": "scattered light, folded walls, people who pass, cover glasses; false marks of real recordings",
}
"""Modules of `not_there_parts`, each with `main(arguments)`."""


def main() -> None:
    listed = "\n".join(f"  {name}: {text}" for name, text in PARTS.items())
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=f"parts:\n{listed}", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=PARTS)
    arguments = parser.parse_args(sys.argv[1:2])
    import_module(f"benchmarks.not_there_parts.{arguments.part}").main(sys.argv[2:])


if __name__ == "__main__":
    main()
