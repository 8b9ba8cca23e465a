"""Noise curves, shapes, backgrounds, what a sensor carries of them, and the table of a camera's numbers."""

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tofmix.estimation.mixture.counting import FALSE_ALARMS
from tofmix.noise_shape import BackgroundDensity, LearntNoise, NoiseShape
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensor_schema import NUMBERS, RARE_SENSOR_NUMBERS, SENSOR_NUMBERS
from tofmix.sensors import Camera


def test_sigma_is_linear_between_points_and_constant_past_the_ends() -> None:
    curve = NoiseCurve(np.array([1000.0, 2000.0]), np.array([10.0, 30.0]))
    np.testing.assert_allclose(curve.sigma(np.array([0.0, 1000.0, 1250.0, 2000.0, 9000.0])), [10, 10, 15, 30, 30])
    np.testing.assert_allclose(curve.scaled(2.0).sigma(1500.0), 40)


@pytest.mark.parametrize(
    ("range_mm", "sigma_mm", "reason"),
    [
        ([], [], "two lists"),
        ([1.0, 2.0], [1.0], "two lists"),
        ([1.0, np.nan], [1.0, 1.0], "not finite"),
        ([2.0, 1.0], [1.0, 1.0], "ascend"),
        ([1.0, 1.0], [1.0, 1.0], "ascend"),
        ([1.0, 2.0], [1.0, -3.0], "sigma is -3 mm at 2 mm"),
        ([1.0, 2.0], [0.0, 1.0], "sigma is 0 mm at 1 mm"),
        ([1.0, 2.0], [1.0, np.inf], "sigma is inf mm"),
        ([1.0, 2.0], [np.nan, 1.0], "sigma is nan mm"),
    ],
)
def test_unfit_curves_are_refused(range_mm: list[float], sigma_mm: list[float], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        NoiseCurve(np.array(range_mm), np.array(sigma_mm))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("modulation_frequency_hz", 0.0),
        ("modulation_frequency_hz", 1e300),
        ("modulation_frequency_hz", 1e-300),
        ("integration_time_ms", -1.0),
        ("range_max_mm", np.inf),
        ("fov_vertical_deg", np.nan),
        ("range_min_mm", np.nan),
        ("range_min_mm", 9000.0),
        ("outlier_probability", 1.0),
        ("outlier_probability", -0.1),
        ("outlier_probability", np.nan),
    ],
)
def test_unfit_sensors_are_refused(key: str, value: float) -> None:
    settings: dict[str, Any] = {"name": "x", "range_max_mm": 5000.0, key: value}
    with pytest.raises(ValueError, match=key):
        Sensor(**settings)


@pytest.mark.parametrize(
    ("known", "lock_in"),
    [
        ({}, None),
        ({"measurement": "lock-in"}, True),
        ({"measurement": "pulses"}, False),
        ({"measurement": "stereo"}, False),
        ({"modulation_frequency_hz": 47.5e6}, True),
        ({"measurement": "stereo", "modulation_frequency_hz": 47.5e6}, True),
    ],
)
def test_a_camera_is_lock_in_by_its_measurement_or_by_a_frequency(known: dict[str, Any], lock_in: bool | None) -> None:
    assert Sensor(name="camera", **known).is_lock_in is lock_in


def test_an_unknown_measurement_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match='measurement: "phase" is not one of lock-in, pulses, stereo'):
        Sensor(name="camera", measurement="phase")  # type: ignore[arg-type]  # a text of a user


FORMATS = (Path(__file__).parents[1] / "docs" / "reference" / "formats.md").read_text(encoding="utf-8")


def test_numbers_of_a_camera_are_fields_of_what_files_are_read_into() -> None:
    of_recordings = {*SENSOR_NUMBERS, *RARE_SENSOR_NUMBERS}
    assert of_recordings <= {field.name for field in fields(Sensor)}
    assert set(NUMBERS) - set(RARE_SENSOR_NUMBERS) <= {field.name for field in fields(Camera)}
    assert NUMBERS["range_max_mm"].refusal(1e6)
    assert not NUMBERS["range_max_mm"].refusal(1e6, limited=False)


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


CHANCES = len(FALSE_ALARMS)


def _values(**other: Any) -> dict[str, Any]:  # noqa: ANN401  fields of LearntNoise
    return {
        "background": (1.0, 9.0),
        "drift_mm": np.array([3.0, 0.0, 1.0]),
        "memory": 0.2,
        "gain_samples": np.array([10.0, 100.0]),
        "gain_background": np.array([0.0, 0.1, 0.6]),
        "gain_more": np.arange(6.0 * CHANCES).reshape(2, 3, CHANCES),
        "gain_first": np.arange(2.0 * CHANCES).reshape(2, CHANCES),
    } | other


@pytest.mark.parametrize(
    ("other", "text"),
    [
        ({"drift_mm": np.zeros(2)}, "drift_mm: 2 numbers, not 3"),
        ({"drift_mm": np.array([1.0, -1.0, 0.0])}, "drift_mm: expected 1 dimensions of finite numbers, none negative"),
        ({"drift_mm": np.zeros((1, 3))}, "drift_mm: expected 1 dimensions"),
        ({"gain_more": np.full((2, 3, CHANCES), np.nan)}, "gain_more: expected 3 dimensions of finite numbers"),
        ({"gain_more": np.zeros((2, 2, CHANCES))}, "tables of gains differ in size"),
        ({"gain_first": np.zeros((2, CHANCES - 1))}, "tables of gains differ in size"),
        ({"gain_samples": np.array([10.0])}, "tables of gains differ in size"),
        ({"gain_samples": np.zeros(0)}, "gain_samples"),
        ({"memory": 1.0}, r"memory 1 is not in \[0, 1\)"),
        ({"memory": -0.1}, "memory -0.1"),
        ({"memory": np.nan}, "memory nan"),
        ({"background": (0.0, 1.0)}, "background: two finite numbers above 0"),
        ({"background": (1.0, np.inf)}, "background: two finite numbers above 0"),
    ],
)
def test_learnt_noise_out_of_bounds_is_refused_by_name(other: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        LearntNoise(**_values(**other))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("background", None),
        ("background", (1.0, 9.5)),
        ("memory", 0.3),
        ("drift_mm", [3.0, 0.0, 1.5]),
        ("gain_samples", [10.0, 101.0]),
        ("gain_background", [0.0, 0.1, 0.7]),
        ("gain_more", np.arange(6.0 * CHANCES).reshape(2, 3, CHANCES) + 1e-9),
        ("gain_first", np.ones((2, CHANCES))),
    ],
)
def test_any_other_number_is_another_noise(name: str, value: object) -> None:
    one, other = LearntNoise(**_values()), LearntNoise(**_values(**{name: value}))
    assert not one.same_as(other)
    assert not other.same_as(one)


Z = np.linspace(-12.0, 12.0, 2401)


def test_shapes_have_the_chances_of_their_density() -> None:
    shape = NoiseShape(Z, stats.norm.pdf(Z))
    at = np.linspace(-4.0, 4.0, 33)
    np.testing.assert_allclose(shape.cdf(at), stats.norm.cdf(at), atol=5e-6)
    np.testing.assert_allclose(shape.quantile(stats.norm.cdf(at)), at, atol=1e-4)
    np.testing.assert_allclose(shape.moments(), [0.0, 1.0, 0.0, 0.0], atol=1e-3)
    places = np.linspace(0.0, 400.0, 4001)
    shape = NoiseShape.standardised(places, stats.gamma.pdf(places, 4.0, scale=10.0))
    low, middle, high = shape.quantile(stats.norm.cdf([-1.0, 0.0, 1.0]))
    assert middle == pytest.approx(0.0, abs=1e-9)
    assert high - low == pytest.approx(2.0, abs=1e-9)
    assert shape.moments()[2] == pytest.approx(1.0, abs=0.01)  # 2 / sqrt(4)
    rng = np.random.default_rng(4)
    for points in (11, 57, 200):
        once = NoiseShape.standardised(np.sort(rng.normal(0.0, 3.0, points)), rng.uniform(0.1, 1.0, points))
        assert NoiseShape(once.z, once.density).same_as(once)
    shape = NoiseShape.standardised([-3.0, -1.0, 0.0, 2.0, 3.0, 6.0], [0.0, 1.0, 2.0, 0.1, 0.0, 0.0])
    chance = np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(shape.cdf(shape.quantile(chance)), chance, atol=1e-12)


@pytest.mark.parametrize(
    ("z", "density", "text"),
    [
        ([0.0, 1.0], [1.0, 1.0], "at least 3"),
        ([0.0, 2.0, 1.0], [1.0, 1.0, 1.0], "ascend"),
        ([-1.0, 0.0, 1.0], [1.0, -1.0, 1.0], "at least 0"),
        ([-1.0, 0.0, 1.0], [0.0, 0.0, 0.0], "above 0"),
        ([-1.0, 0.0, np.inf], [1.0, 1.0, 1.0], "finite"),
        (Z + 1.0, stats.norm.pdf(Z), "got 1 and 1"),
        (2.0 * Z, stats.norm.pdf(Z), "and 2"),
    ],
)
def test_invalid_noise_shapes_are_refused_with_the_reason(z: list[float], density: list[float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        NoiseShape(np.array(z), np.array(density))


FOG = BackgroundDensity(np.array([0.0, 200.0, 700.0, 2000.0, 9000.0]), np.array([1e-3, 8.0, 3.0, 0.2, 0.01]))


def test_densities_of_background_have_an_area_of_one_and_quantiles_that_invert_it() -> None:
    at = np.linspace(0.0, 9000.0, 90_001)
    assert np.trapezoid(FOG.at(at), at) == pytest.approx(1.0, abs=1e-6)
    assert BackgroundDensity(FOG.range_mm, FOG.density).same_as(FOG)
    uniform = BackgroundDensity.uniform(300.0, 5300.0)
    np.testing.assert_allclose(uniform.at([0.0, 300.0, 1000.0, 9000.0]), 2e-4, rtol=1e-12)
    np.testing.assert_allclose(uniform.quantile([0.0, 0.25, 1.0]), [300.0, 1550.0, 5300.0], rtol=1e-12)
    chance = np.linspace(0.0, 1.0, 101)
    at = np.linspace(0.0, 9000.0, 900_001)
    below = np.concatenate([[0.0], np.cumsum(0.5 * (FOG.at(at)[1:] + FOG.at(at)[:-1]) * np.diff(at))])
    np.testing.assert_allclose(np.interp(FOG.quantile(chance), at, below), chance, atol=1e-6)


@pytest.mark.parametrize(
    ("range_mm", "density", "said"),
    [
        ([0.0], [1.0], "at least 2"),
        ([0.0, 1.0, 2.0], [1.0, 1.0], "one length"),
        ([0.0, 1.0, 1.0], [1.0, 1.0, 1.0], "do not ascend"),
        ([0.0, 1.0], [1.0, 0.0], "not above 0"),
        ([0.0, 1.0], [1.0, np.nan], "not finite"),
    ],
)
def test_a_density_that_cannot_be_is_refused(range_mm: list[float], density: list[float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        BackgroundDensity(np.array(range_mm), np.array(density))
