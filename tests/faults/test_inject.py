"""Failing calls, kills, full disks and changing files: a part of what the long run does to every command."""

import argparse
import itertools
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from faults import disk, load, long
from faults.changing import changing
from faults.fuzz import DONE, Fuzz, judge
from faults.hostile import HOSTILE
from faults.inject import CASES, Injection, Tally, inputs_into
from faults.originals import Original
from faults.pool import Job, Pool


@pytest.mark.faults
@pytest.mark.parametrize(
    ("case", "failure", "most"),
    [
        ("estimate", "write: disk full", 3),
        ("estimate", "write: a part only", 3),
        ("estimate", "fsync: I/O error", 3),
        ("estimate", "rename: I/O error", 1),
        ("estimate", "open: no permission", 3),
        ("estimate", "read: I/O error", 3),
        ("estimate", "allocation", 3),
        ("estimate", "allocation, and all after", 3),
        ("estimate", "killed after a write", 3),
        ("estimate", "killed after rename", 1),
        ("estimate a part", "write: disk full", 3),
        ("estimate a part", "rename: I/O error", 1),
        ("map", "rename: I/O error", 3),
        ("map", "allocation", 3),
        ("verify", "read: I/O error", 3),
        ("simulate", "write: disk full", 3),
    ],
)
def test_each_failing_call_leaves_a_whole_output_or_none(
    shim: Path | None, injection: Injection, case: str, failure: str, most: int
) -> None:
    if shim is None:
        pytest.skip("no C compiler")
    tally = injection.run(case, failure, most=most, report=lambda _: None)
    assert not tally.faults, "\n".join(tally.faults)
    assert tally.tried
    assert tally.done  # a call past the last one was asked for, too
    assert tally.refused or tally.killed or "a part only" in failure


@pytest.mark.faults
@pytest.mark.parametrize(("number", "count"), [(9, 6), (2, 2), (15, 2)])
def test_a_killed_run_resumes_to_the_same_output(injection: Injection, number: int, count: int) -> None:
    chance = random.Random(number)  # noqa: S311  no secret
    moments = [0.02, *(chance.random() for _ in range(count))]  # the first is met on any machine
    tally = injection.kill("estimate", moments, number=number, report=lambda _: None)
    assert not tally.faults, "\n".join(tally.faults)
    assert tally.killed


@pytest.mark.faults
@pytest.mark.parametrize("case", ["estimate", "report", "map"])
def test_limit_of_file_size_leaves_a_whole_output_or_none(injection: Injection, case: str) -> None:
    tally = injection.limit(case, [4096, 10_001], report=lambda _: None)
    assert not tally.faults, "\n".join(tally.faults)
    assert tally.refused


@pytest.mark.faults
def test_closed_folders_and_full_streams_are_refused(injection: Injection) -> None:
    for tally in (
        injection.closed("estimate", report=lambda _: None),
        injection.closed("map", report=lambda _: None),
        injection.device("info", report=lambda _: None),
    ):
        assert not tally.faults, "\n".join(tally.faults)
        assert tally.refused


@pytest.mark.faults
def test_full_and_read_only_disks_are_refused(injection: Injection, pool: Pool, folder: Path, tmp_path: Path) -> None:
    from faults.inject import inputs_into
    from faults.pool import Job

    with disk.small_disk(tmp_path / "disk") as place:
        if place is None:
            pytest.skip("no disk can be mounted")
        for case, free in itertools.product(("estimate", "simulate"), (0, 20_000)):
            tally = injection.fill(case, place, [free], report=lambda _: None)
            assert not tally.faults, "\n".join(tally.faults)
        inputs_into(folder, place)
        disk.make_read_only(place)
        for case in ("estimate", "export points", "reconcile"):
            outcome = pool.run(Job(argv=tuple(CASES[case].command.split()), cwd=str(place)))
            assert outcome.code == 4, outcome.err
            assert "Read-only file system" in outcome.err


@pytest.mark.faults
def test_a_recording_that_changes_is_refused_or_read_whole(pool: Pool) -> None:
    counts = changing(pool, 6, report=lambda _: None)
    assert set(counts) <= {"refused", "read as before", "read as after"}, counts


@pytest.mark.faults
def test_runs_side_by_side_do_not_disturb_each_other() -> None:
    faults: list[str] = []
    load.side_by_side(2, report=faults.append)
    assert not faults


@pytest.mark.faults
def test_memory_stays_the_same_over_many_recordings() -> None:
    faults: list[str] = []
    said = load.soak(20, report=faults.append)
    assert not faults, faults
    assert said.startswith("20 recordings in one process")


def _run(folder: Path, **options: object) -> long.Run:
    return long.Run(argparse.Namespace(output=folder, **options))


def test_a_stage_that_tries_nothing_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(long.STAGES, "soak", lambda _: ("all is well", 0))
    run = _run(tmp_path)
    assert run.stage("soak")["faults"] == ["soak: nothing was tried"]
    monkeypatch.setitem(long.STAGES, "soak", lambda _: ("all is well", 1))
    assert run.stage("soak")["faults"] == []


def test_failures_that_no_run_met_are_faults(tmp_path: Path) -> None:
    run = _run(tmp_path)
    tallies = [Tally("map", "SIGKILL", runs=3, killed=1), Tally("map", "SIGINT", runs=3)]
    assert long._must(run, tallies, "killed") == 6
    assert run.faults == ["SIGINT: not one run was killed"]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_command_ends_without_a_signal(originals: dict[str, Original], folder: Path, tmp_path: Path, case: str) -> None:
    assert originals
    inputs_into(folder, tmp_path)
    program = [sys.executable, "-m", "tofmix", *CASES[case].command.split()]
    done = subprocess.run(program, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode in DONE, done.stderr
    assert all((tmp_path / name).exists() for name in CASES[case].outputs)


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
