"""Both searches of `tofmix reconcile` on the same cases, in turn: right, wrong, open, and their times.

    PYTHONPATH=tests python tests/benchmarks/one_search.py --output RESULTS
    PYTHONPATH=tests python tests/benchmarks/one_search.py --output RESULTS --seed 7 --cases 60 --scenes rooms
    PYTHONPATH=tests python tests/benchmarks/one_search.py --output RESULTS --summary

The cases are those of `users.cases`. Each case and search is a line of `RESULTS/pairs.jsonl`; one that has a line is
not done again. The table has the cases that both have done, and the probability of so many differences by chance.
"""

import argparse
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.stats import binomtest
from users.cases import FRAMES, RATE_HZ, draw, recorded
from users.oracle import known
from users.score import score

from tofmix.options import NEW_SEARCH, OLD_SEARCH, SEARCH_VARIABLE
from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.search.name import KINDS
from tofmix.reconciliation.search.search_state import Settings
from tofmix.reconciliation.workflow import reconcile

SEED = 6203
DONE = "pairs.jsonl"
Line = Mapping[str, Any]


def judged(seed: int, number: int, scenes: str) -> Iterator[Line]:
    """One case by both searches; the one that is first alternates."""
    case = draw(seed, number, scenes)
    samples = recorded(case)
    oracle = known(case) if case.hidden else None
    for which in (NEW_SEARCH, OLD_SEARCH) if number % 2 else (OLD_SEARCH, NEW_SEARCH):
        evidence = make_evidence(case.given, samples, time_s=np.arange(FRAMES) / RATE_HZ)
        os.environ[SEARCH_VARIABLE] = which
        wall, cpu = time.perf_counter(), time.process_time()
        gap = reconcile(case.given, evidence, Settings(kinds=KINDS)).as_dict()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        outcome = score(case, gap, oracle)
        yield {
            "search": which,
            "number": number,
            "name": case.name,
            "result": outcome.result,
            "why": outcome.why,
            "verdict": gap["verdict"],
            "named": sorted(e["kind"] for e in gap["effects"]),
            "aliases": [a["kinds"] for a in gap["aliases"]],
            "cpu_s": round(cpu, 2),
            "wall_s": round(wall, 2),
        }


def table(lines: Sequence[Line]) -> Iterator[str]:
    """The table of the cases that both searches have done, and the cases in which their results differ."""
    of: dict[int, dict[str, Line]] = {}
    for line in lines:
        of.setdefault(line["number"], {})[line["search"]] = line
    pairs = [pair for pair in of.values() if len(pair) > 1]
    yield "| search | cases | right | wrong | open | CPU s, median | CPU s, all | wall s, median |"
    yield "|---|---|---|---|---|---|---|---|"
    for which in (OLD_SEARCH, NEW_SEARCH):
        own = [pair[which] for pair in pairs]
        results = [line["result"] for line in own]
        counts = " | ".join(str(results.count(r)) for r in ("right", "wrong", "open"))
        cpu = [line["cpu_s"] for line in own]
        walls = median(line["wall_s"] for line in own)
        yield f"| {which} | {len(own)} | {counts} | {median(cpu):.1f} | {sum(cpu):.0f} | {walls:.1f} |"
    right = [[pair[which]["result"] == "right" for which in (OLD_SEARCH, NEW_SEARCH)] for pair in pairs]
    lost, won = right.count([True, False]), right.count([False, True])
    chance = binomtest(won, won + lost).pvalue if won + lost else 1.0
    yield ""
    yield f"Right by one alone: {lost} old, {won} new; a sign test gives p = {chance:.2g}."
    for pair in pairs:
        if pair[OLD_SEARCH]["result"] != pair[NEW_SEARCH]["result"]:
            said = (f"{w}: {pair[w]['result']} {' + '.join(pair[w]['named'])}" for w in (OLD_SEARCH, NEW_SEARCH))
            yield f"- {pair[OLD_SEARCH]['name']}: {'; '.join(said)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--scenes", choices=("boards", "rooms"), default="boards")
    parser.add_argument("--summary", action="store_true", help="only print the table")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / DONE
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {line["number"] for line in lines if sum(o["number"] == line["number"] for o in lines) > 1}
    for number in () if options.summary else range(options.cases):
        if number in done:
            continue
        for line in judged(options.seed, number, options.scenes):
            lines.append(line)
            with path.open("a") as file:
                file.write(json.dumps(line) + "\n")
    print("\n".join(table(lines)))


if __name__ == "__main__":
    main()
