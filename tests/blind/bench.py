"""Build and score all cases, and sum up: the one command of the blind bench.

    PYTHONPATH=tests python -m blind.bench --output FOLDER [--select NAME ...] [--sealed-seed N] [--processes 2]

Each case is built, scored and removed; its result is a line of FOLDER/results.jsonl. Cases that have a line are not
done again, so that the command may be stopped and started at will; they come in an order in which every beginning is a
fair sample of all. `--no-reconcile` measures gaps and ceilings alone;
`--summary` prints what is there and does nothing. The sealed half is left out until its master seed is given.
"""

import argparse
import hashlib
import json
import multiprocessing
import shlex
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from blind.cases import Case, build
from blind.generate import selected
from blind.score import RECONCILE, Plan, score
from blind.summary import summary

_Job = tuple[Case, int, Path, Plan]
SMALL: dict[str, Any] = {"rows": 32, "cols": 40, "frames": 100}  # what CI can afford


def _one(job: _Job) -> dict[str, Any]:
    case, master, work, plan = job
    try:
        built = build(case, master)
        if plan.small:
            built = replace(built, device=replace(built.device, **SMALL))
        result = score(built, work, plan)
    except Exception as error:  # noqa: BLE001  one case must not end the others
        result = {
            "case": case.name,
            "half": case.half,
            "sort": case.sort,
            "level": case.level,
            "broken": f"{type(error).__name__}: {error}",
        }
    return result | {"master": master}


def run(jobs: list[_Job], results: Path, processes: int) -> None:
    """Score cases, a line each as they end; one process is this one."""
    if processes == 1:
        _note(map(_one, jobs), len(jobs), results)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        _note(pool.imap_unordered(_one, jobs), len(jobs), results)


def _note(scored: Iterable[dict[str, Any]], cases: int, results: Path) -> None:
    """Write a line for each result as it comes, and print one."""
    with results.open("a", encoding="utf-8") as out:
        for number, result in enumerate(scored, 1):
            out.write(json.dumps(result) + "\n")
            out.flush()
            print(f"{number}/{cases} {result['case']} {_line(result)}", flush=True)


def _line(result: dict[str, Any]) -> str:
    if "broken" in result or "failed" in result:
        return str(result.get("broken") or result.get("failed"))
    said = f"{result['verdict']} {'+'.join(result['named']) or '-'}" if "verdict" in result else ""
    numbers = [
        f"{key} {result[key]:.3f}" for key in ("before", "floor", "ceiling", "closed") if result.get(key) is not None
    ]
    return " ".join([said, *numbers])


def _lot(case: Case) -> str:
    return hashlib.sha256(case.name.encode()).hexdigest()


def fair_order(cases: Iterable[tuple[Case, int]]) -> list[tuple[Case, int]]:
    """Order cases with their master seeds so that any beginning holds the same share of each sort, kind and level."""
    strata = defaultdict(list)
    for case, master in cases:
        kinds = case.kinds if case.sort == "single" and case.setting == "ordinary" else ()
        strata[case.setting, case.half, case.sort, kinds, case.level].append((case, master))
    placed = []
    for members in strata.values():
        drawn = sorted((_lot(case), case.name, (case, master)) for case, master in members)
        placed += [((rank + 0.5) / len(drawn), *entry) for rank, entry in enumerate(drawn)]
    return [pair for *_, pair in sorted(placed, key=lambda entry: entry[:3])]


def read_results(path: Path) -> list[dict[str, Any]]:
    """All results that were written, the last of each case."""
    if not path.exists():
        return []
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    return list({(line["case"], line["master"]): line for line in lines}.values())


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--select", nargs="*", default=[], help="beginnings of case names")
    parser.add_argument("--every", type=int, default=1, help="every n-th of them only")
    parser.add_argument("--sealed-seed", type=int, help="master seed of the sealed half")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--reconcile", default=shlex.join(RECONCILE), help="the command that gets MODEL MEASURED -o FOLDER"
    )
    parser.add_argument("--no-reconcile", action="store_true")
    parser.add_argument("--no-ceiling", action="store_true")
    parser.add_argument("--small", action="store_true", help="small images and few frames, as in CI")
    parser.add_argument("--summary", action="store_true")
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    results = options.output / "results.jsonl"
    if not options.summary:
        done = {(line["case"], line["master"]) for line in read_results(results) if "broken" not in line}
        plan = Plan(
            reconcile=None if options.no_reconcile else tuple(shlex.split(options.reconcile)),
            ceiling=not options.no_ceiling,
            small=options.small,
        )
        cases = selected(options.select, options.sealed_seed)[:: options.every]
        work = options.output / "work"
        left = [(case, master) for case, master in cases if (case.name, master) not in done]
        jobs = [(case, master, work, plan) for case, master in fair_order(left)]
        run(jobs, results, options.processes)
    print(summary(read_results(results)))


if __name__ == "__main__":
    main()
