"""The built-in cameras."""

import pytest

from tofmix.errors import BadInputError
from tofmix.sensors import PROFILES, load_profile
from tofmix.sensors.profile_toml import parse_profile


@pytest.mark.parametrize("name", PROFILES)
def test_every_profile_reads_and_has_sources(name: str) -> None:
    profile = load_profile(name)
    assert profile.sources
    assert profile.integration_time_ms == profile.default_integration_time_ms


def test_sr3000_is_the_papers_camera_and_says_that_it_is_unconfirmed() -> None:
    profile = load_profile("sr3000")
    assert (profile.rows, profile.cols) == (144, 176)
    assert (profile.fov_horizontal_deg, profile.fov_vertical_deg) == (47.0, 39.0)
    assert (profile.range_min_mm, profile.range_max_mm) == (650.0, 7500.0)
    assert profile.default_integration_time_ms == 10.0
    assert not profile.confirmed
    assert any("UNCONFIRMED" in source for source in profile.sources)
    for range_mm, sigma_mm in [(300, 2.5), (1000, 6), (2000, 13), (3000, 24)]:
        assert float(profile.noise.sigma(range_mm)) == pytest.approx(sigma_mm)


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
        ("[about]\nconfirmed = 1\n", "p: \\[sensor\\]: missing rows"),
    ],
)
def test_a_profile_file_is_read_as_strictly_as_a_model(text: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        parse_profile(text, source="p")
