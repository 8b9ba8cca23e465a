"""A model with another noise and its text say the same."""

from dataclasses import replace

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.sensor import NoiseCurve
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import BACKGROUND_MAP, background_path, parse_model, with_noise

TEXT = """\
[sensor]
profile = "sr4000"
rows = 4
cols = 6
[sensor.noise]
# of the sheet
range_mm = [
    500.0, 5000.0,
]
sigma_mm = [4.0, 40.0]
[recording]
frames = 20
[[surface]]
center_mm = [0.0, 0.0, 2000.0]
size_mm = [900.0, 900.0]
"""
NOISE = TEXT[TEXT.index("[sensor.noise]") : TEXT.index("[recording]")]
BARE = TEXT.replace(NOISE, "")
CURVE = NoiseCurve(np.array([1000.0, 3000.0]), np.array([11.0, 22.0]), width_spread=0.25)


def model(text: str = TEXT) -> Model:
    return parse_model(text, source="a.toml")


@pytest.mark.parametrize(
    "text", [TEXT, TEXT.split("[sensor.noise]", maxsplit=1)[0] + TEXT[TEXT.index("[recording]") :]]
)
def test_text_of_a_model_with_another_noise_is_read_as_this_model(text: str) -> None:
    found = with_noise(model(text), CURVE)
    again = model(found.text)
    for each in (found, again):
        curve = each.sensor.noise_at(each.sensor.integration_time_ms)
        assert curve.sigma_mm.tolist() == [11.0, 22.0]
        assert curve.width_spread == 0.25
    assert again.surfaces == found.surfaces
    assert "of the sheet" not in found.text


@pytest.mark.parametrize(("step_mm", "steps"), [(None, []), (1.0, []), (8.0, [8.0])])
def test_step_above_one_mm_becomes_quantisation(step_mm: float | None, steps: list[float]) -> None:
    found = with_noise(model(), CURVE, step_mm=step_mm)
    for each in (found, model(found.text)):
        assert [e.step_mm for e in each.effects if e.kind == "quantisation"] == steps  # type: ignore[attr-defined]


def test_model_with_a_quantisation_of_its_own_keeps_it() -> None:
    own = model(TEXT + '[[effect]]\nkind = "quantisation"\nstep_mm = 5.0\n')
    assert len(with_noise(own, CURVE, step_mm=8.0).effects) == 1


def test_map_of_background_has_a_path_beside_the_model() -> None:
    found = with_noise(model(), replace(CURVE, background=np.full((4, 6), 0.02)))
    assert background_path(found) == BACKGROUND_MAP


def test_parts_that_the_profile_would_hand_on_are_written() -> None:
    law = "reference_amplitude = [9.0, 9.0]\namplitude = [5.0, 9.0]\namplitude_factor = [2.0, 1.0]\nbackground = 0.1\n"
    given = model(TEXT.replace("sigma_mm = [4.0, 40.0]\n", f"sigma_mm = [4.0, 40.0]\n{law}"))
    again = model(with_noise(given, CURVE).text)
    assert again.sensor.noise.sigma(2000.0, 5.0) == again.sensor.noise.sigma(2000.0, 9.0)
    assert again.sensor.noise.background == 0


def test_noise_in_another_form_than_a_table_is_refused() -> None:
    text = TEXT.replace(
        "[sensor.noise]\n# of the sheet\nrange_mm = [\n    500.0, 5000.0,\n]\nsigma_mm = [4.0, 40.0]\n", ""
    )
    inline = text.replace("cols = 6\n", "cols = 6\nnoise.range_mm = [500.0, 5000.0]\nnoise.sigma_mm = [4.0, 40.0]\n")
    with pytest.raises(BadInputError, match=r"\[sensor.noise\]"):
        with_noise(model(inline), CURVE)
