"""Failing calls, kills, full disks and changing files: a part of what the long run does to every command."""

import itertools
import random
from pathlib import Path

import pytest

from faults import disk, load
from faults.changing import changing
from faults.inject import CASES, Injection, chosen
from faults.pool import Pool


@pytest.mark.faults
@pytest.mark.parametrize(
    ("case", "failure", "most"),
    [
        ("estimate", "write: disk full", 5),
        ("estimate", "write: a part only", 3),
        ("estimate", "fsync: I/O error", 3),
        ("estimate", "rename: I/O error", 1),
        ("estimate", "open: no permission", 3),
        ("estimate", "read: I/O error", 4),
        ("estimate", "allocation", 3),
        ("estimate", "allocation, and all after", 3),
        ("estimate", "killed after a write", 4),
        ("estimate", "killed after rename", 1),
        ("estimate a part", "write: disk full", 4),
        ("estimate a part", "rename: I/O error", 1),
        ("map", "rename: I/O error", 3),
        ("map", "allocation", 4),
        ("verify", "read: I/O error", 6),
        ("simulate", "write: disk full", 4),
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


@pytest.mark.parametrize(
    ("calls", "most", "numbers"),
    [
        (3, 4, [1, 2, 3]),
        (3, None, [1, 2, 3]),
        (100, 6, [1, 2, 34, 66, 99, 100]),
        (0, 6, []),
    ],
)
def test_calls_are_chosen_at_both_ends_and_between(calls: int, most: int | None, numbers: list[int]) -> None:
    assert chosen(calls, most) == numbers


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
