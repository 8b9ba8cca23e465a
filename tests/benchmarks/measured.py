"""`tofmix reconcile` on measured recordings, and on simulated ones that resemble them: names that it gives.

    PYTHONPATH=tests:. python tests/benchmarks/measured.py
    PYTHONPATH=tests:. python tests/benchmarks/measured.py --part 20
    PYTHONPATH=tests:. python tests/benchmarks/measured.py walls same --part 20 --output RESULTS

Without names of parts, every part runs; `--part` limits the number of cases of each part. The cases of a seed are the
same in every run, and the first ones the same for every `--part`. A case that has a line in `RESULTS/PART.jsonl` is not
run again, so that the command may be stopped and started at will. Prints a Markdown table for each part;
docs/results/measured.md holds copies. Asserts nothing.
"""

import argparse
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

PARTS = {
    "walls": "walls at stated distances, with a folded axis, an offset, and a bias of each pixel",
    "same": "real recordings with permuted frames, against a model made from their own first half",
    "references": "real recordings with permuted frames, against their own first third as the scene",
    "injections": "changes of known size in real recordings, against their own first half as the scene",
    "minutes": "minutes of a sensor that lies still, against the minutes ten before them as the scene",
    "legs": "straight legs of flights, against their own first frames as the scene",
    "flights": "flights towards a wall, against the wall at their start",
}
"""Modules of `measured_parts`, each with the members of `Part`."""

SEED = 20261128

Line = Mapping[str, Any]
"""The result of a case; it holds `number`."""


class Part(Protocol):
    """A module of `measured_parts`."""

    CASES: int
    """Cases of the whole part."""

    judged: Callable[[int, int], Line | None]
    """The result of case `number` of `seed`, in words of JSON; None where its recording is not on this machine."""

    table: Callable[[Sequence[Line]], Iterable[str]]
    """Lines of a Markdown table of all results."""

    order: Callable[[int], Sequence[int]]
    """Numbers of the cases of a smaller run of so many cases."""


def lines(path: Path) -> list[Line]:
    """The results in a file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def run(name: str, part: Part, options: argparse.Namespace) -> Iterator[str]:
    """Run the cases of a part that have no result, and yield its table."""
    wanted = part.order(min(options.part or part.CASES, part.CASES))
    path = options.output / f"{name}.jsonl"
    done = {line["number"]: line for line in lines(path)}
    for number in wanted:
        if number in done:
            continue
        result = part.judged(number, options.seed)
        if result is None:
            continue
        done[number] = result
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(result) + "\n")
    yield f"### {PARTS[name].capitalize()}"
    yield ""
    yield from part.table([done[number] for number in wanted if number in done])


def main() -> None:
    listed = "\n".join(f"  {name}: {text}" for name, text in PARTS.items())
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=f"parts:\n{listed}", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="PART", help="parts to run; all without it")
    parser.add_argument("--part", type=int, metavar="N", help="at most N cases of each part")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--output", type=Path, default=Path("measured"), help="folder of the results")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in PARTS]
    if unknown:
        parser.error(f"{unknown[0]} is not a part; the parts are {', '.join(PARTS)}")
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.names or PARTS:
        part: Any = import_module(f"benchmarks.measured_parts.{name}")
        print("\n".join(run(name, part, options)), flush=True)


if __name__ == "__main__":
    main()
