"""A place in which one mutant at a time is tested: copies of the checkouts, and a cache of compiled kernels.

    FOLDER/checkout          the suite that runs now, with the package, changed or not
    FOLDER/waiting/SUITE     the other suites, without a package
    FOLDER/kernels           kernels compiled from the changed package
    FOLDER/shared            what lies beside a checkout, for tests that look there

The package always has the path FOLDER/checkout/tofmix, whichever suite runs: numba finds compiled kernels by the path.
Its bytecode is checked against the source by content, so that no run can take a stale one.
"""

import compileall
import hashlib
import json
import os
import py_compile
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mutation.coverage_map import KnownTest
from mutation.draw import Mutant
from mutation.names import Names

_KERNEL_WIDE = ("tofmix/compiled/jit.py",)
"""How kernels are compiled: a change concerns them all."""
_START_S = 60.0
"""What a process of pytest may take beside its tests, on a busy machine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """How a run of tests ended."""

    killed_by: str | None
    """The test that failed or hung, "import" where none could be collected; None if all passed."""
    how: str
    """"passed", "failed", "hung" or "broken"."""
    passed: list[str]
    seconds: float


class Slot:
    """One place; its folder is kept from run to run."""

    def __init__(self, folder: Path, suites: dict[str, Path]) -> None:
        """Copy the checkouts of `suites`, unless that is done; the package is the first one's."""
        self.folder = folder
        self.checkout = folder / "checkout"
        self._plugins = folder / "plugins"
        self._suites = list(suites)
        done = folder / "copied"
        if done.exists() and done.read_text() == _copied(suites):
            self._restore(next(iter(suites.values())))
            self._copy_plugins()
            return
        shutil.rmtree(folder, ignore_errors=True)
        for name, top in suites.items():
            _copy(top, folder / "waiting" / name)
        self._copy_plugins()
        first = next(iter(suites))
        (folder / "waiting" / first / "tofmix").rename(folder / "tofmix")
        for name in self._suites[1:]:
            shutil.rmtree(folder / "waiting" / name / "tofmix")
        beside = next(iter(suites.values())).parent / "shared"
        if beside.exists():
            (folder / "shared").symlink_to(beside.resolve())
        (folder / "waiting" / first).rename(self.checkout)
        (folder / "tofmix").rename(self.checkout / "tofmix")
        self._note_suite(first)
        _compile(self.checkout / "tofmix")
        done.write_text(_copied(suites))

    def dress(self, suite: str) -> None:
        """Make `suite` the one whose tests run."""
        now = (self.folder / "suite").read_text()
        if now == suite:
            return
        waiting = self.folder / "waiting"
        self.checkout.rename(waiting / now)
        (waiting / suite).rename(self.checkout)
        (waiting / now / "tofmix").rename(self.checkout / "tofmix")
        self._note_suite(suite)

    def map(self, folder: Path, jobs: int, tests: Sequence[str] = ()) -> int:
        """Run the whole suite once on the unchanged package, followed into `folder`; return pytest's exit code."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        environment = self.environment(MUTATION_MAP=str(folder), MUTATION_SOURCE=str(self.checkout / "tofmix"))
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "mutation.follow",
            "-p",
            "no:cacheprovider",
            "--no-header",
            "--tb=short",
            "--numprocesses",
            str(jobs),
            "--dist",
            "worksteal",
            *tests,
        ]
        return subprocess.run(command, cwd=self.checkout, env=environment, check=False).returncode

    def compile_kernels(self) -> Path:
        """Compile the kernels of the unchanged package; return their folder."""
        command = [sys.executable, "-m", "tofmix", "warmup"]
        subprocess.run(command, cwd=self.checkout, env=self.environment(), capture_output=True, check=True)
        return self.folder / "kernels"

    def collected(self) -> set[str]:
        """Return the tests that pytest can collect, of the suite that runs now."""
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--collect-only"]
        command.append("--continue-on-collection-errors")
        done = subprocess.run(command, cwd=self.checkout, env=self.environment(), capture_output=True, check=False)
        return {line for line in done.stdout.decode().splitlines() if "::" in line}

    def _copy_plugins(self) -> None:
        """Copy this study's own modules: beside them on the path, those of the tests would be in each other's way."""
        shutil.rmtree(self._plugins, ignore_errors=True)
        shutil.copytree(Path(__file__).parent, self._plugins / "mutation", ignore=shutil.ignore_patterns("__pycache__"))

    def _note_suite(self, suite: str) -> None:
        (self.folder / "suite").write_text(suite)

    def _restore(self, top: Path) -> None:
        """Undo what a run that was broken off left behind."""
        self.dress(self._suites[0])
        for path in (top / "tofmix").rglob("*.py"):
            target = self.checkout / path.relative_to(top)
            if target.read_bytes() != path.read_bytes():
                target.write_bytes(path.read_bytes())

    @contextmanager
    def changed(self, mutant: Mutant, names: Names, kernels: Path | None) -> Iterator[float]:
        """Change the package meanwhile; yield the seconds that its kernels may take to compile.

        `kernels` is the cache of the unchanged package.
        """
        path = self.checkout / mutant.file
        source = path.read_bytes()
        shutil.rmtree(self.folder / "kernels", ignore_errors=True)
        try:
            path.write_bytes(mutant.applied(source))
            changed = [(found.module, found.name) for found in names.at(mutant.file, mutant.line)]
            above = names.definitions(names.all_above(changed))
            concerned = [found for found in above if found.kind == "kernel"]
            if kernels is not None and mutant.file not in _KERNEL_WIDE:
                again = [f"{Path(k.file).with_suffix('').as_posix()}.{k.name}" for k in concerned]
                command = [sys.executable, "-m", "mutation.kernels", str(kernels), *again]
                # Without the copy, every kernel is compiled again: slower, and as right.
                subprocess.run(command, env=self.environment(), cwd=self.folder, capture_output=True, check=False)
            yield 240.0 if concerned or mutant.file in _KERNEL_WIDE else 60.0
        finally:
            path.write_bytes(source)
            shutil.rmtree(self.folder / "kernels", ignore_errors=True)

    def environment(self, **more: str) -> dict[str, str]:
        """Return the environment in which tests run."""
        place = self.folder / "temporary"
        place.mkdir(exist_ok=True)
        path = os.pathsep.join([str(self.checkout), str(self._plugins)])
        ours = {
            "PYTHONPATH": path,
            "NUMBA_CACHE_DIR": str(self.folder / "kernels"),
            "NUMBA_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "TMPDIR": str(place),
        }
        return os.environ | ours | more

    def run(self, tests: Sequence[KnownTest], *, compiling_s: float = 60.0) -> Ended:
        """Run tests in their order until one fails."""
        if not tests:
            return Ended(killed_by=None, how="passed", passed=[], seconds=0.0)
        begun = time.monotonic()
        with tempfile.TemporaryDirectory(dir=self.folder) as name:
            chosen, outcomes, log = Path(name) / "chosen", Path(name) / "outcomes", Path(name) / "log"
            outcomes.touch()
            limits = {test.id: compiling_s + max(20.0, 20.0 * test.seconds) for test in tests}
            chosen.write_text("".join(json.dumps([test, limit]) + "\n" for test, limit in limits.items()))
            environment = self.environment(MUTATION_CHOSEN=str(chosen), MUTATION_OUTCOMES=str(outcomes))
            environment["TMPDIR"] = name
            command = [
                sys.executable,
                "-m",
                "pytest",
                "-q",
                "-x",
                "-p",
                "mutation.chosen",
                "-p",
                "no:cacheprovider",
                "-p",
                "no:faulthandler",
                "--no-header",
                "--tb=no",
                *dict.fromkeys(test.file for test in tests),
            ]
            whole_s = _START_S + compiling_s + 20.0 * sum(test.seconds for test in tests) + 20.0
            with log.open("wb") as file:
                code = _run(command, self.checkout, environment, file, whole_s)
            notes = [json.loads(line) for line in outcomes.read_text().splitlines()]
            ended = judged(code, notes)
            if ended.how == "broken":
                (self.folder / "broken.log").write_bytes(log.read_bytes())
        return Ended(
            killed_by=ended.killed_by, how=ended.how, passed=ended.passed, seconds=round(time.monotonic() - begun, 2)
        )


def judged(code: int | None, notes: list[list[str]]) -> Ended:
    """Judge a run by the exit code of pytest, None after its limit, and by the notes of `mutation.chosen`."""
    failed = [test for word, test in notes if word == "failed"]
    started = [test for word, test in notes if word == "start"]
    passed = [test for word, test in notes if word == "end" and test not in failed]
    if failed:
        return Ended(killed_by=failed[0], how="failed", passed=passed, seconds=0.0)
    if code in {0, 5}:  # 5: none of them is collected any more
        return Ended(killed_by=None, how="passed", passed=passed, seconds=0.0)
    if started and len(passed) < len(started):
        return Ended(killed_by=started[-1], how="hung", passed=passed, seconds=0.0)
    return Ended(killed_by="import", how="broken", passed=passed, seconds=0.0)


def _run(command: list[str], folder: Path, environment: dict[str, str], log: IO[bytes], limit_s: float) -> int | None:
    """Run a process in a session of its own, and end whatever it leaves behind."""
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=log,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        return process.wait(limit_s)
    except subprocess.TimeoutExpired:
        return None
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def fingerprint(*places: Path) -> str:
    """Hash of the sources in some folders, this study's own left out."""
    digest = hashlib.sha256()
    for place in places:
        for path in sorted(place.rglob("*")):
            if path.is_file() and not {"__pycache__", "mutation"} & set(path.parts):
                digest.update(path.relative_to(place).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _copy(top: Path, target: Path) -> None:
    """Copy what git knows of a checkout, changes included."""
    command = ["git", "-C", str(top), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, capture_output=True, check=True).stdout.decode().split("\0")
    for name in filter(None, listed):
        if (top / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(top / name, target / name)


def _compile(package: Path) -> None:
    compileall.compile_dir(package, quiet=2, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH)


def _copied(suites: dict[str, Path]) -> str:
    return json.dumps({name: [str(top), fingerprint(top / "tofmix", top / "tests")] for name, top in suites.items()})
