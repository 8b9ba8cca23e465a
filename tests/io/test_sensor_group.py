"""`projection` of a file's group `sensor`: round trips, foreign files, and every refusal."""

import io
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.files import boards, write_recording

from tofmix.errors import BadInputError
from tofmix.io import hdf5, sensor_group
from tofmix.io.recording.recording_file import open_recording
from tofmix.measurement import Measurement
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Pinhole
from tofmix.sensor import NoiseCurve, Sensor

PINHOLE: dict[str, Any] = {"projection": "pinhole", "fx": 5.0, "fy": 6.0, "cx": 2.5, "cy": 1.5}


def read(path: Path) -> Sensor:
    with open_recording(path) as file:
        return file.sensor


@pytest.mark.parametrize("distortion", [(), (-0.1, 0.01, 0.001, 0.002, 0.0), (0.1,) * 8])
def test_pinhole_round_trips(distortion: tuple[float, ...]) -> None:
    pinhole = Pinhole(fx=5.25, fy=6.125, cx=2.5, cy=1.5, distortion=distortion)
    camera = Sensor(name="camera", projection=pinhole)
    image = hdf5.image_of(lambda root: sensor_group.write_sensor(root, camera, image=(4, 6)))
    with h5py.File(io.BytesIO(image), "r") as root:
        assert sensor_group.read_sensor(root, Path("x.h5")).optics == pinhole
        assert root["sensor"].attrs["projection"] == "pinhole"
        assert ("distortion" in root["sensor"].attrs) == bool(distortion)
        assert np.isnan(root["sensor"].attrs["fov_horizontal_deg"])


def test_a_foreign_pinhole_ignores_the_field_of_view(tmp_path: Path) -> None:
    fov = {"fov_horizontal_deg": 47.0, "fov_vertical_deg": 39.0}
    path = write_recording(tmp_path / "x.h5", boards(), attributes=PINHOLE | fov)
    assert read(path).optics == Pinhole(fx=5.0, fy=6.0, cx=2.5, cy=1.5)


@pytest.mark.parametrize("attributes", [{}, {"projection": "equiangular"}])
def test_field_of_view_sets_the_directions_without_a_projection(tmp_path: Path, attributes: dict[str, Any]) -> None:
    fov = {"fov_horizontal_deg": 47.0, "fov_vertical_deg": 39.0}
    path = write_recording(tmp_path / "x.h5", boards(), attributes=attributes | fov)
    assert read(path).optics == Equiangular(fov_horizontal_deg=47.0, fov_vertical_deg=39.0)
    path = write_recording(tmp_path / "y.h5", boards(), attributes=attributes)
    assert read(path).optics is None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"projection": "fisheye"}, "projection: 'fisheye' is not known; known: equiangular, pinhole"),
        ({"projection": 3}, "projection: '' is not known"),
        ({"fx": "wide"}, "fx: expected one number"),
        ({"fx": 0.0}, "fx: 0 is not a finite number above 0"),
        ({"cy": np.nan}, "cy: nan is not a finite number"),
        ({"distortion": [0.1, 0.2]}, "distortion: 2 numbers; expected OpenCV's"),
        ({"distortion": "none"}, "distortion: expected a short list of numbers"),
        ({"distortion": np.zeros(65)}, "distortion: expected a short list of numbers"),
    ],
)
def test_unfit_attributes_are_refused_by_name(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    path = write_recording(tmp_path / "x.h5", boards(), attributes=PINHOLE | change)
    with pytest.raises(BadInputError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: sensor: {reason}")


def test_a_missing_number_is_named(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "x.h5", boards(), attributes={"projection": "pinhole", "fx": 1.0, "cx": 1.0})
    with pytest.raises(BadInputError, match="sensor: projection: pinhole needs fy, cy"):
        read(path)


@pytest.mark.parametrize("measurement", [None, *Measurement])
def test_measurement_round_trips_and_is_left_out_if_unknown(measurement: Measurement | None) -> None:
    camera = Sensor(name="camera", measurement=measurement)
    image = hdf5.image_of(lambda root: sensor_group.write_sensor(root, camera, image=(4, 6)))
    with h5py.File(io.BytesIO(image), "r") as root:
        assert sensor_group.read_sensor(root, Path("x.h5")).measurement is measurement
        assert ("measurement" in root["sensor"].attrs) == (measurement is not None)


def test_a_foreign_measurement_is_refused_by_name(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "a.h5", boards(3))
    with h5py.File(path, "r+") as root:
        root["sensor"].attrs["measurement"] = "structured light"
    with pytest.raises(BadInputError, match=r'a\.h5: sensor: measurement: "structured light" is not one of lock-in, '):
        read(path)


@pytest.mark.parametrize("step", [2.0, [1.0, 2.5], np.full((4, 6), 1.5)])
def test_step_of_the_ranges_round_trips(step: Any) -> None:  # noqa: ANN401  number, list or map
    curve = NoiseCurve(np.array([1000.0, 2000.0]), np.array([3.0, 4.0]))
    camera = Sensor(name="camera", noise=curve, range_step_mm=np.array(step))
    image = hdf5.image_of(lambda root: sensor_group.write_sensor(root, camera, image=(4, 6)))
    with h5py.File(io.BytesIO(image), "r") as root:
        found = sensor_group.read_sensor(root, Path("x.h5"))
    assert found.range_step_mm is not None
    np.testing.assert_array_equal(found.range_step_mm, step)
    sensor_group.check_maps(found, (4, 6), Path("x.h5"))


@pytest.mark.parametrize("step", [0.0, -1.0, np.nan, [1.0, 2.0, 3.0], np.ones((2, 2, 2))])
def test_a_step_that_cannot_be_is_refused(step: Any) -> None:  # noqa: ANN401  number, list or map
    curve = NoiseCurve(np.array([1000.0, 2000.0]), np.array([3.0, 4.0]))
    with pytest.raises(ValueError, match="range_step_mm"):
        Sensor(name="camera", noise=curve, range_step_mm=np.array(step))


def test_a_map_of_steps_of_another_image_is_refused() -> None:
    camera = Sensor(name="camera", range_step_mm=np.ones((3, 5)))
    with pytest.raises(BadInputError, match="range_step_mm: shape"):
        sensor_group.check_maps(camera, (4, 6), Path("x.h5"))
