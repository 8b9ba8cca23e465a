import json
import runpy
import tomllib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blind.cases import OPEN_SEED, Built, Case, all_cases, build, strengths
from blind.eligible import EVERY, FAMILIES, INSEPARABLE
from blind.generate import write_case
from blind.scenes import FAMILIES as SCENES
from blind.strangers import STRANGERS
from blind.strength import KINDS, UNITS
from blind.write import read_recording
from tofmix.simulation.effects.registry import EFFECTS

pytestmark = pytest.mark.usefixtures("quick_calibration")
CAMERA = {"rows": 16, "cols": 20, "frames": 40}
CONTRACT = Path(__file__).parents[3] / "shared" / "check_contract.py"


def _small(name: str) -> Built:
    case = next(c for c in all_cases() if c.name == name)
    return build(case, OPEN_SEED, camera=CAMERA)


def test_list_of_cases_has_each_kind_level_and_half_as_often_as_said() -> None:
    cases = all_cases()
    assert len({c.name for c in cases}) == len(cases)
    assert Counter(c.sort for c in cases) == {
        "single": len(KINDS) * 2 * 5 * 3, "pair": 20, "none": 30, "nearly": 30, "stranger": 4 * len(STRANGERS),
    }  # fmt: skip
    assert len(STRANGERS) >= 15
    assert abs(Counter(c.half for c in cases)["open"] - len(cases) / 2) < len(KINDS)
    assert len(set(EVERY)) >= 8


def test_kinds_of_the_bench_are_those_of_the_package() -> None:
    assert set(KINDS) == set(EFFECTS) == set(UNITS) == set(strengths()) == set(FAMILIES)
    for kind, families in FAMILIES.items():
        assert set(families) <= set(SCENES), kind
    for hidden, rival, _ in INSEPARABLE:
        assert {hidden, rival} <= set(KINDS)


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "phase_wrapping"])
def test_faint_is_at_least_twice_the_strength_that_a_detector_finds(kind: str) -> None:
    strength = strengths()[kind]
    wanted = max(2 * strength["found"], strength.get("floor", 0.0))
    assert strength["found"] > 0
    assert strength["faint"] == pytest.approx(wanted, rel=0.08)
    assert strength["clear"] > 3 * strength["faint"]


def test_case_is_a_function_of_its_name_and_the_master_seed() -> None:
    case = next(c for c in all_cases() if c.name == "multipath-clear-0-0")
    one, two, other = (build(case, master, camera=CAMERA) for master in (5, 5, 6))
    assert one.truth() == two.truth()
    assert one.scenes == two.scenes
    assert one.seeds == two.seeds
    assert one.truth() != other.truth()
    assert one.scenes != other.scenes


@pytest.mark.parametrize("name", ["fixed_pattern-clear-0-0", "pair-0", "nearly-1", "tripod-2", "dropout-clear-2-0"])
def test_folder_of_a_case_fits_the_contract_and_hides_its_truth(name: str, tmp_path: Path) -> None:
    built = _small(name)
    write_case(tmp_path, built)
    truth = json.loads((tmp_path / "truth.json").read_text())
    for k, stem in enumerate(("", "_second_scene")):
        model = tomllib.loads((tmp_path / f"model{stem}.toml").read_text())
        assert "effect" not in model
        assert [s["name"] for s in model["surface"]] == [s.name for s in built.models[k]]
        recording = read_recording(tmp_path / f"measured{stem}.h5")
        assert recording.range_mm.shape == (40, 16, 20)
        np.testing.assert_array_equal(recording.range_mm, built.record(k).range_mm)
        if CONTRACT.exists():
            check = runpy.run_path(str(CONTRACT))["check"]
            assert list(check(tmp_path / f"measured{stem}.h5")) == []
    assert truth["kinds"] == [e["kind"] for e in truth["effects"]]
    assert ("stranger" in truth) == (built.case.sort == "stranger")


def test_nearly_right_model_is_off_by_the_contracts_tolerance() -> None:
    built = _small("nearly-1")
    noise = build(replace(built.case, sort="none"), OPEN_SEED, camera=CAMERA).noise
    assert np.abs(built.noise.sigma_mm / noise.sigma_mm - 1).max() == pytest.approx(0.01)
    for there, model in zip(built.scenes[0], built.models[0], strict=True):
        assert abs(model.reflectivity / there.reflectivity - 1) == pytest.approx(0.05)
        assert 0 < np.linalg.norm(np.subtract(model.center_mm, there.center_mm)) < 15


def test_case_made_by_hand_is_in_the_list_and_has_no_effect() -> None:
    case = Case(name="none-0", sort="none", kinds=(), level="", slot=0, seed=0, half="open")
    assert case in all_cases()
    assert build(case, OPEN_SEED, camera=CAMERA).truth()["effects"] == []
