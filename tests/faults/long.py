"""The long run: every kind of fault, load and property, with counts.

Usage: python -m faults.long --output FOLDER [--only STAGE,...] [--mutants 5000] [--processes 2], with
`tests` and the package on PYTHONPATH. It can be stopped and started again: what is done is kept in FOLDER. It
prints what it finds as it goes, and at the end the tables of all that has been run; it leaves with 1 if there are
faults. What tries nothing, or cannot be run here, is a fault.
"""

import argparse
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeAlias

from faults import disk, load
from faults.changing import changing
from faults.fuzz import Fuzz, Verdict, table
from faults.inject import CASES, FAILURES, WRITING, Injection, Tally, compiled, inputs_into, with_shim
from faults.inject import table as injection_table
from faults.originals import make
from faults.pool import Job, Outcome, Pool

TESTS = Path(__file__).parents[1]
_BATCH = 250

Done: TypeAlias = tuple[str, int]
"""What a stage has to say, as Markdown, and how many things it tried."""

Stage: TypeAlias = Callable[["Run"], Done]
STAGES: dict[str, Stage] = {}
"""What is run, in its order."""


class Run:
    """The folder, the options, and the faults found."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.folder: Path = options.output
        self.faults: list[str] = []

    def report(self, text: str) -> None:
        """Keep a fault, and show it."""
        self.faults.append(text)
        print(f"FAULT: {text}", flush=True)

    def stage(self, name: str) -> dict[str, Any]:
        """Run one; one that tried nothing has a fault, for it has shown nothing."""
        before, since = len(self.faults), time.monotonic()
        text, tried = STAGES[name](self)
        if not tried:
            self.report(f"{name}: nothing was tried")
        minutes = (time.monotonic() - since) / 60
        return {"text": text, "tried": tried, "minutes": minutes, "faults": self.faults[before:]}


def _stage(work: Stage) -> Stage:
    STAGES[work.__name__.strip("_").replace("_", " ")] = work
    return work


@_stage
def _mutants(run: Run) -> Done:
    """Mutants through the commands that read them."""
    path = run.folder / "mutants.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    verdicts = [_verdict(json.loads(line)) for line in lines]
    done = len({verdict.mutant for verdict in verdicts}) // _BATCH * _BATCH  # a batch that was broken off begins anew
    first = run.options.first_mutant
    verdicts = [verdict for verdict in verdicts if int(verdict.mutant.split()[-1]) < first + done]
    path.write_text("".join(json.dumps(asdict(verdict)) + "\n" for verdict in verdicts))
    with tempfile.TemporaryDirectory(prefix="originals-") as name, Pool(run.options.processes) as pool:
        originals = make(Path(name), pool, learn=True)
        fuzz = Fuzz(Path(name), pool, originals)
        fuzz.check_originals()
        while done < run.options.mutants:
            found = list(fuzz.run(list(originals), _BATCH, seed=first + done, commands=2))
            with path.open("a") as file:
                file.writelines(json.dumps(asdict(verdict)) + "\n" for verdict in found)
            verdicts += found
            done += _BATCH
            print(f"{done} mutants, {sum(bool(verdict.fault) for verdict in verdicts)} faults", flush=True)
    for verdict in verdicts:
        if verdict.fault:
            run.report(f"{verdict.fault}: {verdict.mutant}: {verdict.command}: {verdict.change}: {verdict.outcome.err}")
    idle = [kind for kind in originals if not any(verdict.kind == kind for verdict in verdicts)]
    if idle:
        run.report(f"no mutants of {', '.join(idle)}")
    numbers = f"{done} mutants, those of the numbers {first} to {first + done - 1}"
    return f"{numbers}; {len(verdicts)} commands\n\n{table(verdicts)}", len(verdicts)


def _verdict(values: dict[str, Any]) -> Verdict:
    return Verdict(**values | {"outcome": Outcome(**values["outcome"])})


@_stage
def _failing_calls(run: Run) -> Done:
    """The N-th call of each kind fails: all of them where they are few, else the first, the last, and some between."""
    tallies: list[Tally] = []
    with tempfile.TemporaryDirectory(prefix="originals-") as name:
        library = compiled(Path(name))
        if library is None:
            return "not run: no C compiler", 0
        with Pool(run.options.processes, with_shim(library)) as pool:
            make(Path(name), pool)
            injection = Injection(Path(name), pool)
            for case in CASES:
                tallies += _failing_calls_of(run, case, injection)
    for failure in FAILURES:
        if not any(tally.tried for tally in tallies if tally.failure == failure):
            run.report(f"{failure}: no call of any command has failed")
    most = run.options.most_calls
    said = f"of at most {most} calls of a kind all, of more {most}; of reconcile {most // 4}" if most else "all calls"
    return f"{said}\n\n{_counted(run, tallies)}", sum(len(tally.tried) for tally in tallies)


def _failing_calls_of(run: Run, case: str, injection: Injection) -> list[Tally]:
    """Run one command, unless that has been done."""
    path = run.folder / f"failing {case}.json"
    if not path.exists():
        most = run.options.most_calls and max(3, run.options.most_calls // CASES[case].cost)
        found = [injection.run(case, failure, most=most) for failure in FAILURES]
        path.write_text(json.dumps([asdict(tally) for tally in found]))
        print(f"{case}\n{injection_table(found)}", flush=True)
    return [Tally(**values) for values in json.loads(path.read_text())]


def _counted(run: Run, tallies: list[Tally]) -> str:
    for tally in tallies:
        for fault in tally.faults:
            run.report(f"{tally.case}: {tally.failure}: {fault}")
    return injection_table(tallies)


def _must(run: Run, tallies: list[Tally], what: str) -> int:
    """Report the kinds of failure that none of the runs met; return how many runs there were."""
    for failure in dict.fromkeys(tally.failure for tally in tallies):
        if not sum(getattr(tally, what) for tally in tallies if tally.failure == failure):
            run.report(f"{failure}: not one run was {what}")
    return sum(tally.runs for tally in tallies)


@_stage
def _kills(run: Run) -> Done:
    """Signals at random moments of the work."""
    chance = random.Random(1)  # noqa: S311  no secret
    tallies = []
    with tempfile.TemporaryDirectory(prefix="originals-") as name, Pool(1) as pool:
        make(Path(name), pool)
        injection = Injection(Path(name), pool)
        share = run.options.kills // len(WRITING)
        for case in WRITING:
            count = share * 4 if case == "estimate" else share // CASES[case].cost
            for number in (9, 2, 15):
                moments = [chance.random() for _ in range(count if number == 9 else count // 4)]
                tallies.append(injection.kill(case, moments, number=number, report=lambda _: None))
    return _counted(run, tallies), _must(run, tallies, "killed")


@_stage
def _full_disks(run: Run) -> Done:
    """`ulimit -f`, a disk of 8 MB with little room, and a disk that is read-only."""
    lines: list[str] = []
    with tempfile.TemporaryDirectory(prefix="originals-") as name, Pool(1) as pool:
        make(Path(name), pool)
        injection = Injection(Path(name), pool)
        sizes = [4096, *range(8192, 120_000, 13_000)]
        tallies = [injection.limit(case, sizes[:: CASES[case].cost], report=lambda _: None) for case in WRITING]
        place = Path(name) / "disk"
        with disk.small_disk(place) as mounted:
            if mounted is not None:
                free = range(0, 200_000, 24_576)
                tallies += [
                    injection.fill(case, mounted, free[:: CASES[case].cost], report=lambda _: None) for case in WRITING
                ]
                lines.append(_read_only(run, Path(name), mounted, pool))
            else:
                run.report("no disk can be mounted here: neither the full nor the read-only one was run")
        tallies += [injection.device(case, report=lambda _: None) for case in CASES]
        tallies += [injection.closed(case, report=lambda _: None) for case in WRITING]
    return "\n\n".join([_counted(run, tallies), *lines]), _must(run, tallies, "refused")


def _read_only(run: Run, originals: Path, place: Path, pool: Pool) -> str:
    inputs_into(originals, place)
    disk.make_read_only(place)
    codes = Counter[int]()
    for case in WRITING:
        outcome = pool.run(Job(argv=tuple(CASES[case].command.split()), cwd=str(place)))
        codes[outcome.code] += 1
        if outcome.code != 4 or "Read-only file system" not in outcome.err:
            run.report(f"read-only disk: {CASES[case].command}: {outcome.code} {outcome.err}")
    return f"a read-only disk: {sum(codes.values())} commands, exit codes {dict(codes)}"


@_stage
def _changing_recordings(run: Run) -> Done:
    """A recording that is written to while it is read."""
    with Pool(1) as pool:
        counts = changing(pool, run.options.changes, report=run.report)
    if not counts["refused"]:
        run.report("changing recordings: no change was met")
    lines = ["| a recording changed while it is read | |", "|---|---|", *(f"| {k} | {n} |" for k, n in counts.items())]
    return "\n".join(lines), counts.total()


@_stage
def _loads(run: Run) -> Done:
    """Concurrent runs, declared sizes, a cluster's worker killed."""
    with Pool(1) as pool:
        lines = load.huge(pool, report=run.report)
    lines = [load.side_by_side(8, report=run.report), *lines, load.worker_killed(report=run.report)]
    return "\n".join(f"- {line}" for line in lines), len(lines)


@_stage
def _soak(run: Run) -> Done:
    """Many recordings in one process."""
    return f"- {load.soak(run.options.soak, report=run.report)}", run.options.soak


@_stage
def _properties(run: Run) -> Done:
    """The property tests with more examples, at random."""
    times = run.options.property_times
    options = ["-q", "-p", "no:cacheprovider", "--hypothesis-show-statistics"]
    command = [sys.executable, "-m", "pytest", *options, str(TESTS / "faults" / "test_properties.py")]
    environment = os.environ | {"TOFMIX_TEST_EXAMPLES_TIMES": str(times)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=TESTS.parent)
    if done.returncode:
        run.report(done.stdout[-3000:])
    passing = sum(map(int, re.findall(r"(\d+) passing", done.stdout)))
    said = f"{times} times the examples of each property test: {passing} examples passed"
    return f"- {said}; {done.stdout.splitlines()[-1]}", passing


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--only", default=",".join(STAGES))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--mutants", type=int, default=5000)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--changes", type=int, default=120)
    parser.add_argument("--soak", type=int, default=1000)
    parser.add_argument("--property-times", type=int, default=20)
    parser.add_argument("--most-calls", type=int, default=12, help="0: all")
    parser.add_argument("--first-mutant", type=int, default=0, metavar="NUMBER")
    run = Run(parser.parse_args())
    run.folder.mkdir(parents=True, exist_ok=True)
    for name in run.options.only.split(","):
        path = run.folder / f"{name}.json"
        if not path.exists():
            print(f"== {name}", flush=True)
            path.write_text(json.dumps(run.stage(name)))
    total = 0
    for name, work in STAGES.items():
        path = run.folder / f"{name}.json"
        if path.exists():
            kept = json.loads(path.read_text())
            total += len(kept["faults"])
            print(f"\n### {name} ({kept['minutes']:.0f} min)\n\n{work.__doc__}\n\n{kept['text']}")
    print(f"\n{total} faults")
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
