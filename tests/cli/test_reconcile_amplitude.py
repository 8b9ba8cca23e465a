"""`reconcile` with a noise that depends on amplitude: the right law agrees, a model without it does not."""

import json
from pathlib import Path

import pytest
from support.commandline import Tofmix

LAW = """\
amplitude = [50.0, 200.0, 2000.0]
amplitude_factor = [4.0, 2.0, 0.2]
reference_amplitude = [900.0, 700.0, 500.0]
"""
MODEL = """\
[sensor]
profile = "sr4000"
rows = 16
cols = 24
[sensor.noise]
range_mm = [500.0, 2000.0, 5000.0]
sigma_mm = [6.0, 15.0, 40.0]
LAW[recording]
frames = 100
[[surface]]
name = "dark"
center_mm = [-500.0, 0.0, 1800.0]
size_mm = [800.0, 3000.0]
reflectivity = 0.1
[[surface]]
name = "bright"
center_mm = [500.0, 0.0, 1800.0]
size_mm = [1000.0, 3000.0]
reflectivity = 0.9
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
"""


@pytest.mark.slow
@pytest.mark.parametrize(("law", "agrees"), [(LAW, True), ("", False)])
def test_law_of_amplitude_changes_the_verdict(tofmix: Tofmix, tmp_path: Path, law: str, *, agrees: bool) -> None:
    (tmp_path / "real.toml").write_text(MODEL.replace("LAW", LAW))
    (tmp_path / "model.toml").write_text(MODEL.replace("LAW", law))
    assert tofmix("simulate", tmp_path / "real.toml", "-o", tmp_path / "a.h5").code == 0
    arguments = ("--effects", "range_offset,excess_noise", "--noise", "model", "-o", tmp_path / "gap")
    done = tofmix("reconcile", tmp_path / "model.toml", tmp_path / "a.h5", *arguments)
    assert done.code == 0, done.err
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert (gap["verdict"] == "agree") == agrees
    if not agrees:
        assert gap["where"][0]["statistic"] == "spread"
