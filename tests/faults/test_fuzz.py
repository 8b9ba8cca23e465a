"""Mutants are done or refused in one clear line; the long run makes thousands, this a fixed hundred or two."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from faults.fuzz import Fuzz, judge
from faults.mutants import mutate
from faults.originals import Original, parts_with_learnt_noise
from faults.pool import Outcome, Pool

MUTANTS = 154
GOOD = Outcome(code=0, hung=False, out="", err="", seconds=0.1, cpu_s=0.1, extra_bytes=0, calls=0)
REFUSED = replace(GOOD, code=3, err="tofmix: mutant.h5: not an HDF5 file\n")


@pytest.mark.faults
def test_mutants_are_done_or_refused(fuzz: Fuzz, originals: dict[str, Original]) -> None:
    verdicts = list(fuzz.run(list(originals), MUTANTS, seed=0))
    assert len(verdicts) == MUTANTS
    faults = [f"{v.fault}: {v.mutant}: {v.command}: {v.change}: {v.outcome.err}" for v in verdicts if v.fault]
    assert not faults, "\n".join(faults)
    by_kind = {kind: Counter(v.result for v in verdicts if v.kind == kind) for kind in originals}
    assert all(results["refused"] for results in by_kind.values()), by_kind
    assert sum(results["refused"] == results.total() for results in by_kind.values()) <= 3, by_kind


@pytest.mark.faults
def test_mutants_of_parts_with_learnt_noise_are_done_or_refused(pool: Pool, tmp_path: Path) -> None:
    kind = "part with learnt noise"
    verdicts = list(Fuzz(tmp_path, pool, parts_with_learnt_noise(tmp_path, pool)).run([kind], 20, seed=0))
    faults = [f"{v.fault}: {v.mutant}: {v.command}: {v.change}: {v.outcome.err}" for v in verdicts if v.fault]
    assert not faults, "\n".join(faults)
    assert {v.result for v in verdicts} >= {"done", "refused"}


@pytest.mark.parametrize(
    ("outcome", "names", "fault"),
    [
        (GOOD, {"out.csv"}, ""),
        (REFUSED, set(), ""),
        (replace(GOOD, code=6), set(), ""),
        (replace(GOOD, hung=True, code=-9), set(), "hang"),
        (replace(GOOD, code=-11), set(), "signal 11"),
        (replace(GOOD, code=1, err="Traceback (most recent call last):\n"), set(), "traceback"),
        (replace(REFUSED, err="Traceback (most recent call last):\n"), set(), "traceback"),
        (replace(REFUSED, code=9), set(), "exit code 9"),
        (replace(GOOD, extra_bytes=2 * 10**9), set(), "memory"),
        (replace(REFUSED, err="RuntimeWarning: overflow\n" + REFUSED.err), set(), "stray line on stderr"),
        (replace(REFUSED, err=""), set(), "no reason"),
        (replace(REFUSED, err="tofmix: other.h5: truncated\n"), set(), "file not named"),
        (GOOD, {".out.csv.partial"}, "files left"),
        (REFUSED, {"out.csv"}, "output of a failed run"),
    ],
)
def test_each_fault_is_seen(outcome: Outcome, names: set[str], fault: str) -> None:
    assert judge(outcome, names, mutant="mutant.h5") == fault


@pytest.mark.faults
def test_a_seed_makes_the_same_mutant(originals: dict[str, Original], tmp_path: Path) -> None:
    for kind in ("foreign recording", "model", "npz"):
        for number in range(8):
            twice = []
            for name in ("a", "b"):
                path, change = mutate(originals[kind], f"{kind} {number}", tmp_path / name)
                twice.append((path.read_bytes() if change.startswith(("bytes", "text")) else b"", change))
            assert twice[0] == twice[1]
            assert twice[0][1]
