"""A mutation study: the share of small faults in the package that the quick tests find, and that the whole suite finds.

Usage: PYTHONPATH=tests:. python -m mutation draw  --output DIR [--seed 20] [--count 150]
       PYTHONPATH=tests:. python -m mutation map   --output DIR [--earlier CHECKOUT] [--jobs 2]
       PYTHONPATH=tests:. python -m mutation run   --output DIR [--earlier CHECKOUT] [--jobs 2] [--first 150]
       PYTHONPATH=tests:. python -m mutation table --output DIR

Needs `pip install '.[test]' coverage`, and git. The checkout is never changed: everything happens in DIR.

`draw` writes DIR/mutants.json: changes of operators, comparisons and numbers, and removed statements.
`map` runs this checkout's whole suite once and notes which test runs which lines; with `--earlier`, the suite of
another checkout instead, on this checkout's package. Run it once for each.
`run` puts each mutant into a copy of the package, and runs the tests that may notice it, the quick ones first, until
one fails: the quick suite, the earlier suite if there is one, and the rest of the whole suite for what the earlier one
finds and the quick one does not (without an earlier one, for all that the quick one does not find). What the earlier
suite finds beyond the quick one is checked: the test must fail again, and must pass without the mutant. A test over 20
times its time ends as "hung", and counts as a failure. Where the tests of a suite take longer than `--budget` seconds,
the longest are left out, and counted. It goes on where it was stopped.
`table` prints the counts, and the mutants that the earlier suite finds and this one does not.

Tests are chosen by what they run (`mutation.follow`), and for compiled kernels, constants and classes, whose lines
coverage does not see, by what names them (`mutation.names`). Tests that read the package's source are always run.
"""

import argparse
import json
import queue
import shutil
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from mutation.coverage_map import CoverageMap, KnownTest, failed_once, gathered, not_followed
from mutation.draw import Mutant, draw
from mutation.names import Names
from mutation.slot import Ended, Slot, fingerprint

TOP = Path(__file__).parents[2]
LEFT_OUT_OF_QUICK = frozenset({"slow", "cluster", "browser", "faults"})
"""Marks of the tests that the README's line leaves out."""
_COMPILING_ALL_S = 240.0
"""What a test may take longer where kernels are compiled."""
_AT_LEAST = 3
"""So many tests are run whatever they take."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["draw", "map", "run", "table"])
    parser.add_argument("--output", type=Path, required=True, help="folder of the study")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--earlier", type=Path, help="another checkout, whose tests are compared with this one's")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--first", type=int, help="only so many of the mutants drawn")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of tests, for a mutant and suite")
    parser.add_argument("--again", action="store_true", help="map: only read again what the last run of tests noted")
    parser.add_argument("--tests", nargs="+", default=[], metavar="FILE", help="map: only these, to try things out")
    options = parser.parse_args()
    study = Study(options.output.resolve(), None if options.earlier is None else options.earlier.resolve())
    if options.what == "draw":
        study.draw(seed=options.seed, count=options.count)
    elif options.what == "map":
        study.map(jobs=options.jobs, tests=options.tests, again=options.again)
    elif options.what == "run":
        study.run(jobs=options.jobs, first=options.first, budget_s=options.budget)
    else:
        study.table()


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The tests to run, and how many of those that may notice are left out to save time."""

    tests: list[KnownTest]
    left_out: int


class Study:
    """A folder with mutants, maps and results."""

    def __init__(self, folder: Path, earlier: Path | None) -> None:
        self._folder = folder
        self._suites = {"ours": TOP} | ({} if earlier is None else {"earlier": earlier})
        self._kernels = folder / f"kernels-{fingerprint(TOP / 'tofmix')}"
        self._lock = threading.Lock()

    def draw(self, *, seed: int, count: int) -> None:
        """Write the mutants."""
        self._folder.mkdir(parents=True, exist_ok=True)
        mutants = [asdict(mutant) for mutant in draw(TOP, seed=seed, count=count)]
        (self._folder / "mutants.json").write_text(json.dumps(mutants, indent=1))
        print(f"{len(mutants)} mutants in {self._folder / 'mutants.json'}")

    def map(self, *, jobs: int, tests: Sequence[str], again: bool) -> None:
        """Run one suite, followed, unless that is done; and write its map."""
        suite = list(self._suites)[-1]
        slot = self._slot(0)
        slot.dress(suite)
        compiled = slot.folder / "kernels"
        followed = self._folder / f"followed-{suite}"
        if not again:
            shutil.rmtree(compiled, ignore_errors=True)
        if self._kernels.exists() and not compiled.exists():
            shutil.copytree(self._kernels, compiled)
        if not again:
            slot.map(followed, jobs, tests)
        failing = [test.id for test in failed_once(followed) if slot.run([test]).killed_by]
        found = gathered(followed, slot.checkout, Names(slot.checkout), failing)
        found.write(self._map_path(suite))
        if compiled.exists():
            shutil.rmtree(self._kernels, ignore_errors=True)
            compiled.rename(self._kernels)
        print(f"{suite}: {len(found.tests)} tests of {sum(test.seconds for test in found.tests):.0f} s")
        for test in not_followed(followed):
            print(f"left out, for its process did not end as it should: {test}")
        for test in failing:
            print(f"left out, for it fails on the unchanged package: {test}")

    def run(self, *, jobs: int, first: int | None, budget_s: float) -> None:
        """Test every mutant that has no result yet."""
        maps = {suite: self._map(suite) for suite in self._suites}
        names = Names(TOP)
        done = {result["number"] for result in self._results()}
        mutants = [mutant for mutant in self._mutants()[:first] if mutant.number not in done]
        if not self._kernels.exists():
            self._slot(0).compile_kernels().rename(self._kernels)
        slots: queue.Queue[Slot] = queue.Queue()
        for number in range(jobs):
            slots.put(self._slot(number))

        def test(mutant: Mutant) -> None:
            slot = slots.get()
            try:
                self._keep(_Trial(slot, mutant, maps, names, budget_s).result(self._kernels))
            finally:
                slots.put(slot)

        with ThreadPoolExecutor(jobs) as pool:
            for _ in pool.map(test, mutants):
                pass

    def table(self) -> None:
        """Print what was found."""
        results = self._results()
        suites = [suite for suite in ("earlier", "quick", "whole") if any(suite in result for result in results)]
        with_earlier = "earlier" in suites
        against = [result for result in results if result["earlier"]["killed_by"]] if with_earlier else results
        kinds = "found by the earlier suite" if with_earlier else "mutants"
        print(f"{len(results)} mutants\n")
        print(f"| suite | finds of {len(against)} {kinds} | share | misses with tests left out |\n|---|---|---|---|")
        for suite in suites:
            both = [result for result in against if result[suite]["killed_by"]]
            cut = sum(result[suite]["left_out"] > 0 for result in against if not result[suite]["killed_by"])
            print(f"| {suite} | {len(both)} | {100 * len(both) / max(1, len(against)):.1f} % | {cut} |")
        if with_earlier:
            beyond = [result for result in results if result not in against]
            cut = sum(result["earlier"]["left_out"] > 0 for result in beyond)
            quick = sum(result["quick"]["killed_by"] is not None for result in beyond)
            print(f"\nThe earlier suite misses {len(beyond)}, {cut} of them with tests left out; quick finds {quick}.")
        for suite in [suite for suite in suites if suite != "earlier"]:
            missed = [result for result in against if not result[suite]["killed_by"]]
            print(f"\n{len(missed)} of them not found by {suite}:")
            for result in missed:
                _print_missed(result)
        escaped = [result for result in results if not any(result[suite]["killed_by"] for suite in suites)]
        print(f"\n{len(escaped)} found by none: " + ", ".join(f"{r['file']}:{r['line']}" for r in escaped))

    def _slot_path(self, number: int) -> Path:
        return self._folder / f"slot{number}" / "checkout"

    def _slot(self, number: int) -> Slot:
        return Slot(self._folder / f"slot{number}", self._suites)

    def _map_path(self, suite: str) -> Path:
        return self._folder / f"map-{suite}-{fingerprint(self._suites[suite] / 'tests')}.json"

    def _map(self, suite: str) -> CoverageMap:
        """A suite's map; if it was made with another package, without the tests that no longer can be collected."""
        found = CoverageMap.read(self._map_path(suite))
        if found.is_of(TOP):
            return found
        slot = self._slot(0)
        slot.dress(suite)
        collected = slot.collected()
        gone = frozenset(test.id for test in found.tests) - collected
        print(f"{suite}: mapped with another package; {len(gone)} of {len(found.tests)} tests cannot be collected now")
        return replace(found.for_package(TOP), gone=gone)

    def _mutants(self) -> list[Mutant]:
        return [Mutant(**values) for values in json.loads((self._folder / "mutants.json").read_text())]

    def _results(self) -> list[dict[str, Any]]:
        path = self._folder / "results.jsonl"
        results = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
        return sorted(results, key=lambda result: result["number"])

    def _keep(self, result: dict[str, Any]) -> None:
        with self._lock, (self._folder / "results.jsonl").open("a") as file:
            file.write(json.dumps(result) + "\n")
        said = ", ".join(
            f"{suite}: {result[suite]['how']} {result[suite]['seconds']:.0f} s"
            for suite in ("quick", "earlier", "whole")
            if suite in result
        )
        print(f"{result['number']:4d} {result['file']}:{result['line']} {result['kind']}: {said}", flush=True)


class _Trial:
    """One mutant, in one slot, against every suite."""

    def __init__(self, slot: Slot, mutant: Mutant, maps: dict[str, CoverageMap], names: Names, budget_s: float) -> None:
        self._slot, self._mutant, self._maps, self._names, self._budget_s = slot, mutant, maps, names, budget_s
        self._source = (slot.checkout / mutant.file).read_bytes()

    def result(self, kernels: Path) -> dict[str, Any]:
        """Run the quick tests, the earlier ones, and the rest of ours where it is in question."""
        about = {"number": self._mutant.number, "kind": self._mutant.kind, "file": self._mutant.file}
        found: dict[str, Any] = {"line": self._mutant.line, "diff": self._mutant.diff(self._source)}
        with self._slot.changed(self._mutant, self._names, kernels) as compiling_s:
            ours = self._noticing("ours")
            choice = self._choice([test for test in ours if not LEFT_OUT_OF_QUICK & set(test.marks)])
            self._slot.dress("ours")
            quick = self._slot.run(choice.tests, compiling_s=compiling_s)
            found["quick"] = found["whole"] = _entry(quick, choice)
            earlier: Ended | None = None
            if "earlier" in self._maps:
                choice = self._choice(self._noticing("earlier"), first=[quick.killed_by], last=quick.passed)
                self._slot.dress("earlier")
                earlier = self._slot.run(choice.tests, compiling_s=compiling_s)
                found["earlier"] = _entry(earlier, choice)
                if earlier.killed_by and quick.killed_by is None and not self._fails(earlier, compiling_s):
                    found["earlier"] |= {"killed_by": None, "how": "fails now and then"}
            if quick.killed_by is None and (earlier is None or found["earlier"]["killed_by"]):
                rest = [test for test in ours if test.id not in set(quick.passed)]
                choice = self._choice(rest, first=[earlier.killed_by if earlier else None])
                self._slot.dress("ours")
                found["whole"] = _entry(self._slot.run(choice.tests, compiling_s=compiling_s), choice)
        doubtful = quick.killed_by is None and found.get("earlier", {}).get("killed_by") not in {None, "import"}
        if earlier is not None and doubtful:
            self._slot.dress("earlier")
            if self._fails(earlier, _COMPILING_ALL_S):
                found["earlier"] |= {"killed_by": None, "how": "fails without the mutant"}
        self._slot.dress("ours")
        return about | found

    def _fails(self, ended: Ended, compiling_s: float) -> bool:
        """Whether the test that found the mutant fails by itself, in the package as it is now."""
        tests = [test for test in self._maps["earlier"].tests if test.id == ended.killed_by]
        return not tests or self._slot.run(tests, compiling_s=compiling_s).killed_by is not None

    def _noticing(self, suite: str) -> list[KnownTest]:
        return self._maps[suite].noticing(self._mutant, self._names, self._source)

    def _choice(self, tests: list[KnownTest], first: Iterable[str | None] = (), last: Iterable[str] = ()) -> Choice:
        """As many of the tests as the time allows, `first` before all others, and `last` after them."""
        places = dict.fromkeys(last, 2) | dict.fromkeys(first, 0)
        ordered = sorted(tests, key=lambda test: places.get(test.id, 1))
        chosen: list[KnownTest] = []
        seconds = 0.0
        for test in ordered:
            if len(chosen) < _AT_LEAST or seconds + test.seconds <= self._budget_s:
                chosen.append(test)
                seconds += test.seconds
        return Choice(tests=chosen, left_out=len(ordered) - len(chosen))


def _print_missed(result: dict[str, Any]) -> None:
    """Print a mutant with what somebody needs who adds a test."""
    print(f"\n{result['file']}:{result['line']} (mutant {result['number']}, {result['kind']})")
    if "earlier" in result:
        print(f"    found by {result['earlier']['killed_by']} ({result['earlier']['how']})")
    print("\n".join(f"    {line}" for line in result["diff"].splitlines()[2:]))


def _entry(ended: Ended, choice: Choice) -> dict[str, Any]:
    return {
        "killed_by": ended.killed_by,
        "how": ended.how,
        "seconds": ended.seconds,
        "tests": len(choice.tests),
        "left_out": choice.left_out,
    }


if __name__ == "__main__":
    main()
