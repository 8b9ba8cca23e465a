"""The bench's one command and its scoring, with stand-ins for the command that it judges."""

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
from support.simulate_here import simulate_here

from blind import bench
from blind.bench import read_results
from blind.cases import OPEN_SEED, Built, all_cases, build
from blind.generate import selected
from blind.judge import judge
from blind.score import RECONCILE, Plan, score, true_effects
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


TESTS = Path(__file__).parents[1]

NAME = "wiggling-clear-0-0"


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
