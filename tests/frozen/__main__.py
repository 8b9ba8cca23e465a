"""Hold the results of this checkout's package against those of an earlier commit, on the same machine.

Usage: PYTHONPATH=tests:. python -m frozen REV --output DIR [--only NAME,...]
       PYTHONPATH=tests:. python -m frozen --store

The first run with a commit makes its reference in DIR: inputs and all that its commands write. Later runs read it. Each
difference is a line; exit code 6 if there are any. The cases are this checkout's (`frozen.cases`), for both packages.
The processors of other machines differ in the last bits: there a reference is made anew.

`--store` writes `stored.json`, a few small cases whose values every machine has to 1e-6, anew from this checkout; the
quick tests read it.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from frozen import stored
from frozen.cases import CASES
from frozen.difference import differences
from frozen.outcome import load, run_case, save, write_inputs

TOP = Path(__file__).parents[2]
DIFFERENT = 6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rev", nargs="?", help="commit to compare with")
    parser.add_argument("--output", type=Path, help="folder of references, outside of the checkout")
    parser.add_argument("--only", default=",".join(CASES), help="cases, with commas between")
    parser.add_argument("--store", action="store_true", help="write stored.json")
    parser.add_argument("--make", nargs=2, type=Path, metavar=("INPUTS", "RESULTS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    names = options.only.split(",")
    if options.store:
        stored.write()
        return 0
    if options.make:
        inputs, results = options.make
        make(inputs, results, names)
        return 0
    if options.rev is None or options.output is None:
        parser.error("a commit and --output are needed")
    return compare(options.rev, options.output.resolve(), names)


def compare(rev: str, folder: Path, names: list[str]) -> int:
    """Print where this checkout's results differ from those of a commit; return the exit code."""
    commit = _git("rev-parse", "--verify", f"{rev}^{{commit}}")
    cases = b"".join((Path(__file__).parent / name).read_bytes() for name in ("cases.py", "inputs.py", "outcome.py"))
    reference = folder / f"{commit[:12]}-{hashlib.sha256(cases).hexdigest()[:8]}"
    missing = [name for name in names if not (reference / f"{name}.zip").exists()]
    if missing:
        package = reference / "package"
        _export(commit, package)
        _make_with(package, reference / "inputs", reference, missing)
        shutil.rmtree(package)
    new = folder / "new"
    shutil.rmtree(new, ignore_errors=True)
    _make_with(TOP, reference / "inputs", new, names)
    found = [
        f"{name}: {line}"
        for name in names
        for line in differences(load(reference / f"{name}.zip"), load(new / f"{name}.zip"))
    ]
    print("\n".join([*found, f"{len(names)} cases, {len(found)} lines of differences from {commit[:12]}"]))
    return DIFFERENT if found else 0


def make(inputs: Path, results: Path, names: list[str]) -> None:
    """Run cases with the package that this process imports; keep their outcomes in a folder."""
    results.mkdir(parents=True, exist_ok=True)
    work = results / "work"
    for name in names:
        start = time.process_time()
        for needed in CASES[name].inputs.split():
            if not (inputs / needed).exists():
                (inputs / needed).mkdir(parents=True)
                write_inputs(needed, inputs / needed)
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        for needed in CASES[name].inputs.split():
            shutil.copytree(inputs / needed, work, dirs_exist_ok=True)
        save(run_case(CASES[name], work), results / f"{name}.zip")
        print(f"{name}: {time.process_time() - start:.1f} s", file=sys.stderr)
    shutil.rmtree(work, ignore_errors=True)


def _make_with(package: Path, inputs: Path, results: Path, names: list[str]) -> None:
    """Run `make` in a process that imports the package of a checkout."""
    path = {"PYTHONPATH": os.pathsep.join(map(str, (package, TOP / "tests")))}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, "-m", "frozen", "--make", str(inputs), str(results), "--only", ",".join(names)]
    subprocess.run(command, env={**os.environ, **threads, **path}, cwd=results.parent, check=True)


def _export(commit: str, folder: Path) -> None:
    """Write the package of a commit into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    packed = subprocess.run(["git", "archive", commit, "tofmix"], cwd=TOP, check=True, capture_output=True)  # noqa: S607
    subprocess.run(["tar", "-x", "-C", folder], input=packed.stdout, check=True)  # noqa: S607


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=TOP, check=True, capture_output=True, text=True)  # noqa: S607
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
