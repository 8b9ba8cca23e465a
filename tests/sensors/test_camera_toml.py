"""The table ``[sensor]``: `projection` and its keys, and every refusal of them in one line; the noise as a table."""

import re

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.noise_shape import NoiseShape
from tofmix.optics.pinhole import Pinhole
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensors import CompleteCamera, camera_of_model, parse_camera
from tofmix.sensors.camera_toml import noise_toml
from tofmix.simulation.model_toml import parse_model
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


def sensor(text: str) -> CompleteCamera:
    return camera_of_model(parse_toml(text, source="camera.toml"))


def test_a_pinhole_takes_the_place_of_the_profiles_field_of_view() -> None:
    camera = sensor(SR3000 + PINHOLE + "distortion = [-0.1, 0.0, 0.0, 0.0, 0.0]\n")
    expected = Pinhole(fx=125.7, fy=138.3, cx=87.5, cy=71.5, distortion=(-0.1, 0.0, 0.0, 0.0, 0.0))
    assert camera.projection == camera.optics == expected
    assert camera.sensor().optics == expected
    assert (camera.fov_horizontal_deg, camera.fov_vertical_deg) == (None, None)


def test_camera_with_a_pinhole_and_no_profile_needs_no_field_of_view() -> None:
    camera = sensor(ALONE.replace("PROJECTION", 'projection = "pinhole"\nfx = 10.0\nfy = 10.0\ncx = 8\ncy = 6\n'))
    assert camera.optics == Pinhole(fx=10.0, fy=10.0, cx=8.0, cy=6.0)


def test_a_camera_may_know_the_pinhole_alone() -> None:
    camera = parse_camera("[sensor]\n" + PINHOLE, source="camera.toml")
    assert camera.sensor().optics == Pinhole(fx=125.7, fy=138.3, cx=87.5, cy=71.5)
    assert "fov_horizontal_deg" not in camera.missing()


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


RANGE, SIGMA = np.array([500.0, 1234.5, 7500.0]), np.array([3.25, 7.0, 151.125])
LAW = AmplitudeLaw(
    reference=np.array([900.0, 300.0, 20.0]), amplitude=np.array([10.0, 100.0]), factor=np.array([3.0, 1.0])
)
WIDE = np.linspace(-6, 6, 121)
SHAPE = NoiseShape(z=WIDE, density=np.exp(-0.5 * WIDE**2) + 1e-4)
CURVES = (
    NoiseCurve(RANGE, SIGMA),
    NoiseCurve(RANGE, SIGMA, law=LAW),
    NoiseCurve(RANGE, SIGMA, shape=SHAPE, width_spread=0.125, background=np.array(0.03125)),
)


@pytest.mark.parametrize("curve", CURVES, ids=["sigma", "amplitude", "shape, widths, background"])
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


def test_table_of_an_unknown_integration_time_leaves_it_to_the_model() -> None:
    assert "reference_integration_time_ms" not in noise_toml(CURVES[0], integration_time_ms=None)


def test_map_of_background_is_a_path_or_its_mean() -> None:
    curve = NoiseCurve(RANGE, SIGMA, background=np.array([[0.0, 0.25]]))
    assert "background = 0.125" in noise_toml(curve, integration_time_ms=1.0)
    assert 'background = "b.npy"' in noise_toml(curve, integration_time_ms=1.0, background="b.npy")
