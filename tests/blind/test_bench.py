"""The bench's one command, on a small fixed part of its cases."""

import json
import shlex
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from support.simulate_here import simulate_here

from blind import bench
from blind.cases import Case, build
from blind.generate import selected
from blind.score import RECONCILE, Plan, true_effects
from blind.summary import summary

TESTS = Path(__file__).parents[1]

NAME = "wiggling-clear-0-0"


@pytest.mark.slow
@pytest.mark.usefixtures("quick_calibration")
def test_scored_case_is_one_line_that_is_summed_up_and_not_scored_again(
    tmp_path: Path, fake: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """With a stand-in for `tofmix reconcile` that is handed the truth."""
    ((case, master),) = selected([NAME], None)
    built = build(case, master)
    built = replace(built, device=replace(built.device, **bench.SMALL))
    truth, results = tmp_path / "effects.json", tmp_path / "results.jsonl"
    truth.write_text(json.dumps(true_effects(built, tmp_path)))
    plan = Plan(reconcile=(*fake, str(truth)), ceiling=False, second=False, small=True, simulate=simulate_here)
    bench.run([(case, master, tmp_path / "work", plan)], results, processes=1)
    (wiggling,) = bench.read_results(results)
    assert (wiggling["verdict"], wiggling["named"]) == ("explained", ["wiggling"])
    assert wiggling["parameters"]["wiggling"]["right"]
    assert wiggling["closed"] > 0.9
    assert f"1/1 {NAME} explained wiggling" in capsys.readouterr().out
    first = results.read_text()
    bench.main(["--output", str(tmp_path), "--select", NAME, "--processes", "1"])
    assert results.read_text() == first
    assert "clear: named first | 1/1 (100 %)" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.long
def test_tofmix_reconcile_names_a_hidden_wave_on_the_bench(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All by commands, in a process of the bench's own, with a calibration that is whole."""
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
    rivals = "wiggling,range_offset,fixed_pattern,amplitude_walk"
    command = shlex.join([*RECONCILE, "--effects", rivals])
    arguments = ["--output", str(tmp_path), "--select", NAME, "--small", "--processes", "2", "--no-ceiling"]
    arguments += ["--reconcile", command]
    bench.main(arguments)
    (wiggling,) = bench.read_results(tmp_path / "results.jsonl")
    assert (wiggling["verdict"], wiggling["named"]) == ("explained", ["wiggling"])
    assert wiggling["parameters"]["wiggling"]["right"]
    assert wiggling["closed"] > 0.95
    assert wiggling["second_scene"]["closed"] > 0.95
    first, said = (tmp_path / "results.jsonl").read_text(), capsys.readouterr().out
    bench.main(arguments)
    assert (tmp_path / "results.jsonl").read_text() == first
    again = capsys.readouterr().out
    assert again in said
    assert "clear: named first | 1/1 (100 %)" in again


def test_sealed_half_is_left_out_without_its_seed(tmp_path: Path) -> None:
    assert {case.half for case, _ in selected([], None)} == {"open"}
    sealed = [(case, master) for case, master in selected([], 7) if case.half == "sealed"]
    assert len(sealed) > 350
    assert {master for _, master in sealed} == {7}
    bench.main(["--output", str(tmp_path), "--select", "none-17", "--processes", "1"])  # a sealed one: nothing to do
    assert bench.read_results(tmp_path / "results.jsonl") == []


def test_each_beginning_of_the_order_has_the_shares_of_all_cases() -> None:
    cases = selected([], 5)
    ordered = bench.fair_order(cases)
    assert sorted(case.name for case, _ in ordered) == sorted(case.name for case, _ in cases)

    def shares(some: list[tuple[Case, int]]) -> dict[tuple[str, str, str], float]:
        counted = Counter((case.half, case.sort, case.level) for case, _ in some)
        return {stratum: count / len(some) for stratum, count in counted.items()}

    ordinary = [pair for pair in ordered if pair[0].setting == "ordinary"]
    for length in (200, 400):
        assert shares(ordinary[:length]) == pytest.approx(
            shares(ordinary), abs=0.03
        )  # kinds have seven or eight cases each, and take turns
        others = sum(case.setting != "ordinary" for case, _ in ordered[:length]) / length
        assert others == pytest.approx(1 - len(ordinary) / len(ordered), abs=0.03)


def test_summary_has_a_section_and_two_sample_columns_for_each_setting() -> None:
    line = {
        "case": "pinhole-none-0",
        "half": "open",
        "sort": "none",
        "level": "",
        "setting": "pinhole",
        "verdict": "agree",
        "named": [],
        "before": 1.0,
        "seconds": 1.0,
        "truth": {"kinds": []},
        "panel": [["bias", "all", 1.0, 0.5]],
        "two_samples": {
            when: {"energy": [0.3, 2.4, 0.4], "energy_pixel": [9.0, 8.0, 0.01], "classifier": [0.501, 0.505, 0.3]}
            for when in ("before", "after")
        },
    }
    said = summary([line, {**line, "case": "none-0", "setting": "ordinary"}])
    assert "## open half, pinhole" in said
    assert "## open half\n" in said
    assert (
        "| pinhole | none |  | agree | 1 | 0/1 (0.3) | 1/1 (9) | 0/1 (0.501) | 0/1 (0.3) | 1/1 (9) | 0/1 (0.501) |"
        in said
    )
