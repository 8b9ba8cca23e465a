import hashlib
import json
import runpy
import tomllib
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from blind.cases import OPEN_SEED, Built, all_cases, build, strengths
from blind.eligible import EVERY, FAMILIES, INSEPARABLE
from blind.generate import write_case
from blind.scenes import FAMILIES as SCENES
from blind.strangers import STRANGERS
from blind.strength import KINDS, NO_BLIND_TWIN, UNITS
from blind.write import read_recording
from tofmix.simulation.effects import EFFECTS

pytestmark = pytest.mark.usefixtures("quick_calibration")
CAMERA = {"rows": 16, "cols": 20, "frames": 40}
DRAWN = {
    "wiggling-clear-0-0": "03b962f9b48d81b7",
    "pair-0": "58c510058ff663d8",
    "nearly-2": "3e11b7f553dca417",
    "dark_noise-0": "3bc74a6f022836ce",
    "flying_pixels-clear-0-0": "5836d9191c8864d4",
    "phase_wrapping-clear-0-0": "6f49985d834a1449",
    "dropout-clear-1-1": "0171931d15ac6733",
    "amplitude_walk-faint-0-1": "892912c05ec94b61",
    "scattering-clear-2-4": "0b089cfb87f79067",
    "saturation-clear-0-0": "e87fa47a21210c4f",
    "none-0": "10917c6534ccf555",
    "interference-faint-1-2": "499a2d1f57bcd749",
}
CONTRACT = Path(__file__).parents[3] / "shared" / "check_contract.py"


def _small(name: str) -> Built:
    case = next(c for c in all_cases() if c.name == name)
    return build(case, OPEN_SEED, camera=CAMERA)


def test_list_of_cases_has_each_kind_level_and_half_in_the_stated_number() -> None:
    assert len({c.name for c in all_cases()}) == len(all_cases())
    cases = [c for c in all_cases() if c.setting == "ordinary"]
    assert cases == all_cases()[: len(cases)]
    assert Counter(c.sort for c in cases) == {
        "single": len(KINDS) * 2 * 5 * 3,
        "pair": 20,
        "none": 30,
        "nearly": 30,
        "stranger": 4 * len(STRANGERS),
    }
    assert len(STRANGERS) >= 15
    assert abs(Counter(c.half for c in cases)["open"] - len(cases) / 2) < len(KINDS)
    assert len(set(EVERY)) >= 8


def test_kinds_of_the_bench_are_those_of_the_package() -> None:
    assert all(NO_BLIND_TWIN.values()), "give each kind of NO_BLIND_TWIN (tests/blind/strength.py) its reason"
    wanted = set(EFFECTS) - set(NO_BLIND_TWIN)
    assert set(KINDS) == wanted, (
        "write the kind a second time, independently, in tests/blind/effects.py, and add it to MAKERS in"
        " tests/blind/strength.py; or give the reason against it in NO_BLIND_TWIN there"
    )
    assert set(UNITS) == wanted, "add the kind to UNITS in tests/blind/strength.py"
    assert set(strengths()) == wanted, "add the kind to tests/blind/strengths.toml"
    assert set(FAMILIES) == wanted, "add the kind to FAMILIES in tests/blind/eligible.py"
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


@pytest.mark.parametrize(("name", "drawn"), DRAWN.items())
def test_ordinary_case_is_drawn_as_before_there_were_other_settings(name: str, drawn: str) -> None:
    """Digests of what 21faa3d drew: camera, scenes, models, truth and the seeds of the recordings.

    Those with a wave or a walk are of the laws with harmonics and saturation.
    """
    built = _small(name)
    what = [built.truth(), [asdict(s) for s in (*built.scenes[0], *built.models[1])], built.seeds, built.families]
    what += [getattr(built.device, key) for key in ("name", "frequency_hz", "frame_rate_hz", "noise_square")]
    rounded = json.loads(json.dumps(what), parse_float=lambda text: f"{float(text):.8g}")
    assert hashlib.sha256(json.dumps(rounded).encode()).hexdigest()[:16] == drawn


@pytest.mark.parametrize(
    "name",
    [
        "fixed_pattern-clear-0-0",
        "pair-0",
        "nearly-1",
        "tripod-2",
        "dropout-clear-2-0",
        "room_light-none-1",
        "room_light-dropout-clear-1",
        "pinhole-multipath-clear-3",
        "missing_object-2",
    ],
)
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
