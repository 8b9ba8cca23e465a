"""What a first and a later run take: two states of the package side by side.

Usage: python tests/benchmarks/start_up.py [--before COMMIT] [--rounds 3] [--later 5] [--check]

COMMIT is the commit before the change to first runs, unless another one is given; the other state is this checkout as
it is. Both are copied to a temporary folder, so nothing that either has compiled before counts. In each round both take
turns at each job, every one in a process of its own:

- first: an estimate with an empty folder of compiled kernels;
- kept: the same in a new copy of the package, whose kernels another one has compiled;
- later: an estimate with all kernels there;
- `tofmix --help` and `import tofmix`.

Prints CPU and wall-clock time, least and median of the rounds, and their ratios; then the CPU time of compiling each
kernel that Python calls, on one processor, and of the imports of a later run. The layers must be the same arrays.
With --check, ends with 1 where a ratio is above its bound. docs/results/performance.md has it in short.
"""

import argparse
import json
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

TOP = Path(__file__).parents[2]
BEFORE = "94252c5f"
"""The last commit at which numba's own cache kept the kernels."""

RECORDINGS = ("three_boards.h5", "tmf8829_edge.h5")
BOUNDS = {
    ("three_boards.h5", "first"): (0.6, 0.5),
    ("three_boards.h5", "kept"): (0.1, 0.1),
    ("three_boards.h5", "later"): (0.65, 0.65),
    ("tmf8829_edge.h5", "first"): (0.7, 0.7),
    ("tmf8829_edge.h5", "later"): (1.0, 1.0),
    ("", "--help"): (1.0, 1.0),
    ("", "import"): (1.0, 1.0),
}
"""Largest ratios of CPU and wall-clock time, by the recording and the job; on two processors."""

PACKAGES = ("click", "h5py", "numba", "numpy", "scipy", "tofmix", "tqdm")
"""Packages that have rows of their own in the table of imports."""

TOLERANCE = 0.03
"""What a ratio of 1 may be exceeded by: the clock of a shared machine is no better."""

COMPILING = """
import json, sys, time
from numba.core.dispatcher import Dispatcher
spent, inner = {}, [0.0]
compile_of = Dispatcher.compile
def timed(self, sig):
    start = time.process_time()
    outer, inner[0] = inner[0], 0.0
    try:
        return compile_of(self, sig)
    finally:
        whole = time.process_time() - start
        name = f"{self.py_func.__module__.removeprefix('tofmix.')}.{self.py_func.__name__}"
        spent[name] = spent.get(name, 0.0) + whole - inner[0]
        inner[0] = outer + whole
Dispatcher.compile = timed
from tofmix.cli.start import run
try:
    run()
finally:
    print(json.dumps(spent), file=open(RESULT, "w"))
"""


@dataclass(slots=True, kw_only=True)
class Times:
    """CPU and wall-clock times of one job, s."""

    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)


class State:
    """One state of the package, in folders of its own.

    `name`: for the tables.
    `origin`: a checkout.
    `folder`: where copies go.
    """

    def __init__(self, name: str, origin: Path, folder: Path) -> None:
        self.name, self._origin, self._folder = name, origin, folder
        self._number = 0
        self.copy = self._new_copy()

    def _new_copy(self) -> Path:
        self._number += 1
        copy = self._folder / f"{self.name}-{self._number}"
        shutil.copytree(self._origin / "tofmix", copy / "tofmix", ignore=shutil.ignore_patterns("__pycache__"))
        return copy

    def _environment(self, kernels: Path) -> dict[str, str]:
        hidden = ("NUMBA_", "TOFMIX_", "PYTHON")
        kept = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
        nowhere = str(self._folder / "no-cache")
        return kept | {
            "PYTHONPATH": str(self.copy),
            "NUMBA_CACHE_DIR": str(kernels),
            "XDG_CACHE_HOME": nowhere,
            "HOME": nowhere,
        }

    def take(self, times: Times | None, kernels: Path, *arguments: str) -> str:
        """Run Python with these arguments; return its standard error."""
        begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [sys.executable, "-P", *arguments],
            env=self._environment(kernels),
            cwd=self._folder,
            capture_output=True,
            text=True,
            check=True,
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if times is not None:
            times.wall.append(time.perf_counter() - begun)
            times.cpu.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
        return done.stderr

    def estimate(self, recording: Path) -> tuple[str, ...]:
        """Arguments of an estimate of a recording."""
        output = self._folder / f"{self.name}.layers.h5"
        return "-m", "tofmix", "estimate", str(recording), "-o", str(output), "--overwrite"

    def layers(self) -> dict[str, np.ndarray]:
        """Arrays of the last layers."""
        found: dict[str, np.ndarray] = {}
        with h5py.File(self._folder / f"{self.name}.layers.h5") as file:
            for name, item in file.items():
                if isinstance(item, h5py.Dataset):
                    found[name] = item[...]
        return found

    def move(self) -> None:
        """Go on with a new copy, whose byte code and kernels are not there."""
        shutil.rmtree(self.copy)
        self.copy = self._new_copy()


def measure(states: tuple[State, State], rounds: int, later: int, folder: Path) -> dict[tuple[str, str], list[Times]]:
    """Times of each job of both states, by the recording and the job."""
    found: dict[tuple[str, str], list[Times]] = defaultdict(lambda: [Times(), Times()])
    for number in range(rounds):
        for name in RECORDINGS:
            recording = TOP / "sample_data" / name
            for i, state in enumerate(states):
                kernels = folder / f"kernels-{state.name}-{number}-{name}"
                state.take(found[name, "first"][i], kernels, *state.estimate(recording))
                for _ in range(later):
                    state.take(found[name, "later"][i], kernels, *state.estimate(recording))
                state.move()
                state.take(found[name, "kept"][i], kernels, *state.estimate(recording))
                shutil.rmtree(kernels)
            both = states[0].layers(), states[1].layers()
            assert both[0].keys() == both[1].keys(), name
            differing = [key for key in both[0] if both[0][key].tobytes() != both[1][key].tobytes()]
            assert not differing, (name, differing)
        for _ in range(later):
            for i, state in enumerate(states):
                state.take(found["", "--help"][i], folder, "-m", "tofmix", "--help")
                state.take(found["", "import"][i], folder, "-c", "import tofmix")
    return found


def compiling(state: State, recording: Path, folder: Path) -> dict[str, float]:
    """CPU time, s, of each kernel that Python calls, in a first run on one processor."""
    result, kernels = folder / f"{state.name}.json", folder / f"kernels-{state.name}-roots"
    script = folder / f"{state.name}.py"
    script.write_text(f"RESULT = {str(result)!r}\n{COMPILING}")
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        state.take(None, kernels, str(script), *state.estimate(recording)[2:])
    finally:
        os.sched_setaffinity(0, before)
        shutil.rmtree(kernels, ignore_errors=True)
    spent: dict[str, float] = json.loads(result.read_text())
    return {name: seconds for name, seconds in spent.items() if seconds > 0.02}


def imports(state: State, recording: Path, folder: Path) -> dict[str, float]:
    """Time, s, of the imports of a later run, by package."""
    kernels = folder / f"kernels-{state.name}-imports"
    state.take(None, kernels, *state.estimate(recording))
    told = state.take(None, kernels, "-X", "importtime", *state.estimate(recording))
    spent: dict[str, float] = defaultdict(float)
    for own, module in re.findall(r"import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)", told):
        top = module.split(".")[0]
        spent[top if top in PACKAGES else "others"] += int(own) / 1e6
    return dict(spent)


def beside(title: str, tables: tuple[dict[str, float], dict[str, float]]) -> None:
    """Print two columns of times, the largest first."""
    print(f"\n| {title} | before, s | now, s |\n|---|---|---|")
    names = sorted(set(tables[0]) | set(tables[1]), key=lambda name: -max(table.get(name, 0.0) for table in tables))
    for name in names:
        cells = (f"{table[name]:.2f}" if name in table else "" for table in tables)
        print(f"| {name} | {' | '.join(cells)} |")
    print(f"| sum | {sum(tables[0].values()):.2f} | {sum(tables[1].values()):.2f} |")


def report(found: dict[tuple[str, str], list[Times]]) -> bool:
    """Print the times; return whether all ratios are within their bounds."""
    print("| job | CPU before, s | CPU now, s | ratio | wall before, s | wall now, s | ratio |")
    print("|---|---|---|---|---|---|---|")
    holds = True
    for (recording, job), (before, now) in found.items():
        cells = []
        for kind, bound in zip(("cpu", "wall"), BOUNDS.get((recording, job), (np.inf, np.inf)), strict=True):
            old, new = getattr(before, kind), getattr(now, kind)
            ratio = min(new) / min(old)
            holds &= ratio <= bound + (TOLERANCE if bound == 1.0 else 0.0)
            cells += [f"{min(times):.2f} ({statistics.median(times):.2f})" for times in (old, new)]
            cells += [f"{ratio:.2f}" + ("" if np.isinf(bound) else f" (at most {bound:g})")]
        print(f"| {job} {recording} | {' | '.join(cells)} |")
    return holds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", default=BEFORE)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--later", type=int, default=5)
    parser.add_argument("--check", action="store_true")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        earlier = folder / "earlier"
        git = shutil.which("git") or "git"
        subprocess.run([git, "clone", "--quiet", str(TOP), str(earlier)], check=True)
        subprocess.run([git, "checkout", "--quiet", chosen.before], cwd=earlier, check=True)
        states = State("before", earlier, folder), State("now", TOP, folder)
        print("Seconds, the least (and the median); kept: compiled by another copy of the package.\n")
        holds = report(measure(states, chosen.rounds, chosen.later, folder))
        for name in RECORDINGS:
            recording = TOP / "sample_data" / name
            found = [compiling(state, recording, folder) for state in states]
            beside(f"compiled for {name}", (found[0], found[1]))
        recording = TOP / "sample_data" / RECORDINGS[0]
        found = [imports(state, recording, folder) for state in states]
        beside("imports of a later run", (found[0], found[1]))
    if chosen.check and not holds:
        sys.exit(1)


if __name__ == "__main__":
    main()
