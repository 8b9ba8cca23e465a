"""The built-in cameras."""

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.sensors import (
    PROFILES,
    camera_of_model,
    load_camera,
    load_profile,
    parse_camera,
    parse_profile,
    profiles_with_noise,
)
from tofmix.simulation.model_toml import parse_model
from tofmix.toml_table import parse_toml


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


def test_profile_with_gaps_is_refused_for_simulation_with_its_gaps() -> None:
    with pytest.raises(BadInputError, match=r"profile vl53l5cx: VL53L5CX: not known: integration_time_ms, noise, outl"):
        load_profile("vl53l5cx")


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


def test_only_profiles_with_a_curve_are_offered_for_noise() -> None:
    assert profiles_with_noise() == ("sr3000", "sr4000", "stoc")


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


def test_sr4000_has_the_published_noise_and_no_range_better_than_a_shot_noise_law() -> None:
    profile = load_profile("sr4000")
    assert (profile.rows, profile.cols, profile.modulation_frequency_hz) == (144, 176, 30.0e6)
    assert float(profile.noise_at(8.5).sigma(1300.0)) == pytest.approx(4.0)
    assert float(profile.noise_at(9.75).sigma(1300.0)) == pytest.approx(3.7, abs=0.05)
    ranges = np.linspace(profile.range_min_mm, profile.range_max_mm, 200)
    law = 4.0 * np.maximum(ranges / 1300.0, (ranges / 1300.0) ** 2)
    np.testing.assert_allclose(profile.noise.sigma(ranges), law, rtol=0.02)
    assert profile.turn_mm("a test") == pytest.approx(4996.5, abs=0.1)


def test_stoc_is_table_1_with_a_finite_range_and_the_noise_of_triangulation() -> None:
    profile = load_profile("stoc")
    assert (profile.rows, profile.cols) == (480, 640)
    assert (profile.fov_horizontal_deg, profile.fov_vertical_deg) == (65.5, 51.5)
    assert (profile.range_min_mm, profile.range_max_mm) == (686.0, 10_000.0)
    ranges = np.linspace(686.0, 10_000.0, 200)
    np.testing.assert_allclose(profile.noise_at(5.0).sigma(ranges), 0.1 * ranges**2 / (686 * 64), rtol=0.02)
    for word in ("PUBLISHED", "CHOSEN", "DERIVED", "ASSUMED"):
        assert any(word in source for source in profile.sources)


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
