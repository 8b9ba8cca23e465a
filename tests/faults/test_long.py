"""The long run itself: what tries nothing is a fault, and what cannot be run is said."""

import argparse
import subprocess
from contextlib import nullcontext
from pathlib import Path

import pytest

from faults import disk, long
from faults.inject import Tally


def _run(folder: Path, **options: object) -> long.Run:
    return long.Run(argparse.Namespace(output=folder, **options))


def test_a_stage_that_tries_nothing_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(long.STAGES, "soak", lambda _: ("all is well", 0))
    run = _run(tmp_path)
    assert run.stage("soak")["faults"] == ["soak: nothing was tried"]
    monkeypatch.setitem(long.STAGES, "soak", lambda _: ("all is well", 1))
    assert run.stage("soak")["faults"] == []


def test_missing_compiler_or_fuzzer_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long, "compiled", lambda _: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    run = _run(tmp_path, guided=1)
    for stage in ("failing calls", "guided"):
        done = run.stage(stage)
        assert "not run" in done["text"]
        assert done["faults"] == [f"{stage}: nothing was tried"]


def test_failures_that_no_run_met_are_faults(tmp_path: Path) -> None:
    run = _run(tmp_path)
    tallies = [Tally("map", "SIGKILL", runs=3, killed=1), Tally("map", "SIGINT", runs=3)]
    assert long._must(run, tallies, "killed") == 6
    assert run.faults == ["SIGINT: not one run was killed"]


def test_unmountable_disk_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "small_disk", lambda _: nullcontext(None))
    monkeypatch.setattr(long, "make", lambda *_: {})
    monkeypatch.setattr(long, "CASES", {})
    monkeypatch.setattr(long, "WRITING", ())
    faults = _run(tmp_path).stage("full disks")["faults"]
    assert faults == [
        "no disk can be mounted here: neither the full nor the read-only one was run",
        "full disks: nothing was tried",
    ]


@pytest.mark.parametrize(
    ("said", "count"), [("- 10 passing, 0 failing", 30), ("- 10 passing examples, 0 failing", 30), ("", 0)]
)
def test_examples_of_the_properties_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str, count: int
) -> None:
    done = subprocess.CompletedProcess([], 0, stdout=f"{said}\n" * 3 + "7 passed in 3 s")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    assert _run(tmp_path, property_times=2).stage("properties")["tried"] == count
