"""The table of a camera's numbers: its fields, its bounds, and the reference of files, which says the same."""

import math
from dataclasses import fields
from pathlib import Path

import pytest

from tofmix.sensor import Sensor
from tofmix.sensor_schema import NUMBERS, RARE_SENSOR_NUMBERS, SENSOR_NUMBERS
from tofmix.sensors import Camera

FORMATS = (Path(__file__).parents[1] / "docs" / "reference" / "formats.md").read_text(encoding="utf-8")


def test_each_number_is_a_field_of_what_files_of_its_kind_are_read_into() -> None:
    of_recordings = {*SENSOR_NUMBERS, *RARE_SENSOR_NUMBERS}
    assert of_recordings <= {field.name for field in fields(Sensor)}
    assert set(NUMBERS) - set(RARE_SENSOR_NUMBERS) <= {field.name for field in fields(Camera)}


@pytest.mark.parametrize("name", [*SENSOR_NUMBERS, *RARE_SENSOR_NUMBERS])
def test_the_reference_has_each_attribute_with_its_unit_and_description(name: str) -> None:
    number = NUMBERS[name]
    assert f"| `{name}` | {number.unit} | {number.words} |" in FORMATS.splitlines()


@pytest.mark.parametrize("name", [name for name in NUMBERS if name not in RARE_SENSOR_NUMBERS])
def test_the_example_of_a_model_has_each_key(name: str) -> None:
    example = FORMATS[FORMATS.index("[sensor]\nprofile") :]
    assert f"\n{name} = " in example[: example.index("```")]


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("rows", (1, 4096), (0, 4097)),
        ("fov_horizontal_deg", (1e-9, 360.0), (0.0, 360.1, math.nan)),
        ("range_min_mm", (-5.0, 1e9), (math.inf, math.nan)),
        ("outlier_probability", (0.0, 0.999), (-1e-9, 1.0, math.nan)),
        ("exponent", (0.0, 5.0), (-1e-9, math.inf)),
    ],
)
def test_values_at_the_bounds_are_taken_or_refused_as_declared(
    name: str, inside: tuple[float, ...], outside: tuple[float, ...]
) -> None:
    assert [NUMBERS[name].refusal(value) for value in inside] == [""] * len(inside)
    assert all(NUMBERS[name].refusal(value) for value in outside)


def test_a_recording_may_have_values_above_those_of_a_simulated_camera() -> None:
    assert NUMBERS["range_max_mm"].refusal(1e6)
    assert not NUMBERS["range_max_mm"].refusal(1e6, limited=False)
