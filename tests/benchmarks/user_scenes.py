"""`tofmix reconcile` on scenes that users have: how often it is right, wrong or silent, beside what can be known.

    PYTHONPATH=tests python tests/benchmarks/user_scenes.py --output RESULTS
    PYTHONPATH=tests python tests/benchmarks/user_scenes.py --output RESULTS --cases 240 --seed 7 --jobs 2
    PYTHONPATH=tests python tests/benchmarks/user_scenes.py --output ROOMS --scenes rooms --cases 60
    PYTHONPATH=tests python tests/benchmarks/user_scenes.py --output RESULTS --summary
    PYTHONPATH=tests python tests/benchmarks/user_scenes.py --output RESULTS --peer
    PYTHONPATH=tests python tests/benchmarks/user_scenes.py --output TRUE --model true

Each case is a line of `RESULTS/results.jsonl`; a case that has a line is not done again, so that the command may be
stopped and started at will. With `--peer`, greedy selection by BIC does the same cases afterwards, and its lines are in
`RESULTS/peer.jsonl`. What a case is, and what counts as right, is in docs/results/user-scenes.md.
"""

import argparse
import json
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from blind.camera import Recording
from blind.two_samples import two_samples
from users.cases import FRAMES, RATE_HZ, Case, draw, record, recorded
from users.greedy import greedy_bic
from users.oracle import known
from users.score import score

from tofmix.arrays import Float32Array
from tofmix.reconciliation import workflow
from tofmix.reconciliation.evidence import make_evidence
from tofmix.reconciliation.settings import KINDS, Settings
from tofmix.reconciliation.workflow import Reconciliation, reconcile

SEED = 20261124
RESULTS = ("right", "wrong", "open")
DONE, PEER = "results.jsonl", "peer.jsonl"
FOLLOWED = 2
"""How often the advice is followed."""

FRESH = 1_000_003
"""Added to a case's seed for the recordings that no fit has seen."""


def agreeing(number: int, seed: int, scenes: str) -> dict[str, Any]:
    """One case whose true model is given: it agrees, or it does not."""
    case = draw(seed, number, scenes)
    evidence = make_evidence(case.true, recorded(case), time_s=np.arange(FRAMES) / RATE_HZ)
    start = time.perf_counter()
    gap = reconcile(case.true, evidence, Settings(kinds=KINDS)).as_dict()
    seconds = time.perf_counter() - start
    named = sorted(e["kind"] for e in gap["effects"])
    return {
        "number": number,
        "name": case.name,
        "scene": case.scene,
        "sort": case.sort,
        "kinds": list(case.kinds),
        "result": "right" if gap["verdict"] == "agree" else "wrong" if named else "open",
        "why": " + ".join(named),
        "verdict": gap["verdict"],
        "named": named,
        "aliases": [],
        "identifiable": None,
        "seconds": round(seconds, 1),
        "told_apart": [],
    }


def judged(number: int, seed: int, scenes: str) -> dict[str, Any]:
    """One case: drawn, recorded, reconciled and scored; where it is open, the advice is followed."""
    case = draw(seed, number, scenes)
    samples = recorded(case)
    evidence = make_evidence(case.given, samples, time_s=np.arange(FRAMES) / RATE_HZ)
    start = time.perf_counter()
    found = reconcile(case.given, evidence, Settings(kinds=KINDS))
    gap, seconds = found.as_dict(), time.perf_counter() - start
    oracle = known(case) if case.hidden else None
    outcome = score(case, gap, oracle)
    return {
        "number": number,
        "name": case.name,
        "scene": case.scene,
        "sort": case.sort,
        "kinds": list(case.kinds),
        "result": outcome.result,
        "why": outcome.why,
        "verdict": gap["verdict"],
        "named": sorted(e["kind"] for e in gap["effects"]),
        "aliases": [a["kinds"] for a in gap["aliases"]],
        "identifiable": None if oracle is None else oracle.identifiable,
        "seconds": round(seconds, 1),
        "told_apart": told_apart(case, found, seed),
        "followed": followed(case, found, samples) if outcome.result == "open" else [],
    }


def followed(case: Case, found: Reconciliation, samples: Float32Array) -> list[dict[str, Any]]:
    """What came of the advice: the verdict and all effects that the model then has, each time it was followed.

    The suggested model takes the place of the given one, or one more effect is searched for, as the next steps say.
    """
    out: list[dict[str, Any]] = []
    model, settings = case.given, Settings(kinds=KINDS)
    while len(out) < FOLLOWED and found.verified.verdict not in workflow.DONE:
        more = any("--max-effects" in step for step in found.next_steps)
        if not (found.suggested or more):
            break
        if found.suggested:
            model = replace(model, effects=(*model.effects, *(n.effect for n in found.advised(0))))
        else:
            settings = replace(settings, max_effects=settings.max_effects + 1)
        evidence = make_evidence(model, samples, time_s=np.arange(FRAMES) / RATE_HZ)
        found = reconcile(model, evidence, settings)
        effects = (*model.effects, *(n.effect for n in found.named))
        out.append({"verdict": found.verified.verdict, "effects": sorted(e.kind for e in effects)})
    return out


def by_bic(number: int, seed: int, scenes: str) -> dict[str, Any]:
    """The same case by greedy selection with BIC."""
    case = draw(seed, number, scenes)
    evidence = make_evidence(case.given, recorded(case), time_s=np.arange(FRAMES) / RATE_HZ)
    start = time.perf_counter()
    gap = greedy_bic(case.given, evidence, Settings(kinds=KINDS))
    seconds = time.perf_counter() - start
    outcome = score(case, gap, known(case) if case.hidden else None)
    return {
        "number": number,
        "name": case.name,
        "result": outcome.result,
        "why": outcome.why,
        "named": sorted(e["kind"] for e in gap["effects"]),
        "seconds": round(seconds, 1),
    }


def told_apart(case: Case, found: Reconciliation, seed: int) -> list[str]:
    """Two-sample tests, at 1 %, that tell a simulation of the refined model from another recording of the truth."""
    effects = (*case.given.effects, *(n.effect for n in found.named))
    ranges = record(replace(case.given, effects=effects), case.seed + 2 * FRESH), recorded(case, case.seed + FRESH)
    time_s = np.arange(FRAMES) / RATE_HZ
    pair = [Recording(range_mm=r, amplitude=np.ones_like(r), time_s=time_s, temperature_c=None) for r in ranges]
    return [test.name for test in two_samples(*pair, seed=seed) if test.differs]


JUDGES = {"given": judged, "true": agreeing}


def run(numbers: Sequence[int], options: argparse.Namespace) -> None:
    """Do what is not done yet, and note each case as it ends; then the peer, if it is asked for."""
    options.output.mkdir(parents=True, exist_ok=True)
    _noted(numbers, JUDGES[options.model], DONE, options)
    if options.peer:
        _noted(numbers, by_bic, PEER, options)


def _noted(
    numbers: Sequence[int], judge: Callable[..., dict[str, Any]], name: str, options: argparse.Namespace
) -> None:
    done = {line["number"] for line in lines(options.output, name)}
    with (
        ProcessPoolExecutor(options.jobs, mp_context=get_context("forkserver")) as pool,
        (options.output / name).open("a", encoding="utf-8") as file,
    ):
        for line in pool.map(
            partial(judge, seed=options.seed, scenes=options.scenes), [n for n in numbers if n not in done]
        ):
            file.write(json.dumps(line) + "\n")
            file.flush()
            print(f"{line['name']}: {line['result']} {line['why']}", flush=True)


def lines(output: Path, name: str = DONE) -> list[dict[str, Any]]:
    """What is done."""
    path = output / name
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def summary(done: Sequence[dict[str, Any]], peer: Sequence[dict[str, Any]] = ()) -> Iterator[str]:
    """Tables by sort, scene and kind, and what was not right; the peer's of the cases that both have done."""
    for name, group in _groups(done).items():
        yield f"| {name} | cases | right | wrong | open | can be known | told by energy | by a classifier | seconds |"
        yield "|---|---|---|---|---|---|---|---|---|"
        for key, members in group.items():
            sure = sum(m["identifiable"] is not False for m in members)
            told = [sum(test in m["told_apart"] for m in members) for test in ("energy", "classifier")]
            yield f"| {key} | {_counted(members)} | {sure} | {told[0]} | {told[1]} | {_seconds(members)} |"
        yield ""
    if peer:
        yield from _beside(done, {line["number"]: line for line in peer})
    yield from _advice(done)
    for line in sorted(done, key=lambda member: member["number"]):
        if line["result"] != "right":
            yield f"{line['result']}: {line['name']}: {line['verdict']}; {line['why']}"


def _advice(done: Sequence[dict[str, Any]]) -> Iterator[str]:
    """What came of the advice in the open cases."""
    tried = [line for line in done if line.get("followed")]
    ended = [line for line in tried if line["followed"][-1]["verdict"] in workflow.DONE]
    whole = [line for line in ended if line["followed"][-1]["effects"] == sorted(line["kinds"])]
    if tried:
        yield (
            f"Advice followed up to {FOLLOWED} times in {len(tried)} open cases: {len(ended)} ended agree or explained,"
            f" {len(whole)} of them with exactly the hidden kinds."
        )
        yield from (f"followed: {line['name']}: {line['followed'][-1]}" for line in tried)
        yield ""


def _groups(done: Sequence[dict[str, Any]]) -> dict[str, dict[str, list[dict[str, Any]]]]:
    groups: dict[str, dict[str, list[dict[str, Any]]]] = {n: defaultdict(list) for n in ("sort", "scene", "kind")}
    for line in done:
        groups["sort"]["all"].append(line)
        groups["sort"][line["sort"]].append(line)
        groups["scene"][line["scene"]].append(line)
        for kind in line["kinds"]:
            groups["kind"][kind].append(line)
    return {n: dict(sorted(g.items(), key=lambda item: (item[0] != "all", item[0]))) for n, g in groups.items()}


def _counted(members: Sequence[dict[str, Any]]) -> str:
    count = Counter(m["result"] for m in members)
    return " | ".join(str(n) for n in (len(members), *(count[r] for r in RESULTS)))


def _seconds(members: Sequence[dict[str, Any]]) -> str:
    return f"{median(m['seconds'] for m in members):.1f}"


def _beside(done: Sequence[dict[str, Any]], peer: Mapping[int, dict[str, Any]]) -> Iterator[str]:
    """Tables of `reconcile` and its peer, of the cases that both have done."""
    both = [line for line in done if line["number"] in peer]
    for name, group in _groups(both).items():
        yield f"| {name} | cases | right | wrong | open | seconds | BIC: right | wrong | open | seconds |"
        yield "|---|---|---|---|---|---|---|---|---|---|"
        for key, members in group.items():
            others = [peer[m["number"]] for m in members]
            by_peer = _counted(others).split(" | ", 1)[1]
            yield f"| {key} | {_counted(members)} | {_seconds(members)} | {by_peer} | {_seconds(others)} |"
        yield ""


def chosen(options: argparse.Namespace) -> list[int]:
    """Numbers of the cases that are asked for."""
    cases = ((n, draw(options.seed, n, options.scenes)) for n in range(0, options.cases, options.every))
    known = ((n, case) for n, case in cases if options.model == "given" or case.stranger is None)
    return [n for n, case in known if options.select in case.name]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--scenes", choices=("boards", "rooms"), default="boards", help="rooms: rooms, corridors, alcoves"
    )
    parser.add_argument("--cases", type=int, default=240)
    parser.add_argument("--every", type=int, default=1, help="take each so-many-th case")
    parser.add_argument("--select", default="", help="a part of the cases' names")
    parser.add_argument("--model", choices=tuple(JUDGES), default="given", help="true: nothing is hidden")
    parser.add_argument("--peer", action="store_true", help="do the cases by greedy selection with BIC too")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--summary", action="store_true", help="print the tables of what is done, and do nothing")
    options = parser.parse_args(arguments)
    if not options.summary:
        run(chosen(options), options)
    print("\n".join(summary(lines(options.output), lines(options.output, PEER))))


if __name__ == "__main__":
    main()
