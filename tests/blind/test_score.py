"""The bench's one command and its scoring, with stand-ins for the command that it judges."""

import json
import shlex
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.simulate_here import simulate_here

from blind import bench
from blind import effects as fx
from blind.bench import read_results
from blind.camera import Recording
from blind.cases import OPEN_SEED, Built, Case, all_cases, build
from blind.generate import selected
from blind.judge import judge
from blind.panel import compare, gap
from blind.score import RECONCILE, SIMULATIONS, Plan, score, true_effects
from blind.summary import summary


def _built(name: str, rows: int = 32, cols: int = 40, frames: int = 100) -> Built:
    case = next(c for c in all_cases() if c.name == name)
    return build(case, OPEN_SEED, camera={"rows": rows, "cols": cols, "frames": frames})


@pytest.mark.usefixtures("quick_calibration")
def test_reconcile_that_copies_the_model_closes_no_gap(fake: tuple[str, ...], tmp_path: Path) -> None:
    plan = Plan(reconcile=(*fake, "copy"), ceiling=False, simulate=simulate_here)
    result = score(_built("wiggling-clear-0-0", 24, 32, 60), tmp_path, plan)
    assert "failed" not in result
    assert (result["right"], result["first"], result["named"]) == (False, False, [])
    assert result["closed"] == 0
    assert result["before"] > 3 * result["floor"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("quick_calibration")
@pytest.mark.slow
def test_reconcile_that_knows_the_truth_scores_at_the_ceiling(fake: tuple[str, ...], tmp_path: Path) -> None:
    built = _built("pair-7")  # a fixed pattern and a warm-up: with a map
    (tmp_path / "truth").mkdir()
    handed = tmp_path / "truth" / "effects.json"
    handed.write_text(json.dumps(true_effects(built, handed.parent)))
    result = score(built, tmp_path / "work", Plan(reconcile=(*fake, str(handed)), simulate=simulate_here))
    assert "failed" not in result
    assert result["right"]
    assert result["first"]
    assert result["ceiling"] > 0.9
    assert result["closed"] == pytest.approx(result["ceiling"], abs=0.02)
    assert result["second_scene"]["closed"] > 0.9
    assert all(p["right"] for p in result["parameters"].values())
    line = tmp_path / "results.jsonl"
    line.write_text(json.dumps(result | {"master": OPEN_SEED}) + "\n")
    assert "pairs: both | 1/1 (100 %)" in summary(read_results(line))


@pytest.mark.usefixtures("quick_calibration")
def test_gaps_of_bursts_are_means_over_several_simulations(tmp_path: Path) -> None:
    built = _built("interference-clear-0-0", 16, 20, 40)
    seeds: list[int] = []

    def simulate(_model: Path, seed: int) -> Recording:
        seeds.append(seed)
        return built.record(0, ideal=len(seeds) % 2 == 1)

    result = score(built, tmp_path, Plan(reconcile=None, simulate=simulate))
    assert len(set(seeds)) == len(seeds) == 2 + SIMULATIONS["interference"]  # the first and the two-sample tests'
    gaps = [gap(compare(built.record(2), built.record(0, ideal=ideal))) for ideal in (True, False)]
    assert result["before"] == gaps[0]
    assert result["ceiling"] == pytest.approx(((gaps[0] - gaps[1]) / 2) / (gaps[0] - result["floor"]))


@pytest.mark.usefixtures("quick_calibration")
def test_command_that_fails_is_a_failed_case_with_its_reason(tmp_path: Path) -> None:
    command = (sys.executable, "-c", "raise SystemExit('no such effect')")
    result = score(
        _built("none-0", 16, 20, 40), tmp_path, Plan(reconcile=command, ceiling=False, simulate=simulate_here)
    )
    assert "no such effect" in result["failed"]
    assert "failed" in summary([result | {"half": "open"}])


def _said(kind: str, parameters: dict[str, Any], stderr: dict[str, float] | None = None) -> dict[str, Any]:
    effects = [{"kind": kind, "parameters": parameters, "stderr": stderr or {}}]
    return {"verdict": "explained", "effects": effects, "where": [{"axis": "range", "statistic": "bias"}]}


@pytest.mark.usefixtures("quick_calibration")
@pytest.mark.parametrize(
    "name",
    [
        f"{kind}-clear-0-0"
        for kind in (
            "wiggling",
            "multipath",
            "amplitude_walk",
            "dropout",
            "saturation",
            "motion",
            "scattering",
            "interference",
            "temperature_drift",
        )
    ],
)
def test_parameter_is_right_if_it_is_the_truth_and_wrong_if_off_by_30_percent(name: str, tmp_path: Path) -> None:
    built = _built(name, 24, 32, 60)
    (effect,) = built.truth()["effects"]
    kind, truth = effect["kind"], dict(effect["parameters"])
    good = judge(_said(kind, truth), built, tmp_path)
    assert good["right"]
    assert good["parameters"][kind]["right"]
    names = {
        "multipath": ["share"],
        "amplitude_walk": ["scale_mm"],
        "dropout": ["probability", "threshold"],
        "saturation": ["full_well_amplitude"],
    }
    off = {**truth, **{n: truth[n] * 1.3 for n in names.get(kind, [k for k in truth if k != "surface"])}}
    assert not judge(_said(kind, off), built, tmp_path)["parameters"][kind]["right"]


@pytest.mark.usefixtures("quick_calibration")
def test_parameter_off_by_2_errors_is_right_and_by_10_wrong(tmp_path: Path) -> None:
    built = _built("range_offset-clear-0-0", 16, 20, 30)
    offset = built.truth()["effects"][0]["parameters"]["offset_mm"]
    for error, right in ((0.05, True), (0.01, False)):
        said = _said("range_offset", {"offset_mm": 1.1 * offset}, {"offset_mm": error * abs(offset)})
        assert judge(said, built, tmp_path)["parameters"]["range_offset"]["right"] is right


@pytest.mark.usefixtures("quick_calibration")
def test_map_of_half_the_size_is_wrong(tmp_path: Path) -> None:
    built = _built("fixed_pattern-clear-0-0", 24, 32, 60)
    (lines,) = built.mechanisms
    assert isinstance(lines, fx.DelayLines)
    wanted = lines.map(built.device)
    for scale, right in ((1.02, True), (0.5, False)):
        np.save(tmp_path / "map.npy", scale * wanted)
        said = _said("fixed_pattern", {"map": "map.npy"})
        assert judge(said, built, tmp_path)["parameters"]["fixed_pattern"]["right"] is right


@pytest.mark.usefixtures("quick_calibration")
def test_place_of_a_stranger_is_right_on_its_axes_alone(tmp_path: Path) -> None:
    built = _built("kink-0", 16, 20, 30)
    said = {"verdict": "unexplained", "effects": [], "where": [{"axis": "range", "statistic": "bias"}]}
    assert judge(said, built, tmp_path)["axis_right"]
    said["where"] = [{"axis": "time", "statistic": "trend"}]
    assert not judge(said, built, tmp_path)["axis_right"]


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
    for length in (250, 400):
        assert shares(ordinary[:length]) == pytest.approx(
            shares(ordinary), abs=0.03
        )  # kinds have seven or eight cases each, and take turns: 200 end within one
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
