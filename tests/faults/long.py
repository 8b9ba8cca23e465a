"""The long run: every kind of fault, load and property, with counts.

Usage: python -m faults.long --output FOLDER [--only STAGE,...] [--mutants 5000] [--guided 600] [--processes 2], with
`tests` and the package on PYTHONPATH. It can be stopped and started again: what is done is kept in FOLDER. It
prints what it finds as it goes, and at the end the tables of all that has been run; it leaves with 1 if there are
faults.
"""

import argparse
import importlib.util
import json
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeAlias

from faults import disk, load
from faults.changing import changing
from faults.fuzz import Fuzz, Verdict, table
from faults.inject import CASES, FAILURES, Injection, Tally, compiled, inputs_into, with_shim
from faults.inject import table as injection_table
from faults.originals import make
from faults.pool import Job, Outcome, Pool

TESTS = Path(__file__).parents[1]
_BATCH = 250

Stage: TypeAlias = Callable[["Run"], str]
STAGES: dict[str, Stage] = {}
"""What is run, in its order; each returns Markdown."""


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


def _stage(work: Stage) -> Stage:
    STAGES[work.__name__.strip("_").replace("_", " ")] = work
    return work


@_stage
def _mutants(run: Run) -> str:
    """Mutants through the commands that read them."""
    path = run.folder / "mutants.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    verdicts = [_verdict(json.loads(line)) for line in lines]
    done = len({verdict.mutant for verdict in verdicts}) // _BATCH * _BATCH  # a batch that was broken off begins anew
    verdicts = [verdict for verdict in verdicts if int(verdict.mutant.split()[-1]) < done]
    path.write_text("".join(json.dumps(asdict(verdict)) + "\n" for verdict in verdicts))
    with tempfile.TemporaryDirectory(prefix="originals-") as name, Pool(run.options.processes) as pool:
        originals = make(Path(name), pool)
        fuzz = Fuzz(Path(name), pool, originals)
        fuzz.check_originals()
        while done < run.options.mutants:
            found = list(fuzz.run(list(originals), _BATCH, seed=done, commands=2))
            with path.open("a") as file:
                file.writelines(json.dumps(asdict(verdict)) + "\n" for verdict in found)
            verdicts += found
            done += _BATCH
            print(f"{done} mutants, {sum(bool(verdict.fault) for verdict in verdicts)} faults", flush=True)
    for verdict in verdicts:
        if verdict.fault:
            run.report(f"{verdict.fault}: {verdict.mutant}: {verdict.command}: {verdict.change}: {verdict.outcome.err}")
    return f"{done} mutants\n\n{table(verdicts)}"


def _verdict(values: dict[str, Any]) -> Verdict:
    return Verdict(**values | {"outcome": Outcome(**values["outcome"])})


def _with_shim(work: Callable[[Injection], list[Tally]]) -> str:
    with tempfile.TemporaryDirectory(prefix="originals-") as name:
        library = compiled(Path(name))
        if library is None:
            return "not run: no C compiler"
        with Pool(1, with_shim(library)) as pool:
            make(Path(name), pool)
            tallies = work(Injection(Path(name), pool))
    return injection_table(tallies)


@_stage
def _failing_calls(run: Run) -> str:
    """The N-th call of each kind fails, for N = 1, 2, ... until the run succeeds."""
    tallies: list[Tally] = []
    for case in CASES:
        path = run.folder / f"failing {case}.json"
        if not path.exists():

            def work(injection: Injection, case: str = case, path: Path = path) -> list[Tally]:
                found = []
                for failure in FAILURES:
                    # Allocations are many, and alike: at most some hundred of them.
                    step = run.options.allocation_step if failure.startswith("alloc") else 1
                    found.append(injection.run(case, failure, step=step, report=print))
                path.write_text(json.dumps([asdict(tally) for tally in found]))
                return found

            print(_with_shim(work), flush=True)
        if path.exists():
            tallies += [Tally(**values) for values in json.loads(path.read_text())]
    return _counted(run, tallies)


def _counted(run: Run, tallies: list[Tally]) -> str:
    for tally in tallies:
        for fault in tally.faults:
            run.report(f"{tally.case}: {tally.failure}: {fault}")
    return injection_table(tallies) if tallies else "not run: no C compiler"


@_stage
def _kills(run: Run) -> str:
    """Signals at random moments of the work."""
    chance = random.Random(1)  # noqa: S311  no secret
    tallies = []
    with tempfile.TemporaryDirectory(prefix="originals-") as name, Pool(1) as pool:
        make(Path(name), pool)
        injection = Injection(Path(name), pool)
        share = run.options.kills // len(CASES)
        for case in CASES:
            count = share * 4 if case == "estimate" else share
            for number in (9, 2, 15):
                moments = [chance.random() for _ in range(count if number == 9 else count // 4)]
                tallies.append(injection.kill(case, moments, number=number, report=lambda _: None))
    return _counted(run, tallies)


@_stage
def _full_disks(run: Run) -> str:
    """`ulimit -f`, a disk of 8 MB with little room, and a disk that is read-only."""
    tallies, lines = [], []
    with tempfile.TemporaryDirectory(prefix="originals-") as name, Pool(1) as pool:
        make(Path(name), pool)
        injection = Injection(Path(name), pool)
        sizes = [4096, *range(8192, 120_000, 7000)]
        tallies += [injection.limit(case, sizes, report=lambda _: None) for case in CASES]
        place = Path(name) / "disk"
        with disk.small_disk(place) as mounted:
            if mounted is not None:
                free = range(0, 200_000, 12_288)
                tallies += [injection.fill(case, mounted, free, report=lambda _: None) for case in CASES]
                lines.append(_read_only(run, Path(name), mounted, pool))
            else:
                lines.append("no disk could be mounted: neither the full nor the read-only one was run")
    return "\n\n".join([_counted(run, tallies), *lines])


def _read_only(run: Run, originals: Path, place: Path, pool: Pool) -> str:
    inputs_into(originals, place)
    disk.make_read_only(place)
    codes = Counter[int]()
    for case in CASES.values():
        outcome = pool.run(Job(argv=tuple(case.command.split()), cwd=str(place)))
        codes[outcome.code] += 1
        if outcome.code != 4 or "Read-only file system" not in outcome.err:
            run.report(f"read-only disk: {case.command}: {outcome.code} {outcome.err}")
    return f"a read-only disk: {sum(codes.values())} commands, exit codes {dict(codes)}"


@_stage
def _changing_recordings(run: Run) -> str:
    """A recording that is written to while it is read."""
    with Pool(1) as pool:
        counts = changing(pool, run.options.changes, report=run.report)
    return "\n".join(
        ["| a recording changed while it is read | |", "|---|---|", *(f"| {k} | {n} |" for k, n in counts.items())]
    )


@_stage
def _loads(run: Run) -> str:
    """Concurrent runs, declared sizes, a cluster's worker killed."""
    with Pool(1) as pool:
        lines = load.huge(pool, report=run.report)
    return "\n".join(
        f"- {line}" for line in (load.side_by_side(8, report=run.report), *lines, load.worker_killed(report=run.report))
    )


@_stage
def _soak(run: Run) -> str:
    """Many recordings in one process."""
    return f"- {load.soak(run.options.soak, report=run.report)}"


@_stage
def _properties(run: Run) -> str:
    """The property tests with more examples, at random."""
    times = run.options.property_times
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        str(TESTS / "faults" / "test_properties.py"),
    ]
    environment = os.environ | {"TOFMIX_TEST_EXAMPLES_TIMES": str(times)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=TESTS.parent)
    if done.returncode:
        run.report(done.stdout[-3000:])
    return f"- {times} times the examples of each property test: {done.stdout.splitlines()[-1]}"


@_stage
def _guided(run: Run) -> str:
    """Coverage-guided fuzzing of the readers."""
    seconds = run.options.guided
    if importlib.util.find_spec("atheris") is None:
        return "- not run: atheris is not installed (`pip install atheris`)"
    command = [sys.executable, "-m", "faults.guided", str(seconds), str(run.folder / "guided")]
    done = subprocess.run(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, check=False)
    (run.folder / "guided.log").write_text(done.stderr)
    last = [line for line in done.stderr.splitlines() if line.startswith("#")][-1:] or ["nothing"]
    if done.returncode:
        run.report(f"guided: {done.stderr[-2000:]}")
    return f"- {seconds} s: {' '.join(last[0].split())}; inputs that broke a reader: {int(bool(done.returncode))}"


def main() -> int:
    """Run what has not been run, and print all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--only", default=",".join(STAGES))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--mutants", type=int, default=5000)
    parser.add_argument("--guided", type=int, default=600, metavar="SECONDS")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--changes", type=int, default=120)
    parser.add_argument("--soak", type=int, default=1000)
    parser.add_argument("--property-times", type=int, default=20)
    parser.add_argument("--allocation-step", type=int, default=1)
    run = Run(parser.parse_args())
    run.folder.mkdir(parents=True, exist_ok=True)
    for name in run.options.only.split(","):
        path = run.folder / f"{name}.json"
        if not path.exists():
            before = len(run.faults)
            print(f"== {name}", flush=True)
            path.write_text(json.dumps({"text": STAGES[name](run), "faults": run.faults[before:]}))
    total = 0
    for name, work in STAGES.items():
        path = run.folder / f"{name}.json"
        if path.exists():
            kept = json.loads(path.read_text())
            total += len(kept["faults"])
            print(f"\n### {name}\n\n{work.__doc__}\n\n{kept['text']}")
    print(f"\n{total} faults")
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
