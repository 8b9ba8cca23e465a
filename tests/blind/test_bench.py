"""The bench's one command, on a small fixed part of its cases."""

import sys
from pathlib import Path

import pytest

from blind import bench

TESTS = Path(__file__).parents[1]


def test_a_small_part_is_scored_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Started again, the command finds nothing left to do."""
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
    copy = f"{sys.executable} -m blind.fake_reconcile copy"
    arguments = ["--output", str(tmp_path), "--select", "none-0", "--small", "--processes", "1", "--reconcile", copy]
    bench.main(arguments)
    (result,) = bench.read_results(tmp_path / "results.jsonl")
    assert result["verdict"] == "agree"
    assert result["named"] == []
    assert 0.8 < result["before"] < 1.25
    assert max(line[3] for line in result["panel"]) < 4.5
    first = (tmp_path / "results.jsonl").read_text()
    capsys.readouterr()
    bench.main(arguments)
    assert (tmp_path / "results.jsonl").read_text() == first
    assert "none: agree | 1/1 (100 %)" in capsys.readouterr().out


def test_the_sealed_half_needs_its_seed(tmp_path: Path) -> None:
    from blind.generate import selected

    halves = {case.half for case, _ in selected([], None)}
    assert halves == {"open"}
    sealed = [(case, master) for case, master in selected([], 7) if case.half == "sealed"]
    assert len(sealed) > 350
    assert {master for _, master in sealed} == {7}
    bench.main(["--output", str(tmp_path), "--select", "none-17", "--processes", "1"])  # a sealed one: nothing to do
    assert bench.read_results(tmp_path / "results.jsonl") == []
