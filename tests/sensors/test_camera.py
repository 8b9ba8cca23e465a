"""A camera: what may be missing of it, its table, every refusal, and the built-in ones."""

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.noise_shape import NoiseShape
from tofmix.optics.pinhole import Pinhole
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensors import (
    PROFILES,
    UNKNOWN,
    Camera,
    CompleteCamera,
    camera_of_model,
    load_camera,
    load_profile,
    parse_camera,
    parse_profile,
    profiles_with_noise,
)
from tofmix.sensors.camera_toml import noise_toml
from tofmix.simulation.model_toml import parse_model
from tofmix.toml_table import parse_toml

CURVE = NoiseCurve(np.array([1000.0]), np.array([8.0]))


def test_camera_without_gaps_equals_its_complete_camera() -> None:
    camera, profile = load_camera("sr3000"), load_profile("sr3000")
    assert camera.missing() == ()
    for key in ("rows", "cols", "fov_horizontal_deg", "range_max_mm", "exponent", "outlier_probability"):
        assert getattr(camera, key) == getattr(profile, key)
    mine, theirs = camera.sensor().noise, profile.sensor().noise
    assert mine is not None
    assert theirs is not None
    np.testing.assert_array_equal(mine.sigma_mm, theirs.sigma_mm)


def test_cameras_with_gaps_are_refused_where_values_are_needed() -> None:
    sensor = UNKNOWN.sensor()
    assert sensor.name == "unknown"
    assert sensor.noise is None
    for key in ("range_min_mm", "range_max_mm", "fov_horizontal_deg", "modulation_frequency_hz"):
        assert getattr(sensor, key) is None
    assert "reference_integration_time_ms" not in noise_toml(CURVES[0], integration_time_ms=None)
    curve = NoiseCurve(RANGE, SIGMA, background=np.array([[0.0, 0.25]]))
    assert "background = 0.125" in noise_toml(curve, integration_time_ms=1.0)
    assert 'background = "b.npy"' in noise_toml(curve, integration_time_ms=1.0, background="b.npy")
    with pytest.raises(BadInputError, match=r"profile vl53l5cx: VL53L5CX: not known: integration_time_ms, noise, outl"):
        load_profile("vl53l5cx")
    assert profiles_with_noise() == ("sr3000", "sr4000", "stoc")


def test_noise_without_a_time_is_used_only_where_it_does_not_depend_on_time() -> None:
    law = Camera(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.5)
    assert law.sensor().noise is None
    constant = Camera(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.0)
    assert constant.sensor().noise is CURVE
    timed = Camera(name="a", noise=CURVE, reference_integration_time_ms=10.0, exponent=0.5, integration_time_ms=2.5)
    noise = timed.sensor().noise
    assert noise is not None
    assert noise.sigma_mm.tolist() == [16.0]


@pytest.mark.parametrize(
    "change",
    [
        {"rows": 0},
        {"cols": 5000},
        {"fov_horizontal_deg": 361.0},
        {"fov_vertical_deg": 181.0},
        {"fov_vertical_deg": math.nan},
        {"range_min_mm": 5.0, "range_max_mm": 4.0},
        {"outlier_probability": 1.0},
        {"noise": CURVE},
        {"exponent": 0.5},
        {"reference_integration_time_ms": 0.0, "noise": CURVE, "exponent": 0.5},
        {"exponent": -1.0, "noise": CURVE, "reference_integration_time_ms": 10.0},
        {"integration_time_ms": 0.0, "noise": CURVE, "reference_integration_time_ms": 10.0, "exponent": 0.5},
        {"exponent": 5000.0, "noise": CURVE, "reference_integration_time_ms": 10.0, "integration_time_ms": 1.0},
    ],
)
def test_invalid_sensor_values_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change)).split("_")[0]):
        Camera(name="a", **change)  # type: ignore[arg-type]


@pytest.fixture
def profile() -> CompleteCamera:
    return load_profile("sr3000")


def test_noise_follows_the_integration_time_in_any_number_of_steps(profile: CompleteCamera) -> None:
    for tau in (0.2, 1.2, 10.0, 51.0):
        np.testing.assert_allclose(profile.noise_at(tau).sigma_mm, profile.noise.sigma_mm * (10.0 / tau) ** 0.5)
    np.testing.assert_array_equal(profile.noise_at(10.0).range_mm, profile.noise.range_mm)
    other = replace(profile, noise=profile.noise_at(1.2), reference_integration_time_ms=1.2)
    np.testing.assert_allclose(other.noise_at(3.4).sigma_mm, profile.noise_at(3.4).sigma_mm)
    sensor = replace(profile, integration_time_ms=1.2).sensor()
    assert sensor.integration_time_ms == 1.2
    assert sensor.noise is not None
    np.testing.assert_allclose(sensor.noise.sigma_mm, profile.noise_at(1.2).sigma_mm)
    for key in ("name", "modulation_frequency_hz", "range_min_mm", "range_max_mm", "fov_horizontal_deg"):
        assert getattr(sensor, key) == getattr(profile, key)


@pytest.mark.parametrize(
    "change",
    [
        {"rows": 0},
        {"cols": 4097},
        {"fov_horizontal_deg": 361.0},
        {"fov_vertical_deg": 0.0},
        {"range_min_mm": -1.0},
        {"range_min_mm": 8000.0},
        {"range_max_mm": 65_001.0},
        {"modulation_frequency_hz": 0.0},
        {"integration_time_ms": float("nan")},
        {"default_integration_time_ms": 0.0},
        {"reference_integration_time_ms": float("inf")},
        {"outlier_probability": 1.0},
        {"outlier_probability": float("nan")},
        {"exponent": -0.1},
    ],
)
def test_values_out_of_bounds_are_refused(profile: CompleteCamera, change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(change))}: "):
        replace(profile, **change)


SR3000 = '[sensor]\nprofile = "sr3000"\n'
PINHOLE = 'projection = "pinhole"\nfx = 125.7\nfy = 138.3\ncx = 87.5\ncy = 71.5\n'
ALONE = """[sensor]
rows = 12
cols = 16
range_min_mm = 300.0
range_max_mm = 6000.0
integration_time_ms = 1.0
outlier_probability = 1e-4
PROJECTION
[sensor.noise]
range_mm = [1000.0]
sigma_mm = [10.0]
reference_integration_time_ms = 1.0
exponent = 0.5
"""


def sensor(text: str) -> CompleteCamera:
    return camera_of_model(parse_toml(text, source="camera.toml"))


def test_pinhole_takes_the_place_of_a_field_of_view_and_equiangular_is_the_default() -> None:
    camera = sensor(SR3000 + PINHOLE + "distortion = [-0.1, 0.0, 0.0, 0.0, 0.0]\n")
    expected = Pinhole(fx=125.7, fy=138.3, cx=87.5, cy=71.5, distortion=(-0.1, 0.0, 0.0, 0.0, 0.0))
    assert camera.projection == camera.optics == expected
    assert camera.sensor().optics == expected
    assert (camera.fov_horizontal_deg, camera.fov_vertical_deg) == (None, None)
    camera = sensor(ALONE.replace("PROJECTION", 'projection = "pinhole"\nfx = 10.0\nfy = 10.0\ncx = 8\ncy = 6\n'))
    assert camera.optics == Pinhole(fx=10.0, fy=10.0, cx=8.0, cy=6.0)
    given = parse_camera("[sensor]\n" + PINHOLE, source="camera.toml")
    assert given.sensor().optics == Pinhole(fx=125.7, fy=138.3, cx=87.5, cy=71.5)
    assert "fov_horizontal_deg" not in given.missing()
    named, unnamed = sensor(SR3000 + 'projection = "equiangular"\n'), sensor(SR3000)
    assert named.optics == unnamed.optics
    assert named.projection is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            SR3000 + 'projection = "pinholes"\n',
            'camera.toml: [sensor]: projection: "pinholes" is not a projection; did you mean "pinhole"?',
        ),
        (
            SR3000 + "fx = 1.0\n",
            'camera.toml: [sensor]: fx: does not belong to the projection equiangular; add projection = "pinhole"',
        ),
        (SR3000 + 'projection = "pinhole"\nfx = 1.0\n', "camera.toml: [sensor]: projection: pinhole needs fy, cx, cy"),
        (SR3000 + PINHOLE.replace("125.7", "-1"), "camera.toml: [sensor]: fx: -1 is not a finite number above 0"),
        (SR3000 + PINHOLE + "distortion = -0.1\n", "camera.toml: [sensor]: distortion: expected a list of numbers"),
        (SR3000 + PINHOLE + "distortion = [-0.1]\n", "camera.toml: [sensor]: distortion: 1 numbers; expected OpenCV's"),
        (
            SR3000 + PINHOLE + "distortion = [-0.9, 0, 0, 0]\n",
            "camera.toml: [sensor]: distortion: it folds, or cannot be undone, 31.3 degrees off the axis at most;",
        ),
        (
            ALONE.replace("PROJECTION", ""),
            "camera.toml: [sensor]: missing fov_horizontal_deg, fov_vertical_deg;",
        ),
    ],
)
def test_refusals_name_file_key_value_and_remedy(text: str, message: str) -> None:
    with pytest.raises(BadInputError, match="^" + re.escape(message)):
        sensor(text)


RANGE, SIGMA = np.array([500.0, 1234.5, 7500.0]), np.array([3.25, 7.0, 151.125])
LAW = AmplitudeLaw(
    reference=np.array([900.0, 300.0, 20.0]), amplitude=np.array([10.0, 100.0]), factor=np.array([3.0, 1.0])
)
WIDE = np.linspace(-6, 6, 121)
SHAPE = NoiseShape(z=WIDE, density=np.exp(-0.5 * WIDE**2) + 1e-4)
FINE = np.linspace(-16, 16, 513)  # points as of noise with long tails
LONG_TAILED = NoiseShape(z=FINE, density=np.exp(-0.5 * FINE**2) + 1e-5)
CURVES = (
    NoiseCurve(RANGE, SIGMA),
    NoiseCurve(RANGE, SIGMA, law=LAW),
    NoiseCurve(RANGE, SIGMA, shape=SHAPE, width_spread=0.125, background=np.array(0.03125)),
    NoiseCurve(RANGE, SIGMA, law=LAW, shape=LONG_TAILED),
)


@pytest.mark.parametrize("curve", CURVES, ids=["sigma", "amplitude", "shape, widths, background", "long tails"])
def test_table_is_read_as_the_same_curve(curve: NoiseCurve) -> None:
    table = noise_toml(curve, integration_time_ms=2.5, exponent=0.5)
    sensor = parse_model(f'[sensor]\nprofile = "sr3000"\n{table}', source="a.toml").sensor
    assert sensor.reference_integration_time_ms == 2.5
    assert sensor.noise.sigma_mm.tolist() == curve.sigma_mm.tolist()
    assert sensor.noise.range_mm.tolist() == curve.range_mm.tolist()
    assert sensor.noise.width_spread == curve.width_spread
    if curve.law is not None:
        assert sensor.noise.law is not None
        assert sensor.noise.law.factor.tolist() == curve.law.factor.tolist()
    if curve.shape is not None:
        assert sensor.noise.shape is not None
        assert sensor.noise.shape.density == pytest.approx(curve.shape.density, abs=1e-5)
    if curve.background is not None:
        assert sensor.noise.background == curve.background


@pytest.mark.parametrize("name", PROFILES)
def test_every_profile_reads_and_has_sources(name: str) -> None:
    camera = load_camera(name)
    assert camera.sources
    assert camera.integration_time_ms == camera.default_integration_time_ms


@pytest.mark.parametrize("name", [name for name in PROFILES if load_camera(name).missing()])
def test_each_number_of_a_profile_with_gaps_has_a_source_and_each_gap_a_note(name: str) -> None:
    camera = load_camera(name)
    numbers = set(camera.known()) - {"name", "confirmed", "sources"}
    named = {key.strip() for text in camera.sources for key in text.split(":")[0].replace(". ", ", ").split(",")}
    assert numbers <= named | {part for text in camera.sources for part in text.replace(":", " ").split()}
    assert any(text.startswith("Not known:") for text in camera.sources)
    sensor = camera.sensor()
    assert sensor.noise is None
    for key in ("range_min_mm", "range_max_mm", "fov_horizontal_deg", "fov_vertical_deg", "projection"):
        assert getattr(sensor, key) == getattr(camera, key)


def test_a_model_may_fill_the_gaps_of_a_profile() -> None:
    gaps = """
integration_time_ms = 10.0
outlier_probability = 1.0e-4
[sensor.noise]
range_mm = [100.0, 4000.0]
sigma_mm = [5.0, 40.0]
reference_integration_time_ms = 10.0
exponent = 0.5
"""
    with pytest.raises(BadInputError, match=r"missing integration_time_ms, noise.range_mm, noise.sigma_mm, outlier_pr"):
        parse_model('[sensor]\nprofile = "vl53l5cx"\n', source="m")
    camera = camera_of_model(parse_toml('[sensor]\nprofile = "vl53l5cx"\n' + gaps, source="m"))
    assert (camera.rows, camera.fov_vertical_deg, camera.range_max_mm) == (8, 45.0, 4000.0)
    assert float(camera.noise.sigma(4000.0)) == 40.0


@pytest.mark.parametrize(("name", "view"), [("kinect-v2", "70.6 x 60.0"), ("l515", "70.0 x 55.0")])
def test_a_derived_pinhole_spans_the_field_of_view_that_its_source_gives(name: str, view: str) -> None:
    camera = load_camera(name)
    assert camera.projection is not None
    assert camera.rows is not None
    assert camera.cols is not None
    assert camera.projection.words((camera.rows, camera.cols)) == f"{view} degrees of a pinhole"
    assert f"{view.replace('.0', '')} degrees" in " ".join(camera.sources)


def test_sr3000_is_the_papers_camera_and_marked_as_unconfirmed() -> None:
    profile = load_profile("sr3000")
    assert (profile.rows, profile.cols) == (144, 176)
    assert (profile.fov_horizontal_deg, profile.fov_vertical_deg) == (47.0, 39.0)
    assert (profile.range_min_mm, profile.range_max_mm) == (650.0, 7500.0)
    assert profile.default_integration_time_ms == 10.0
    assert not profile.confirmed
    assert any("UNCONFIRMED" in source for source in profile.sources)
    for range_mm, sigma_mm in [(300, 2.5), (1000, 6), (2000, 13), (3000, 24)]:
        assert float(profile.noise.sigma(range_mm)) == pytest.approx(sigma_mm)


def test_camera_without_phase_refuses_effects_on_the_phase_in_one_line() -> None:
    profile = load_profile("stoc")
    assert profile.modulation_frequency_hz is None
    assert profile.sensor().modulation_frequency_hz is None
    with pytest.raises(
        BadInputError, match=r"^\[sensor\]: modulation_frequency_hz: STOC has none, and wiggling acts on"
    ):
        profile.turn_mm("wiggling")


@pytest.mark.parametrize("name", ["sr300", "SR3000", "", "../sr3000", "a\nb"])
def test_unknown_camera_is_refused_in_one_line_with_the_known_ones(name: str) -> None:
    with pytest.raises(BadInputError, match=r"is not a built-in sensor; .*sr3000") as caught:
        load_profile(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[abut]", 'p: "abut" is not a key here; did you mean "about"?'),
        ("[about]\nconfirmd = true", 'did you mean "confirmed"?'),
        ("[about]\nconfirmed = 1\n", "p: no table \\[sensor\\]"),
    ],
)
def test_a_profile_file_is_read_as_strictly_as_a_model(text: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        parse_profile(text, source="p")


PULSES = {"l515", "vl53l0x", "vl53l1x", "vl53l5cx", "vl53l8cx", "tmf8828", "tmf8829"}


@pytest.mark.parametrize("name", PROFILES)
def test_each_profile_declares_what_its_camera_measures(name: str) -> None:
    expected = "pulses" if name in PULSES else "stereo" if name == "stoc" else "lock-in"
    sensor = load_camera(name).sensor()
    assert sensor.measurement == expected
    assert sensor.is_lock_in is (expected == "lock-in")


def test_a_file_inherits_or_overrides_the_measurement_of_its_profile() -> None:
    assert parse_camera('[sensor]\nprofile = "tmf8828"\n', source="a.toml").measurement == "pulses"
    own = '[sensor]\nprofile = "tmf8828"\nmeasurement = "lock-in"\n'
    assert parse_camera(own, source="a.toml").sensor().measurement == "lock-in"
    with pytest.raises(BadInputError, match=r'a\.toml: \[sensor\]: measurement: "Lock-In" is not one of lock-in, '):
        parse_camera('[sensor]\nmeasurement = "Lock-In"\n', source="a.toml")
