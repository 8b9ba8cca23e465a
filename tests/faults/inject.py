"""Commands whose N-th system call fails, or who are killed at it: for N = 1, 2, ... to the last, or some of them."""

import errno
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

from faults import fuzz
from faults.fuzz import DONE
from faults.pool import HANG_CPU_S, Job, Outcome, Pool
from faults.same import same_content

Report: TypeAlias = Callable[[str], object]

REFUSED = (*fuzz.REFUSED, 5)
"""Where one of several files is unfit, too."""

_OF_OUTPUTS = ("write", "truncate", "fsync", "rename", "unlink")
KILL_BEFORE, KILL_AFTER, SHORT = -1, -2, 0
_BEYOND = 1000
"""A call so far past the last of a sound run is not met."""

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
    """A command, its outputs, and how it is started again: from where it stopped, or from the beginning.

    What costs more is tried less often.
    """

    command: str
    outputs: tuple[str, ...]
    again: str = " --overwrite"
    cost: int = 1


# The recording is one cell, which the second of two parts has.
CASES: dict[str, Case] = {
    "estimate": Case(
        "estimate recording.h5 -o out.layers.h5 --window 5 --workers 1", ("out.layers.h5",), " --resume --overwrite"
    ),
    "estimate a part": Case(
        "estimate recording.h5 -o out.part --window 5 --workers 1 --shard 2/2", ("out.part",), " --resume --overwrite"
    ),
    "merge": Case("merge 1.part 2.part -o out.layers.h5", ("out.layers.h5",)),
    "simulate": Case("simulate model.toml -o out.h5", ("out.h5",)),
    "import": Case("import a.npy -o out.h5 --sensor sensor.toml", ("out.h5",)),
    "report": Case("report layers.h5 --html out.html", ("out.html",)),
    "export points": Case("export layers.h5 -o out.ply", ("out.ply",)),
    "export an image": Case("export layers.h5 -o out.tif --window 0", ("out.tif",)),
    "map": Case("map layers.h5 -o out.yaml --voxels out.npz", ("out.yaml", "out.pgm", "out.npz")),
    "inspect": Case("inspect layers.h5 --pixel 1,2 -o out.png", ("out.png",)),
    "compare": Case("compare layers.h5 layers.h5 --html out.html", ("out.html",)),
    "reconcile": Case(
        "reconcile model.toml recording.h5 -o out --effects wiggling --max-effects 0",
        ("out/model.toml", "out/gap.json", "out/report.html"),
        cost=4,
    ),
    "verify": Case("verify recording.h5 layers.h5", ()),
    "info": Case("info recording.h5 --json", ()),
}

WRITING: tuple[str, ...] = tuple(name for name, case in CASES.items() if case.outputs)


@dataclass(slots=True)
class Tally:
    """Counts of one failure of one case, and the faults found.

    `calls` is how many there are that could fail, `tried` which of them did.
    """

    case: str
    failure: str
    calls: int = 0
    tried: list[int] = field(default_factory=list)
    runs: int = 0
    refused: int = 0
    killed: int = 0
    done: int = 0
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tried:
    """One run with a failure."""

    outcome: Outcome
    killed: bool
    faults: list[str]

    def into(self, tally: Tally) -> None:
        """Count it."""
        tally.runs += 1
        tally.killed += self.killed
        tally.refused += self.outcome.code in REFUSED
        tally.done += self.outcome.code in DONE
        tally.faults += self.faults


def chosen(calls: int, most: int | None = None) -> list[int]:
    """All of 1 to `calls`, or `most` of them: a third at the beginning, a third at the end, a third evenly between."""
    if most is None or calls <= most:
        return list(range(1, calls + 1))
    third = most // 3
    between = most - 2 * third
    middle = [third + round((index + 1) * (calls - 2 * third) / (between + 1)) for index in range(between)]
    return sorted({*range(1, third + 1), *middle, *range(calls - third + 1, calls + 1)})


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

    `originals`: folder of `faults.originals.make`.
    `pool`: whose processes have the shim.
    """

    def __init__(self, originals: Path, pool: Pool) -> None:
        self._originals, self._pool = originals, pool
        self._expected: dict[str, Path] = {}
        self._seconds: dict[str, float] = {}
        self._calls: dict[tuple[str, str], int] = {}
        self._lock = threading.Lock()

    def run(self, case: str, failure: str, *, most: int | None = None, report: Report = print) -> Tally:
        """Fail at each call, or at most at some of them, and at none: without an output there and over an old one.

        Where not all are tried, or the command costs much, those of odd numbers have no old output.
        """
        operation, code, once = FAILURES[failure]
        tally = Tally(case, failure, calls=self._calls_of(case, operation))
        if not tally.calls:
            return tally
        numbers = chosen(tally.calls, most)
        whole = len(numbers) == tally.calls and CASES[case].cost == 1
        tries = [
            (number, old)
            for number in (*numbers, tally.calls + _BEYOND)
            for old in ((False, True) if CASES[case].outputs else (False,))
            if whole or number > tally.calls or old == (number % 2 == 0) or not CASES[case].outputs
        ]

        def fail(one: tuple[int, bool]) -> tuple[Tried, bool]:
            number, old = one
            job = Job(argv=(), cwd="", fault=(operation, number, code, once), cpu_s=_cpu_s(case))
            tried = self._once(case, job, f"call {number}", old=old)
            return tried, tried.outcome.calls >= number

        for (number, _), (tried, met) in zip(tries, self._pool.map(fail, tries), strict=True):
            tried.into(tally)
            if met and number not in tally.tried:
                tally.tried.append(number)
        if not tally.tried:
            tally.faults.append("no call has failed")
        return _reported(tally, report)

    def _calls_of(self, case: str, operation: str) -> int:
        """How many calls of a kind there are in a sound run."""
        if (case, operation) not in self._calls:
            with tempfile.TemporaryDirectory(prefix="inject-") as name:
                inputs_into(self._originals, Path(name))
                argv = tuple(CASES[case].command.split())
                fault = (operation, 1 << 40, errno.EIO, 1)
                outcome = self._pool.run(Job(argv=argv, cwd=name, fault=fault, cpu_s=_cpu_s(case)))
            if outcome.code:
                raise RuntimeError(outcome.err)
            self._calls[case, operation] = outcome.calls
        return self._calls[case, operation]

    def kill(
        self, case: str, moments: Iterable[float], *, number: int = signal.SIGKILL, report: Report = print
    ) -> Tally:
        """Send a signal at some moments, shares of the time that a whole run takes."""
        tally = Tally(case, f"{signal.Signals(number).name} at a random moment")
        self._expected_of(case)
        for moment in moments:
            job = Job(
                argv=(), cwd="", kill_after_s=moment * self._seconds[case], kill_signal=number, cpu_s=_cpu_s(case)
            )
            self._once(case, job, f"at {moment:.3f} of the run", old=False).into(tally)
        return _reported(tally, report)

    def limit(self, case: str, sizes: Iterable[int], *, report: Report = print) -> Tally:
        """Run with limits of the size of files, as `ulimit -f` sets them; stderr is a file here and needs its room."""
        tally = Tally(case, "ulimit -f")
        for size in sizes:
            job = Job(argv=(), cwd="", file_bytes=size, cpu_s=_cpu_s(case))
            self._once(case, job, f"at {size} bytes", old=bool(size % 2)).into(tally)
        return _reported(tally, report)

    def fill(self, case: str, place: Path, free: Iterable[int], *, report: Report = print) -> Tally:
        """Run on a small disk, mounted at `place`, on which a few bytes are free."""
        tally = Tally(case, "a disk of 8 MB, full")
        for size in free:
            job = Job(argv=(), cwd="", cpu_s=_cpu_s(case))
            self._once(case, job, f"{size} bytes free", old=False, place=place, leave_free=size).into(tally)
        return _reported(tally, report)

    def device(self, case: str, *, report: Report = print) -> Tally:
        """Run with stdout, stderr, or both on a full device, and with a limit of the size of files besides."""
        tally = Tally(case, "streams on a full device")
        for full in (("out",), ("err",), ("out", "err")):
            for size in (None, 4096):
                job = Job(argv=(), cwd="", full=full, file_bytes=size, cpu_s=_cpu_s(case))
                self._once(case, job, f"{' and '.join(full)}, {size} bytes", old=size is None).into(tally)
        return _reported(tally, report)

    def closed(self, case: str, *, report: Report = print) -> Tally:
        """Run in a folder without permission to write."""
        tally = Tally(case, "a folder without permission")
        job = Job(argv=(), cwd="", unprivileged=True, cpu_s=_cpu_s(case))
        self._once(case, job, "closed", old=False, mode=0o555).into(tally)
        return _reported(tally, report)

    def _expected_of(self, case: str) -> Path:
        with self._lock:
            if case not in self._expected:
                folder = Path(tempfile.mkdtemp(dir=self._originals))
                inputs_into(self._originals, folder)
                job = Job(argv=tuple(CASES[case].command.split()), cwd=str(folder), cpu_s=_cpu_s(case))
                outcome = self._pool.run(job)
                if outcome.code:
                    raise RuntimeError(outcome.err)
                self._expected[case] = folder
                self._seconds[case] = outcome.seconds
        return self._expected[case]

    def _once(
        self,
        name: str,
        job: Job,
        where: str,
        *,
        old: bool,
        place: Path | None = None,
        leave_free: int | None = None,
        mode: int | None = None,
    ) -> Tried:
        """Run once with the failure, look at what is left, and go on from there without it."""
        case, expected = CASES[name], self._expected_of(name)
        with tempfile.TemporaryDirectory(dir=place, prefix="inject-") as text:
            folder = Path(text)
            inputs_into(self._originals, folder)
            for output in case.outputs if old else ():
                (folder / output).parent.mkdir(exist_ok=True)
                (folder / output).write_bytes(b"old")
            ballast = None if leave_free is None else _ballast(folder.parent, leave_free)
            argv = tuple((case.command + " --overwrite" * old).split())
            if mode is not None:
                folder.chmod(mode)
            outcome = self._pool.run(replace(job, argv=argv, cwd=text))
            folder.chmod(0o700)
            asked_for = outcome.code == -job.kill_signal and (
                job.kill_after_s is not None or (job.fault or (0, 0, 0))[2] in (KILL_BEFORE, KILL_AFTER)
            )
            hard = asked_for and outcome.code == -signal.SIGKILL
            wrong = [_ending(outcome, killed=asked_for, silent="err" in job.full)]
            if job.fault and job.fault[0] in _OF_OUTPUTS and outcome.code in REFUSED and outcome.code != 4:
                wrong.append(f"exit code {outcome.code} for a disk that fails")
            wrong += _left(case, folder, self._originals, expected, outcome, old=old, killed=hard)
            if ballast is not None:
                ballast.unlink()
            if _leftovers(case, folder, self._originals):  # else it would begin as any run does
                argv = tuple((case.command + case.again).split())
                again = self._pool.run(Job(argv=argv, cwd=text, cpu_s=job.cpu_s))
                if again.code:
                    wrong.append(f"started again: {again.code} {again.err[-300:]}")
                else:
                    wrong += _left(case, folder, self._originals, expected, again, old=old)
        told = f"{where}{', over an old file' * old}"
        faults = [f"{told}: {text} [{outcome.err[-300:]}]" for text in wrong if text]
        return Tried(outcome=outcome, killed=asked_for, faults=faults)


def _cpu_s(case: str) -> int:
    return HANG_CPU_S * CASES[case].cost


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


def _ending(outcome: Outcome, *, killed: bool, silent: bool) -> str:
    """Return what is wrong with how a run ended, or an empty text."""
    lines = outcome.err.splitlines()
    if killed:
        return "traceback" if "Traceback" in outcome.err else ""
    rules = (
        (outcome.hung, "hang"),
        (outcome.code < 0, f"signal {-outcome.code}"),
        ("Traceback" in outcome.err or outcome.code not in (*DONE, *REFUSED), f"exit code {outcome.code}"),
        (outcome.code in REFUSED and not (lines or outcome.out) and not silent, "no reason"),
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
    # A folder that a run makes for its outputs may stay where there are any, or where the run was killed.
    folders = {str(Path(name).parent) for name in case.outputs if any(whole) or old or killed}
    for path in _leftovers(case, folder, originals):
        hidden = path.name.startswith(".")
        # What cannot be removed stays; the run says so, and the next one tries again.
        fitting = hidden and (killed or (resumable and ".journal" in path.name) or path.name in outcome.err)
        if not fitting and str(path.relative_to(folder)) not in folders:
            yield f"{path.name} is left"


def _leftovers(case: Case, folder: Path, originals: Path) -> list[Path]:
    """Return what stands there that is no input and no output."""
    known = {*case.outputs, *_inputs(originals)}
    return [path for path in sorted(folder.rglob("*")) if str(path.relative_to(folder)) not in known]


def table(tallies: list[Tally]) -> str:
    """Counts by failure, as Markdown; those of calls only where calls fail."""
    of_calls = any(tally.calls for tally in tallies)
    names = ["calls", "of them tried"] * of_calls + ["runs", "refused", "killed", "done all the same", "faults"]
    lines = [f"| failure | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for failure in dict.fromkeys(tally.failure for tally in tallies):
        own = [tally for tally in tallies if tally.failure == failure]
        calls = [sum(tally.calls for tally in own), sum(len(tally.tried) for tally in own)] * of_calls
        sums = [sum(getattr(tally, name) for tally in own) for name in ("runs", "refused", "killed", "done")]
        faults = sum(len(tally.faults) for tally in own)
        lines.append(f"| {failure} | {' | '.join(map(str, (*calls, *sums, faults)))} |")
    return "\n".join(lines)


def with_shim(library: Path) -> dict[str, str]:
    """Variables of a pool whose processes have the shim."""
    return {"LD_PRELOAD": os.pathsep.join(filter(None, (str(library), os.environ.get("LD_PRELOAD", ""))))}
