"""Recordings that another program writes to while they are read: refused, or read as they were before or after."""

import os
import random
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from support.files import boards, write_recording

from faults.fuzz import judge
from faults.inject import Report
from faults.pool import Job, Pool
from faults.same import same_content

_COMMAND = ("estimate", "recording.h5", "-o", "out.layers.h5", "--window", "20", "--workers", "1")


def changing(pool: Pool, count: int, *, seed: int = 1, report: Report = print) -> Counter[str]:
    """Change a recording at a random moment of each of some runs; return how they ended, faults by their names."""
    with tempfile.TemporaryDirectory(prefix="changing-") as name:
        folder = Path(name)
        whole = {}
        for which, samples in (("before", boards(400, 16, 20)), ("after", boards(400, 16, 20) + 500)):
            (folder / which).mkdir()
            write_recording(folder / which / "recording.h5", samples, chunks=(100, 4, 20), compression="gzip")
            outcome = pool.run(Job(argv=_COMMAND, cwd=str(folder / which)))
            if outcome.code:
                raise RuntimeError(outcome.err)
            whole[which] = outcome.seconds
        chance, counts = random.Random(seed), Counter[str]()  # noqa: S311  no secret
        for number in range(count):
            change = list(_CHANGES)[number % len(_CHANGES)]
            found = _once(pool, folder, change, chance.uniform(0, whole["before"]))
            counts[found] += 1
            if found not in ("refused", "read as before", "read as after"):
                report(f"{change}: {found}")
    return counts


def _once(pool: Pool, folder: Path, change: str, after_s: float) -> str:
    with tempfile.TemporaryDirectory(dir=folder) as name:
        place = Path(name)
        shutil.copyfile(folder / "before" / "recording.h5", place / "recording.h5")
        shutil.copyfile(folder / "after" / "recording.h5", place / "other")

        def act() -> None:
            time.sleep(after_s)
            _CHANGES[change](place / "recording.h5", place / "other")

        thread = threading.Thread(target=act)
        thread.start()
        outcome = pool.run(Job(argv=_COMMAND, cwd=name))
        thread.join()
        names = {path.name for path in place.iterdir()} - {"recording.h5", "other"}
        made = place / "out.layers.h5"
        if outcome.code and made.exists() and same_content(folder / "before" / made.name, made):
            names.remove(made.name)  # it was whole before the change came, which is refused all the same
        fault = judge(outcome, names, mutant="recording.h5")
        if fault:
            return f"{fault}: {outcome.err[-300:]}"
        if outcome.code:
            return "refused"
        for which in ("before", "after"):
            if same_content(folder / which / "out.layers.h5", place / "out.layers.h5"):
                return f"read as {which}"
        return "wrong in silence"


def _cut(path: Path, _: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def _append(path: Path, _: Path) -> None:
    with path.open("ab") as file:
        file.write(bytes(5000))


def _overwrite(path: Path, other: Path) -> None:
    data = other.read_bytes()
    with path.open("r+b") as file:
        file.write(data)
        file.truncate()


def _replace(path: Path, other: Path) -> None:
    other.rename(path)


def _damage(path: Path, _: Path) -> None:
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 3)
        file.write(os.urandom(20_000))


def _remove(path: Path, _: Path) -> None:
    path.unlink()


_CHANGES: dict[str, Callable[[Path, Path], None]] = {
    "cut": _cut,
    "lengthened": _append,
    "written over": _overwrite,
    "replaced": _replace,
    "damaged": _damage,
    "removed": _remove,
}
