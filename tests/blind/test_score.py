"""The scoring, with stand-ins for the command that it judges."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.simulate_here import simulate_here

from blind import effects as fx
from blind.bench import read_results
from blind.camera import Recording
from blind.cases import OPEN_SEED, Built, all_cases, build
from blind.judge import judge
from blind.panel import compare, gap
from blind.score import SIMULATIONS, Plan, score, true_effects
from blind.summary import summary

pytestmark = pytest.mark.usefixtures("quick_calibration")


def _built(name: str, rows: int = 32, cols: int = 40, frames: int = 100) -> Built:
    case = next(c for c in all_cases() if c.name == name)
    return build(case, OPEN_SEED, camera={"rows": rows, "cols": cols, "frames": frames})


def test_reconcile_that_copies_the_model_closes_no_gap(fake: tuple[str, ...], tmp_path: Path) -> None:
    plan = Plan(reconcile=(*fake, "copy"), ceiling=False, simulate=simulate_here)
    result = score(_built("wiggling-clear-0-0", 24, 32, 60), tmp_path, plan)
    assert "failed" not in result
    assert (result["right"], result["first"], result["named"]) == (False, False, [])
    assert result["closed"] == 0
    assert result["before"] > 3 * result["floor"]
    assert list(tmp_path.iterdir()) == []


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


def test_parameter_off_by_2_errors_is_right_and_by_10_wrong(tmp_path: Path) -> None:
    built = _built("range_offset-clear-0-0", 16, 20, 30)
    offset = built.truth()["effects"][0]["parameters"]["offset_mm"]
    for error, right in ((0.05, True), (0.01, False)):
        said = _said("range_offset", {"offset_mm": 1.1 * offset}, {"offset_mm": error * abs(offset)})
        assert judge(said, built, tmp_path)["parameters"]["range_offset"]["right"] is right


def test_map_of_half_the_size_is_wrong(tmp_path: Path) -> None:
    built = _built("fixed_pattern-clear-0-0", 24, 32, 60)
    (lines,) = built.mechanisms
    assert isinstance(lines, fx.DelayLines)
    wanted = lines.map(built.device)
    for scale, right in ((1.02, True), (0.5, False)):
        np.save(tmp_path / "map.npy", scale * wanted)
        said = _said("fixed_pattern", {"map": "map.npy"})
        assert judge(said, built, tmp_path)["parameters"]["fixed_pattern"]["right"] is right


def test_place_of_a_stranger_is_right_on_its_axes_alone(tmp_path: Path) -> None:
    built = _built("kink-0", 16, 20, 30)
    said = {"verdict": "unexplained", "effects": [], "where": [{"axis": "range", "statistic": "bias"}]}
    assert judge(said, built, tmp_path)["axis_right"]
    said["where"] = [{"axis": "time", "statistic": "trend"}]
    assert not judge(said, built, tmp_path)["axis_right"]
