"""`projection` in ``[sensor]``: its keys, what it takes from the profile, and every refusal in one line."""

import re

import pytest

from tofmix.errors import BadInputError
from tofmix.optics.pinhole import Pinhole
from tofmix.sensors.profile import SensorProfile
from tofmix.sensors.sensor_file import parse_sensor, sensor_of
from tofmix.toml_table import parse_toml

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


def sensor(text: str) -> SensorProfile:
    return sensor_of(parse_toml(text, source="camera.toml"))


def test_a_pinhole_takes_the_place_of_the_profiles_field_of_view() -> None:
    camera = sensor(SR3000 + PINHOLE + "distortion = [-0.1, 0.0, 0.0, 0.0, 0.0]\n")
    expected = Pinhole(fx=125.7, fy=138.3, cx=87.5, cy=71.5, distortion=(-0.1, 0.0, 0.0, 0.0, 0.0))
    assert camera.projection == camera.optics == expected
    assert camera.sensor().optics == expected
    assert (camera.fov_horizontal_deg, camera.fov_vertical_deg) == (None, None)


def test_camera_with_a_pinhole_and_no_profile_needs_no_field_of_view() -> None:
    camera = sensor(ALONE.replace("PROJECTION", 'projection = "pinhole"\nfx = 10.0\nfy = 10.0\ncx = 8\ncy = 6\n'))
    assert camera.optics == Pinhole(fx=10.0, fy=10.0, cx=8.0, cy=6.0)


def test_a_sheet_may_know_the_pinhole_alone() -> None:
    sheet = parse_sensor("[sensor]\n" + PINHOLE, source="camera.toml")
    assert sheet.sensor().optics == Pinhole(fx=125.7, fy=138.3, cx=87.5, cy=71.5)
    assert "fov_horizontal_deg" not in sheet.missing()


def test_equiangular_by_name_is_as_if_it_were_left_out() -> None:
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
