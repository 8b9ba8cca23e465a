"""Commands whose N-th system call fails, or who are killed at it, for N = 1, 2, ... until they succeed."""

import errno
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

from faults.fuzz import DONE, REFUSED
from faults.pool import Job, Outcome, Pool
from faults.same import same_content

Report: TypeAlias = Callable[[str], object]

KILL_BEFORE, KILL_AFTER, SHORT = -1, -2, 0
SOURCE = Path(__file__).with_name("shim.c")

FAILURES: dict[str, tuple[str, int, int]] = {
    "write: disk full": ("write", errno.ENOSPC, 0),
    "write: one I/O error": ("write", errno.EIO, 1),
    "write: a part only": ("write", SHORT, 1),
    "truncate: disk full": ("truncate", errno.ENOSPC, 0),
    "fsync: I/O error": ("fsync", errno.EIO, 1),
    "rename: I/O error": ("rename", errno.EIO, 1),
    "open: no permission": ("open", errno.EACCES, 1),
    "open: too many files": ("open", errno.EMFILE, 0),
    "unlink: I/O error": ("unlink", errno.EIO, 1),
    "read: I/O error": ("read", errno.EIO, 1),
    "read: a part only": ("read", SHORT, 1),
    "allocation": ("alloc", errno.ENOMEM, 1),
    "allocation, and all after": ("alloc", errno.ENOMEM, 0),
    "killed before a write": ("write", KILL_BEFORE, 1),
    "killed after a write": ("write", KILL_AFTER, 1),
    "killed before fsync": ("fsync", KILL_BEFORE, 1),
    "killed before rename": ("rename", KILL_BEFORE, 1),
    "killed after rename": ("rename", KILL_AFTER, 1),
    "killed before unlink": ("unlink", KILL_BEFORE, 1),
}
"""What fails: operation, errno (or one of the constants above), and whether only once."""


@dataclass(frozen=True, slots=True)
class Case:
    """A command, its outputs, and how it is started again: from where it stopped, or from the beginning."""

    command: str
    outputs: tuple[str, ...]
    again: str = " --overwrite"


CASES: dict[str, Case] = {
    "estimate": Case(
        "estimate recording.h5 -o out.layers.h5 --window 5 --workers 1", ("out.layers.h5",), " --resume --overwrite"
    ),
    "estimate a part": Case(
        "estimate recording.h5 -o out.part --window 5 --workers 1 --shard 1/2", ("out.part",), " --resume --overwrite"
    ),
    "merge": Case("merge 1.part 2.part -o out.layers.h5", ("out.layers.h5",)),
    "simulate": Case("simulate model.toml -o out.h5", ("out.h5",)),
    "import": Case("import a.npy -o out.h5 --sensor sensor.toml", ("out.h5",)),
    "report": Case("report layers.h5 --html out.html", ("out.html",)),
    "export points": Case("export layers.h5 -o out.ply", ("out.ply",)),
    "export an image": Case("export layers.h5 -o out.tif --window 0", ("out.tif",)),
    "map": Case("map layers.h5 -o out.yaml --voxels out.npz", ("out.yaml", "out.pgm", "out.npz")),
    "inspect": Case("inspect layers.h5 --pixel 1,2 -o out.png", ("out.png",)),
}


@dataclass(slots=True)
class Tally:
    """Counts of one failure of one case, and the faults found."""

    case: str
    failure: str
    runs: int = 0
    refused: int = 0
    killed: int = 0
    done: int = 0
    faults: list[str] = field(default_factory=list)


def compiled(folder: Path) -> Path | None:
    """Compile the shim; None where there is no C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    library = folder / "shim.so"
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"], check=True)
    return library


class Injection:
    """Faults in commands on sound files.

    Parameters
    ----------
    originals : Path
        Folder of `faults.originals.make`.
    pool : Pool
        Whose processes have the shim.
    """

    def __init__(self, originals: Path, pool: Pool) -> None:
        self._originals, self._pool = originals, pool
        self._expected: dict[str, Path] = {}
        self._seconds: dict[str, float] = {}

    def run(self, case: str, failure: str, *, step: int = 1, most: int = 10_000, report: Report = print) -> Tally:
        """Fail at call 1, 1 + step, ... until a run meets no failure; without an output there, and over an old one."""
        expected = self._expected_of(case)
        operation, code, once = FAILURES[failure]

        def fail(old: bool) -> Tally:
            tally = Tally(case, failure)
            for number in range(1, most, step):
                job = Job(argv=(), cwd="", fault=(operation, number, code, once))
                with tempfile.TemporaryDirectory(prefix="inject-") as name:
                    outcome = self._once(CASES[case], job, f"call {number}", Path(name), expected, tally, old=old)
                if outcome.calls < number:
                    return tally
            tally.faults.append(f"still failing at call {most}")
            return tally

        tally, over_old = self._pool.map(fail, (False, True))
        for name in ("runs", "refused", "killed", "done", "faults"):
            setattr(tally, name, getattr(tally, name) + getattr(over_old, name))
        return _reported(tally, report)

    def kill(
        self, case: str, moments: Iterable[float], *, number: int = signal.SIGKILL, report: Report = print
    ) -> Tally:
        """Send a signal at some moments, shares of the time that a whole run takes."""
        tally = Tally(case, f"{signal.Signals(number).name} at a random moment")
        expected = self._expected_of(case)
        for moment in moments:
            job = Job(argv=(), cwd="", kill_after_s=moment * self._seconds[case], kill_signal=number)
            with tempfile.TemporaryDirectory(prefix="inject-") as name:
                self._once(CASES[case], job, f"at {moment:.3f} of the run", Path(name), expected, tally, old=False)
        return _reported(tally, report)

    def limit(self, case: str, sizes: Iterable[int], *, report: Report = print) -> Tally:
        """Run with limits of the size of files, as `ulimit -f` sets them; stderr is a file here and needs its room."""
        tally = Tally(case, "ulimit -f")
        expected = self._expected_of(case)
        for size in sizes:
            job = Job(argv=(), cwd="", file_bytes=size)
            with tempfile.TemporaryDirectory(prefix="inject-") as name:
                self._once(CASES[case], job, f"at {size} bytes", Path(name), expected, tally, old=bool(size % 2))
        return _reported(tally, report)

    def fill(self, case: str, place: Path, free: Iterable[int], *, report: Report = print) -> Tally:
        """Run on a small disk, mounted at `place`, on which a few bytes are free."""
        tally = Tally(case, "a disk of 8 MB, full")
        expected = self._expected_of(case)
        for size in free:
            with tempfile.TemporaryDirectory(dir=place) as name:
                self._once(
                    CASES[case], Job(argv=(), cwd=""), f"{size} bytes free", Path(name), expected, tally, old=False,
                    leave_free=size,
                )  # fmt: skip
        return _reported(tally, report)

    def _expected_of(self, case: str) -> Path:
        if case not in self._expected:
            folder = Path(tempfile.mkdtemp(dir=self._originals))
            inputs_into(self._originals, folder)
            outcome = self._pool.run(Job(argv=tuple(CASES[case].command.split()), cwd=str(folder)))
            if outcome.code:
                raise RuntimeError(outcome.err)
            self._expected[case] = folder
            self._seconds[case] = outcome.seconds
        return self._expected[case]

    def _once(
        self,
        case: Case,
        job: Job,
        where: str,
        folder: Path,
        expected: Path,
        tally: Tally,
        *,
        old: bool,
        leave_free: int | None = None,
    ) -> Outcome:
        """Run once with the failure, look at what is left, and go on without it."""
        inputs_into(self._originals, folder)
        for name in case.outputs if old else ():
            (folder / name).write_bytes(b"old")
        ballast = None if leave_free is None else _ballast(folder.parent, leave_free)
        argv = tuple((case.command + " --overwrite" * old).split())
        outcome = self._pool.run(replace(job, argv=argv, cwd=str(folder)))
        tally.runs += 1
        asked_for = outcome.code == -job.kill_signal and (
            job.kill_after_s is not None or (job.fault or (0, 0, 0))[2] in (KILL_BEFORE, KILL_AFTER)
        )
        hard = asked_for and outcome.code == -signal.SIGKILL
        wrong = [_ending(outcome, killed=asked_for)]
        wrong += _left(case, folder, self._originals, expected, outcome, old=old, killed=hard)
        tally.killed += asked_for
        tally.refused += outcome.code in REFUSED
        tally.done += outcome.code in DONE
        if ballast is not None:
            ballast.unlink()
        again = self._pool.run(Job(argv=tuple((case.command + case.again).split()), cwd=str(folder)))
        if again.code:
            wrong.append(f"started again: {again.code} {again.err[-300:]}")
        else:
            wrong += _left(case, folder, self._originals, expected, again, old=old)
        tally.faults += [
            f"{where}{', over an old file' * old}: {text} [{outcome.err[-300:]}]" for text in wrong if text
        ]
        return outcome


def _reported(tally: Tally, report: Report) -> Tally:
    for fault in tally.faults:
        report(f"{tally.case}: {tally.failure}: {fault}")
    return tally


def _ballast(disk: Path, leave_free: int) -> Path:
    """Fill a disk up to some bytes."""
    state = os.statvfs(disk)
    path = disk / "ballast"
    with path.open("wb") as file:
        file.write(bytes(max(0, state.f_bavail * state.f_frsize - leave_free)))
    return path


def _inputs(folder: Path) -> tuple[str, ...]:
    names = ("recording.h5", "layers.h5", "model.toml", "sensor.toml", "a.npy", "1.part", "2.part")
    return tuple(name for name in names if (folder / name).exists())


def inputs_into(originals: Path, folder: Path) -> None:
    """Copy what the cases read."""
    for name in _inputs(originals):
        shutil.copy(originals / name, folder)


def _ending(outcome: Outcome, *, killed: bool) -> str:
    """Return what is wrong with how a run ended, or an empty text."""
    lines = outcome.err.splitlines()
    if killed:
        return "traceback" if "Traceback" in outcome.err else ""
    rules = (
        (outcome.hung, "hang"),
        (outcome.code < 0, f"signal {-outcome.code}"),
        ("Traceback" in outcome.err or outcome.code not in (*DONE, *REFUSED), f"exit code {outcome.code}"),
        (outcome.code in REFUSED and not lines, "no reason"),
        (any(not line.startswith("tofmix: ") for line in lines), "stray line on stderr"),
    )
    return next((text for wrong, text in rules if wrong), "")


def _left(
    case: Case, folder: Path, originals: Path, expected: Path, outcome: Outcome, *, old: bool, killed: bool = False
) -> Iterator[str]:
    """Say what is wrong with the files after a run: outputs are new and whole, old or not there; inputs as before."""
    for name in _inputs(originals):
        if (folder / name).read_bytes() != (originals / name).read_bytes():
            yield f"{name} has changed"
    whole = []
    for name in case.outputs:
        path = folder / name
        there = path.read_bytes() if path.exists() else None
        whole.append(there not in (None, b"old"))
        if old and there is None:
            yield f"the old {name} is lost"
        if (there == b"old" and not old) or (whole[-1] and not same_content(expected / name, path)):
            yield f"{name} is not what it must be"
    if outcome.code in DONE and not all(whole):
        yield "no output of a run that says it is done"
    resumable = "estimate" in case.command and outcome.code != 0
    for path in sorted(folder.iterdir()):
        known = path.name in case.outputs or path.name in _inputs(originals)
        hidden = path.name.startswith(".")
        if not known and not (hidden and (killed or (resumable and ".journal" in path.name))):
            yield f"{path.name} is left"


def table(tallies: list[Tally]) -> str:
    """Counts by failure, as Markdown."""
    lines = ["| failure | runs | refused | killed | done all the same | faults |", "|---|---|---|---|---|---|"]
    for failure in dict.fromkeys(tally.failure for tally in tallies):
        own = [tally for tally in tallies if tally.failure == failure]
        sums = [sum(getattr(tally, name) for tally in own) for name in ("runs", "refused", "killed", "done")]
        faults = sum(len(tally.faults) for tally in own)
        lines.append(f"| {failure} | {' | '.join(map(str, sums))} | {faults} |")
    return "\n".join(lines)


def with_shim(library: Path) -> dict[str, str]:
    """Variables of a pool whose processes have the shim."""
    return {"LD_PRELOAD": os.pathsep.join(filter(None, (str(library), os.environ.get("LD_PRELOAD", ""))))}
