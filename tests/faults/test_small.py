"""Faults in small, for the quick run: a failing call, two kills, three hostile files, and two mutants of each kind.

`test_inject.py` and `test_fuzz.py` try more of each, and the long run all of them.
"""

import random
import shutil
from pathlib import Path

from faults.fuzz import Fuzz, judge
from faults.hostile import HOSTILE
from faults.inject import Injection
from faults.originals import Original
from faults.pool import Job, Pool

FAILING = (("estimate", "write: disk full"), ("simulate", "killed before rename"))
"""A command, and what fails at one of its calls."""


def test_failing_calls_and_kills_leave_a_whole_output_or_none(shim: Path | None, injection: Injection) -> None:
    tallies = [injection.kill("estimate", [0.5], report=lambda _: None)]
    if shim is not None:
        tallies += [injection.run(case, failure, most=1, report=lambda _: None) for case, failure in FAILING]
    assert not [fault for tally in tallies for fault in tally.faults]
    assert [tally.failure for tally in tallies if not tally.refused + tally.killed] == []


def test_hostile_files_are_refused_in_one_line(pool: Pool, originals: dict[str, Original], tmp_path: Path) -> None:
    for name in ("bomb", "external storage", "huge declared shape"):
        path = tmp_path / "hostile.h5"
        shutil.copyfile(originals["recording"].given, path)
        HOSTILE[name](path, random.Random(1))  # noqa: S311  no secret
        outcome = pool.run(Job(argv=("estimate", path.name, "-o", "out.layers.h5"), cwd=str(tmp_path)))
        assert outcome.code == 3, (name, outcome)
        left = {file.name for file in tmp_path.iterdir()} - {path.name}
        assert judge(outcome, left, mutant=path.name) == "", name


def test_two_mutants_of_each_kind_are_done_or_refused(fuzz: Fuzz, originals: dict[str, Original]) -> None:
    verdicts = list(fuzz.run(list(originals), 2 * len(originals), seed=0))
    faults = [f"{v.fault}: {v.mutant}: {v.command}: {v.change}: {v.outcome.err}" for v in verdicts if v.fault]
    assert not faults, "\n".join(faults)
    assert {"refused"} < {v.result for v in verdicts}
