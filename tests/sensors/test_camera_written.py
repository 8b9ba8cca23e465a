"""A camera as the tables of a model file: what is written is read back."""

from dataclasses import replace

import numpy as np
import pytest

from tofmix.arrays import Float32Array
from tofmix.noise_shape import NoiseShape
from tofmix.optics.pinhole import Pinhole
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensor_schema import Measurement
from tofmix.sensors import camera_of_model
from tofmix.sensors.camera import CompleteCamera
from tofmix.sensors.camera_toml import camera_toml
from tofmix.toml_table import parse_toml

CURVE = NoiseCurve(np.array([500.0, 2000.0]), np.array([4.0, 9.0]))
CAMERA = CompleteCamera(
    name='two "eyes" \N{GRINNING FACE}\x7f\t',
    rows=6,
    cols=8,
    fov_horizontal_deg=1.0 / 3.0,
    fov_vertical_deg=12.0,
    range_min_mm=0.1,
    range_max_mm=7500.0,
    integration_time_ms=2.5,
    default_integration_time_ms=2.5,
    noise=CURVE,
    reference_integration_time_ms=2.5,
    exponent=0.5,
    outlier_probability=1e-5,
)
LENS = Pinhole(fx=9.0, fy=9.5, cx=3.25, cy=2.5, distortion=(0.01, 0.0, 0.0, 0.0, 0.0))
Z = np.linspace(-8.0, 8.0, 129)


def _read_back(camera: CompleteCamera, background: Float32Array | None = None) -> CompleteCamera:
    path = None if background is None else "map.npy"
    text = camera_toml(camera, background=path)

    def read_map(path: str, shape: tuple[int, int] | None) -> Float32Array:
        assert (path, shape, background is not None) == ("map.npy", camera.shape, True)
        return np.asarray(background)

    return camera_of_model(parse_toml(text, source="written"), read_map=read_map)


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        replace(CAMERA, modulation_frequency_hz=2e7, measurement=Measurement.LOCK_IN),
        replace(CAMERA, fov_horizontal_deg=None, fov_vertical_deg=None, projection=LENS),
    ],
    ids=["angles", "lock-in", "pinhole"],
)
def test_written_camera_is_read_back(camera: CompleteCamera) -> None:
    found = _read_back(camera)
    given = camera.known() | {"noise": None}
    assert found.known() | {"noise": None} == given
    assert found.noise.same_as(camera.noise)


def test_every_part_of_the_noise_is_read_back() -> None:
    law = AmplitudeLaw(
        reference=np.array([100.0, 50.0]), amplitude=np.array([10.0, 200.0]), factor=np.array([2.0, 0.5])
    )
    shape = NoiseShape(z=Z, density=np.exp(-1.148 * np.abs(Z)))
    noise = replace(CURVE, law=law, shape=shape, width_spread=0.25, background=np.array(0.125))
    found = _read_back(replace(CAMERA, noise=noise)).noise
    assert found.width_spread == 0.25
    assert found.background == pytest.approx(0.125)
    assert found.law is not None
    assert found.law.factor == pytest.approx(law.factor)
    assert found.law.reference == pytest.approx(law.reference)
    assert found.shape is not None
    assert found.shape.density == pytest.approx(shape.density, rel=1e-5)


def test_map_of_background_shares_is_named_and_read() -> None:
    shares = np.linspace(0.0, 0.25, 48).reshape(6, 8).astype(np.float32)
    noise = replace(CURVE, background=shares.astype(np.float64))
    found = _read_back(replace(CAMERA, noise=noise), shares)
    assert found.noise.background == pytest.approx(shares)
