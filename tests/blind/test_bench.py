"""The bench's one command, on a small fixed part of its cases."""

from collections import Counter
from pathlib import Path

import pytest

from blind import bench
from blind.cases import Case
from blind.generate import selected

TESTS = Path(__file__).parents[1]


def test_a_small_part_is_built_and_scored_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By `tofmix reconcile` itself, which names what is hidden.

    Started again, the command finds nothing left to do.
    """
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
    arguments = [
        "--output",
        str(tmp_path),
        "--select",
        "wiggling-clear-0-0",
        "--small",
        "--processes",
        "1",
        "--no-ceiling",
    ]
    bench.main(arguments)
    (wiggling,) = bench.read_results(tmp_path / "results.jsonl")
    assert (wiggling["verdict"], wiggling["named"]) == ("explained", ["wiggling"])
    assert wiggling["parameters"]["wiggling"]["right"]
    assert wiggling["closed"] > 0.95
    assert wiggling["second_scene"]["closed"] > 0.95
    first = (tmp_path / "results.jsonl").read_text()
    said = capsys.readouterr().out
    bench.main(arguments)
    assert (tmp_path / "results.jsonl").read_text() == first
    again = capsys.readouterr().out
    assert again in said
    assert "clear: named first | 1/1 (100 %)" in again


def test_the_sealed_half_needs_its_seed(tmp_path: Path) -> None:
    from blind.generate import selected

    halves = {case.half for case, _ in selected([], None)}
    assert halves == {"open"}
    sealed = [(case, master) for case, master in selected([], 7) if case.half == "sealed"]
    assert len(sealed) > 350
    assert {master for _, master in sealed} == {7}
    bench.main(["--output", str(tmp_path), "--select", "none-17", "--processes", "1"])  # a sealed one: nothing to do
    assert bench.read_results(tmp_path / "results.jsonl") == []


def test_every_beginning_of_the_order_is_a_fair_sample() -> None:
    cases = selected([], 5)
    ordered = bench.fair_order(cases)
    assert sorted(case.name for case, _ in ordered) == sorted(case.name for case, _ in cases)

    def shares(some: list[tuple[Case, int]]) -> dict[tuple[str, str, str], float]:
        counted = Counter((case.half, case.sort, case.level) for case, _ in some)
        return {stratum: count / len(some) for stratum, count in counted.items()}

    for length in (200, 400):
        assert shares(ordered[:length]) == pytest.approx(
            shares(cases), abs=0.03
        )  # kinds have seven or eight cases each, and take turns
