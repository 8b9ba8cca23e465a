"""A mutation study: the share of small faults in the package that the quick tests find, and that the whole suite finds.

Usage: PYTHONPATH=tests:. python -m mutation draw  --output DIR [--seed 20] [--count 150]
       PYTHONPATH=tests:. python -m mutation map   --output DIR [--earlier CHECKOUT] [--jobs 2]
       PYTHONPATH=tests:. python -m mutation run   --output DIR [--earlier CHECKOUT] [--budget 120]
       PYTHONPATH=tests:. python -m mutation table --output DIR

Needs `pip install '.[test]' coverage`, and git. The checkout is never changed: everything happens in DIR.

`draw` writes DIR/mutants.json: changes of operators, comparisons and numbers, and removed statements. `map` runs this
checkout's whole suite once and notes which test runs which lines; with `--earlier`, the suite of another checkout too,
on this checkout's package. `run` puts each mutant into a copy of the package, and runs the tests that run its line,
those of its own folder first, until one fails: the quick suite, the whole one for what the quick one does not find, and
the earlier one for what neither finds. A suite that takes more than `--budget` seconds misses the mutant; one that
hangs does too. It goes on where it was stopped. `table` prints the counts, and the mutants that a suite misses.

Coverage sees neither the lines of compiled kernels nor, for a single test, what runs at import: for a change there, the
tests are those that run a line of the modules that import it, directly or through others.
"""

import argparse
import ast
import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mutation.draw import Mutant, draw

TOP = Path(__file__).parents[2]
QUICK = "not (slow or cluster or browser or faults)"
Lines = dict[str, dict[int, list[str]]]
"""The tests that run each line of each file."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["draw", "map", "run", "table"])
    parser.add_argument("--output", type=Path, required=True, help="folder of the study")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--earlier", type=Path, help="another checkout, whose tests are compared with this one's")
    parser.add_argument("--jobs", type=int, default=2, help="processes of map")
    parser.add_argument("--budget", type=float, default=120.0, help="seconds of tests, for a mutant and suite")
    parser.add_argument("--tests", nargs="+", default=[], metavar="FILE", help="map: only these, to try things out")
    options = parser.parse_args()
    folder, mutants = options.output.resolve(), options.output.resolve() / "mutants.json"
    suites = {"ours": TOP} | ({} if options.earlier is None else {"earlier": options.earlier.resolve()})
    if options.what == "draw":
        folder.mkdir(parents=True, exist_ok=True)
        drawn = draw(TOP, seed=options.seed, count=options.count)
        mutants.write_text(json.dumps([asdict(mutant) for mutant in drawn], indent=1))
    elif options.what == "map":
        for name, top in suites.items():
            lines = follow(folder, top, options.jobs, options.tests)
            (folder / f"map-{name}.json").write_text(json.dumps(lines))
    elif options.what == "run":
        done = {result["number"] for result in results(folder)}
        for mutant in (Mutant(**values) for values in json.loads(mutants.read_text())):
            if mutant.number not in done:
                result = asdict(mutant) | found_by(folder, suites, mutant, options.budget)
                with (folder / "results.jsonl").open("a") as file:
                    file.write(json.dumps(result) + "\n")
                print(f"{mutant.number:4d} {mutant.file}:{mutant.at} {mutant.kind}: {result['found']}", flush=True)
    else:
        table(results(folder))


def dressed(folder: Path, suite: Path) -> Path:
    """Return a copy of this checkout's package, at the same path in every run, with the tests of a suite beside it.

    numba finds compiled kernels by the path.
    """
    copy = folder / "checkout"
    shutil.rmtree(copy, ignore_errors=True)
    for top, parts in ((suite, ["."]), (TOP, ["tofmix"])):
        shutil.rmtree(copy / "tofmix", ignore_errors=True)
        command = ["git", "-C", str(top), "ls-files", "-z", "--cached", "--others", "--exclude-standard", *parts]
        for name in subprocess.run(command, capture_output=True, check=True, text=True).stdout.split("\0"):
            if name and (top / name).is_file():
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(top / name, copy / name)
    shutil.rmtree(copy / "tests" / "mutation", ignore_errors=True)
    shutil.copytree(Path(__file__).parent, copy / "tests" / "mutation")
    return copy


def environment(folder: Path, **more: str) -> dict[str, str]:
    """Return the environment in which tests run."""
    checkout = folder / "checkout"
    path = f"{checkout}{os.pathsep}{checkout / 'tests'}"
    ours = {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder / "kernels"), "NUMBA_NUM_THREADS": "1"}
    return os.environ | ours | more


def follow(folder: Path, suite: Path, jobs: int, tests: list[str]) -> Lines:
    """Run a whole suite on this checkout's package; return which test runs which lines."""
    from coverage import CoverageData  # of the extra `dev`; the tests of this module do without

    copy, data = dressed(folder, suite), folder / "followed"
    shutil.rmtree(data, ignore_errors=True)
    data.mkdir()
    (folder / "coveragerc").write_text(
        f"[run]\nparallel = true\npatch = subprocess, _exit\nsource = {copy / 'tofmix'}\ndata_file = {data / 'data'}\n"
        "context = ${PYTEST_CURRENT_TEST-}\n"
    )
    command = [sys.executable, "-m", "coverage", "run", f"--rcfile={folder / 'coveragerc'}", "-m", "pytest", "-q"]
    command += ["-p", "mutation.follow", "-p", "no:cacheprovider", "-n", str(jobs), "--dist", "worksteal", *tests]
    subprocess.run(command, cwd=copy, env=environment(folder), check=False)
    found: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
    for part in data.iterdir():
        read = CoverageData(str(part))
        read.read()
        for file in read.measured_files():
            for line, contexts in read.contexts_by_lineno(file).items():
                names = {re.sub(r" \(\w+\)$", "", name) for context in contexts for name in context.split("|")}
                found[Path(file).relative_to(copy).as_posix()][line] |= names - {""}
    return {file: {line: sorted(tests) for line, tests in lines.items()} for file, lines in found.items()}


def found_by(folder: Path, suites: dict[str, Path], mutant: Mutant, budget_s: float) -> dict[str, str | None]:
    """Try a mutant: which suite finds it ("quick", "whole", "earlier" or "none"), and the last lines of its output."""
    above = importers(TOP)
    for suite, top in suites.items():
        lines = json.loads((folder / f"map-{suite}.json").read_text())
        tests = noticing({file: {int(k): v for k, v in of.items()} for file, of in lines.items()}, mutant, above)
        copy = dressed(folder, top)
        path = copy / mutant.file
        path.write_text(mutant.applied(path.read_text()))
        kernels = folder / "kernels"
        if kernels.exists() and not (folder / "unchanged").exists():
            kernels.rename(folder / "unchanged")
        shutil.rmtree(kernels, ignore_errors=True)
        modules = [module_of(file) for file in [mutant.file, *reached(mutant.file, above)]]
        if (folder / "unchanged").exists():
            command = [sys.executable, "-m", "mutation.kernels", str(folder / "unchanged"), *modules]
            # Without the copy, every kernel is compiled again: slower, and as right.
            subprocess.run(command, env=environment(folder), cwd=folder, capture_output=True, check=False)
        for marks in (QUICK, f"not ({QUICK})"):
            said = run(folder, tests, marks, budget_s)
            if said is not None:
                return {"found": suite if suite != "ours" else "quick" if marks == QUICK else "whole", "said": said}
    return {"found": "none", "said": None}


def run(folder: Path, tests: list[str], marks: str, budget_s: float) -> str | None:
    """Run tests in their order until one fails; return what pytest says of it, None if all pass in time."""
    (folder / "chosen").write_text("\n".join(tests))
    files = [file for file in dict.fromkeys(t.split("::")[0] for t in tests) if (folder / "checkout" / file).exists()]
    if not files:
        return None
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-m", marks, "-p", "mutation.follow", "--tb=line"]
    command += ["-p", "no:cacheprovider", *files]
    try:
        done = subprocess.run(
            command,
            cwd=folder / "checkout",
            env=environment(folder, MUTATION_CHOSEN=str(folder / "chosen")),
            capture_output=True,
            text=True,
            timeout=budget_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None
    return None if done.returncode in {0, 5} else "\n".join(done.stdout.splitlines()[-3:])  # 5: none is collected


def noticing(lines: Lines, mutant: Mutant, above: dict[str, set[str]]) -> list[str]:
    """Return the tests that may notice a mutant, those of its own folder first."""
    known = lines.get(mutant.file, {})
    tests = {test for line in range(mutant.line, mutant.end_line + 1) for test in known.get(line, [])}
    for file in [] if tests else [mutant.file, *reached(mutant.file, above)]:
        tests |= {test for of in lines.get(file, {}).values() for test in of}
    folder = Path(mutant.file).parts[1:-1]
    return sorted(tests, key=lambda test: (Path(test.split("::")[0]).parts[1:-1] != folder, test))


def importers(top: Path) -> dict[str, set[str]]:
    """Return which files of the package import each of its files."""
    files = [path.relative_to(top) for path in (top / "tofmix").rglob("*.py")]
    known = {module_of(file.as_posix()): file.as_posix() for file in files}
    found: dict[str, set[str]] = defaultdict(set)
    for file in files:
        for node in ast.walk(ast.parse((top / file).read_bytes())):
            if isinstance(node, ast.ImportFrom):
                names = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
            else:
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in set(names) & known.keys():
                found[known[name]].add(file.as_posix())
    return found


def reached(file: str, above: dict[str, set[str]]) -> list[str]:
    """Return all files that import a file, directly or through others, the nearest first."""
    found = dict.fromkeys([file])
    for one in (queue := [file]):
        queue += [new for new in sorted(above[one]) if new not in found]
        found |= dict.fromkeys(above[one])
    return list(found)[1:]


def module_of(file: str) -> str:
    """Return the name of a file's module."""
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def results(folder: Path) -> list[dict[str, Any]]:
    """Return the results so far."""
    path = folder / "results.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def table(found: list[dict[str, Any]]) -> None:
    """Print the counts, and what is missed."""
    known = [result for result in found if result["found"] != "none"]
    print(f"{len(found)} mutants, {len(known)} found by a suite\n\n| suite | finds | share |\n|---|---|---|")
    for suite, by in (("quick", {"quick"}), ("whole", {"quick", "whole"})):
        count = sum(result["found"] in by for result in known)
        print(f"| {suite} | {count} | {100 * count / max(1, len(known)):.1f} % |")
    for result in found:
        if result["found"] != "quick":
            print(f"\n{result['found']}: {result['file']}:{result['at']} ({result['kind']})")
            print(f"-{result['old'].rstrip()}\n+{result['new'].rstrip()}\n{result['said'] or ''}")


if __name__ == "__main__":
    main()
