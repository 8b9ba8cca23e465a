"""The scoring, with stand-ins for the command that it judges."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blind import effects as fx
from blind.bench import read_results
from blind.camera import Recording
from blind.cases import OPEN_SEED, Built, all_cases, build
from blind.judge import judge
from blind.panel import compare, gap
from blind.score import SIMULATIONS, Plan, score, true_effects
from blind.summary import summary

pytestmark = pytest.mark.usefixtures("quick_calibration")
TESTS = Path(__file__).parents[1]


def _built(name: str, rows: int = 32, cols: int = 40, frames: int = 100) -> Built:
    built = build(next(c for c in all_cases() if c.name == name), OPEN_SEED)
    return replace(built, device=replace(built.device, rows=rows, cols=cols, frames=frames))


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
    return (sys.executable, "-m", "blind.fake_reconcile")


def test_a_reconcile_that_copies_the_model_scores_nothing(fake: tuple[str, ...], tmp_path: Path) -> None:
    result = score(_built("wiggling-clear-0-0"), tmp_path, Plan(reconcile=(*fake, "copy"), ceiling=False))
    assert "failed" not in result
    assert (result["right"], result["first"], result["named"]) == (False, False, [])
    assert result["closed"] == 0
    assert result["before"] > 3 * result["floor"]
    assert list(tmp_path.iterdir()) == []


def test_a_reconcile_that_is_handed_the_truth_scores_at_the_ceiling(fake: tuple[str, ...], tmp_path: Path) -> None:
    built = _built("pair-7")  # a fixed pattern and a warm-up: with a map
    (tmp_path / "truth").mkdir()
    handed = tmp_path / "truth" / "effects.json"
    handed.write_text(json.dumps(true_effects(built, handed.parent)))
    result = score(built, tmp_path / "work", Plan(reconcile=(*fake, str(handed))))
    assert "failed" not in result
    assert result["right"]
    assert result["first"]
    assert result["ceiling"] > 0.9
    assert result["closed"] == pytest.approx(result["ceiling"], abs=0.02)
    assert result["second_scene"]["closed"] > 0.9
    assert all(p["right"] for p in result["parameters"].values())
    line = tmp_path / "results.jsonl"
    line.write_text(json.dumps(result | {"master": OPEN_SEED}) + "\n")
    text = summary(read_results(line))
    assert "pairs: both | 1/1 (100 %)" in text


def test_where_bursts_come_by_luck_simulations_are_averaged(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    built = _built("interference-clear-0-0", 16, 20, 40)
    seeds: list[int] = []

    def simulate(_model: Path, seed: int) -> Recording:
        seeds.append(seed)
        return built.record(0, ideal=len(seeds) % 2 == 1)

    monkeypatch.setattr("blind.score.simulate", simulate)
    result = score(built, tmp_path, Plan(reconcile=None))
    assert len(set(seeds)) == len(seeds) == 1 + SIMULATIONS["interference"]
    gaps = [gap(compare(built.record(2), built.record(0, ideal=ideal))) for ideal in (True, False)]
    assert result["before"] == gaps[0]
    assert result["ceiling"] == pytest.approx(((gaps[0] - gaps[1]) / 2) / (gaps[0] - result["floor"]))


def test_a_command_that_fails_is_a_failed_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{TESTS}:{TESTS.parent}")
    plan = Plan(reconcile=(sys.executable, "-c", "raise SystemExit('no such effect')"), ceiling=False)
    result = score(_built("none-0", 16, 20, 40), tmp_path, plan)
    assert "no such effect" in result["failed"]
    assert "failed" in summary([result | {"half": "open"}])


def _said(kind: str, parameters: dict[str, Any], stderr: dict[str, float] | None = None) -> dict[str, Any]:
    effects = [{"kind": kind, "parameters": parameters, "stderr": stderr or {}}]
    return {"verdict": "explained", "effects": effects, "where": [{"axis": "range", "statistic": "bias"}]}


@pytest.mark.parametrize(
    "name",
    [f"{kind}-clear-0-0" for kind in ("wiggling", "multipath", "amplitude_walk", "dropout", "saturation", "motion",
                                      "scattering", "interference", "temperature_drift")],
)  # fmt: skip
def test_parameters_are_right_within_5_percent_or_3_errors(name: str, tmp_path: Path) -> None:
    built = _built(name, 24, 32, 60)
    (effect,) = built.truth()["effects"]
    kind, truth = effect["kind"], dict(effect["parameters"])
    good = judge(_said(kind, truth), built, tmp_path)
    assert good["right"]
    assert good["parameters"][kind]["right"]
    names = {"multipath": ["share"], "amplitude_walk": ["scale_mm"], "dropout": ["probability", "threshold"],
             "saturation": ["full_well_amplitude"]}  # fmt: skip
    off = {**truth, **{n: truth[n] * 1.3 for n in names.get(kind, [k for k in truth if k != "surface"])}}
    assert not judge(_said(kind, off), built, tmp_path)["parameters"][kind]["right"]


def test_standard_errors_forgive(tmp_path: Path) -> None:
    built = _built("range_offset-clear-0-0", 16, 20, 30)
    offset = built.truth()["effects"][0]["parameters"]["offset_mm"]
    for error, right in ((0.05, True), (0.01, False)):
        said = _said("range_offset", {"offset_mm": 1.1 * offset}, {"offset_mm": error * abs(offset)})
        assert judge(said, built, tmp_path)["parameters"]["range_offset"]["right"] is right


def test_maps_are_compared_as_maps(tmp_path: Path) -> None:
    built = _built("fixed_pattern-clear-0-0", 24, 32, 60)
    (lines,) = built.mechanisms
    assert isinstance(lines, fx.DelayLines)
    wanted = lines.map(built.device)
    for scale, right in ((1.02, True), (0.5, False)):
        np.save(tmp_path / "map.npy", scale * wanted)
        said = _said("fixed_pattern", {"map": "map.npy"})
        assert judge(said, built, tmp_path)["parameters"]["fixed_pattern"]["right"] is right


def test_a_stranger_s_place_is_judged_by_its_axes(tmp_path: Path) -> None:
    built = _built("kink-0", 16, 20, 30)
    said = {"verdict": "unexplained", "effects": [], "where": [{"axis": "range", "statistic": "bias"}]}
    assert judge(said, built, tmp_path)["axis_right"]
    said["where"] = [{"axis": "time", "statistic": "trend"}]
    assert not judge(said, built, tmp_path)["axis_right"]
