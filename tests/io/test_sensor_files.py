"""Cameras, their learnt noise, and models in files: they come back to the last digit, and what is refused."""

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.files import boards, write_recording
from support.learnt_pixels import camera_with, flat, pixel_noise

from tofmix.errors import BadInputError
from tofmix.io import hdf5, sensor_group
from tofmix.io.model_file import load_model, load_model_text
from tofmix.io.recording.recording_file import open_recording
from tofmix.io.sensor_group import read_sensor, write_sensor
from tofmix.noise_shape import BackgroundDensity, LearntNoise
from tofmix.optics.pinhole import Pinhole
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.sensor_schema import Measurement
from tofmix.simulation.effects.fixed_pattern import FixedPattern

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


def test_foreign_cameras_are_read_or_refused_by_name(tmp_path: Path) -> None:
    fov = {"fov_horizontal_deg": 47.0, "fov_vertical_deg": 39.0}
    path = write_recording(tmp_path / "x.h5", boards(), attributes=PINHOLE | fov)
    assert read(path).optics == Pinhole(fx=5.0, fy=6.0, cx=2.5, cy=1.5)
    path = write_recording(tmp_path / "x.h5", boards(), attributes={"projection": "pinhole", "fx": 1.0, "cx": 1.0})
    with pytest.raises(BadInputError, match="sensor: projection: pinhole needs fy, cy"):
        read(path)
    path = write_recording(tmp_path / "a.h5", boards(3))
    with h5py.File(path, "r+") as root:
        root["sensor"].attrs["measurement"] = "structured light"
    with pytest.raises(BadInputError, match=r'a\.h5: sensor: measurement: "structured light" is not one of lock-in, '):
        read(path)
    camera = Sensor(name="camera", range_step_mm=np.ones((3, 5)))
    with pytest.raises(BadInputError, match="range_step_mm: shape"):
        sensor_group.check_maps(camera, (4, 6), Path("x.h5"))


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


@pytest.mark.parametrize("measurement", [None, *Measurement])
def test_measurement_round_trips_and_is_left_out_if_unknown(measurement: Measurement | None) -> None:
    camera = Sensor(name="camera", measurement=measurement)
    image = hdf5.image_of(lambda root: sensor_group.write_sensor(root, camera, image=(4, 6)))
    with h5py.File(io.BytesIO(image), "r") as root:
        assert sensor_group.read_sensor(root, Path("x.h5")).measurement is measurement
        assert ("measurement" in root["sensor"].attrs) == (measurement is not None)


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


FULL = camera_with(
    pixel_noise("skewed", background=(1.25, 9.5), width_spread=0.3, drift_mm=(5.0, 0.0, 2.0), memory=0.4),
    flat(6.5, 4.5)._replace(log_n=np.log([30.0])),
)
UNITS = {
    "noise_drift": "mm",
    "noise_gain_samples": "1",
    "noise_gain_background": "1",
    "noise_gain_of_one_more": "nat",
    "noise_gain_of_first": "nat",
    "noise_background_prior": "1",
}


def _written(path: Path, sensor: Sensor = FULL) -> Path:
    with h5py.File(path, "w") as root:
        write_sensor(root, sensor, image=(4, 5))
    return path


def _read(path: Path) -> LearntNoise | None:
    with h5py.File(path) as root:
        return read_sensor(root, path).learnt


def test_learnt_noise_comes_back_to_the_last_digit(tmp_path: Path) -> None:
    assert FULL.learnt is not None
    assert FULL.learnt.same_as(_read(_written(tmp_path / "a.h5")))


def test_parts_that_were_not_learnt_have_no_dataset(tmp_path: Path) -> None:
    sensor = camera_with(pixel_noise("skewed"))
    back = _read(_written(tmp_path / "a.h5", sensor))
    assert back is not None
    assert back.background is None
    assert back.same_as(sensor.learnt)
    path = _written(tmp_path / "a.h5", replace(FULL, learnt=None))
    with h5py.File(path) as root:
        assert not set(UNITS) & set(root["sensor"])
        assert "noise_memory" not in root["sensor"].attrs
    assert _read(path) is None
    with h5py.File(_written(tmp_path / "a.h5")) as root:
        assert not {"noise_background_range", "noise_background_density"} & set(root["sensor"])


def test_datasets_have_their_names_units_and_checksums(tmp_path: Path) -> None:
    with h5py.File(_written(tmp_path / "a.h5")) as root:
        group = root["sensor"]
        for name, units in UNITS.items():
            assert group[name].attrs["units"] == units
            assert group[name].dtype == np.float64
            assert group[name].fletcher32
        assert group.attrs["noise_memory"] == 0.4
        np.testing.assert_array_equal(group["noise_background_prior"][...], [1.25, 9.5])
        np.testing.assert_array_equal(group["noise_drift"][...], [5.0, 0.0, 2.0])


def _without(name: str) -> Callable[[h5py.Group], None]:
    def change(group: h5py.Group) -> None:
        del group[name]

    return change


def _with(name: str, values: object) -> Callable[[h5py.Group], None]:
    def change(group: h5py.Group) -> None:
        del group[name]
        group[name] = values

    return change


def _memory(value: object) -> Callable[[h5py.Group], None]:
    def change(group: h5py.Group) -> None:
        group.attrs["noise_memory"] = value

    return change


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (_without("noise_gain_of_first"), "sensor/noise_gain_of_first: missing; noise_drift, "),
        (_without("noise_drift"), "sensor/noise_drift: missing"),
        (_with("noise_background_prior", [1.0, 2.0, 3.0]), r"sensor/noise_background_prior: shape \(3,\); two numbers"),
        (_with("noise_background_prior", [0.0, 2.0]), "background: two finite numbers above 0"),
        (_with("noise_drift", [1.0, 2.0]), "drift_mm: 2 numbers, not 3"),
        (_with("noise_drift", [1.0, np.nan, 2.0]), "drift_mm: expected 1 dimensions of finite numbers"),
        (_with("noise_gain_of_one_more", np.zeros((1, 1))), "gain_more: expected 3 dimensions"),
        (_with("noise_gain_of_first", np.zeros((2, 8))), "tables of gains differ in size"),
        (_memory(1.5), r"memory 1.5 is not in \[0, 1\)"),
        (_memory([0.1, 0.2]), "sensor"),
        (_memory("much"), "sensor"),
    ],
)
def test_damaged_learnt_noise_is_refused_with_file_and_dataset(
    tmp_path: Path, change: Callable[[h5py.Group], None], text: str
) -> None:
    path = _written(tmp_path / "a.h5")
    with h5py.File(path, "r+") as root:
        change(root["sensor"])
    with pytest.raises(BadInputError, match=text) as refused:
        _read(path)
    assert str(refused.value).startswith(f"{path}: sensor")


DENSITY = BackgroundDensity(np.array([300.0, 900.0, 6000.0]), np.array([3.0, 2.0, 0.01]))
WITH_DENSITY = replace(FULL, noise=replace(FULL.noise, background_density=DENSITY))  # type: ignore[type-var]


def test_the_density_of_background_comes_back_to_the_last_digit(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.h5", WITH_DENSITY)
    with h5py.File(path) as root:
        back = read_sensor(root, path).noise
        assert root["sensor/noise_background_density"].attrs["units"] == "mm-1"
        assert root["sensor/noise_background_range"].attrs["units"] == "mm"
    assert back is not None
    assert DENSITY.same_as(back.background_density)
    assert WITH_DENSITY.noise is not None
    assert back.same_as(WITH_DENSITY.noise)
    assert FULL.noise is not None
    assert not back.same_as(FULL.noise)


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("noise_background_range", None, "noise_background_range: missing; .* go together"),
        ("noise_background_density", [1.0, -1.0, 1.0], "not above 0"),
        ("noise_background_range", [1.0, 3.0, 2.0], "do not ascend"),
        ("noise_background_density", [1.0, 1.0], "one length"),
    ],
)
def test_a_density_of_background_that_cannot_be_is_named(
    name: str, values: list[float] | None, said: str, tmp_path: Path
) -> None:
    path = _written(tmp_path / "a.h5", WITH_DENSITY)
    with h5py.File(path, "r+") as root:
        del root[f"sensor/{name}"]
        if values is not None:
            root[f"sensor/{name}"] = values
    with h5py.File(path) as root, pytest.raises(BadInputError, match=said):
        read_sensor(root, path)


def test_models_are_found_by_name_or_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_model("three-boards")
    assert (model.sensor.rows, model.sensor.cols, model.recording.frames) == (144, 176, 100)
    with pytest.raises(BadInputError, match="three-boards, corridor"):
        load_model("four-boards")
    monkeypatch.chdir(tmp_path)
    Path("corridor").write_text("mine")
    assert load_model_text("corridor") == "mine"


SMALL = """
[sensor]
profile = "sr3000"
rows = 3
cols = 4
[[effect]]
kind = "fixed_pattern"
map = "maps/pattern.npy"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "maps").mkdir()
    (tmp_path / "m.toml").write_text(SMALL)
    return tmp_path


def test_map_is_read_from_the_folder_of_the_model(folder: Path) -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.save(folder / "maps" / "pattern.npy", values)
    (effect,) = load_model(str(folder / "m.toml")).effects
    assert isinstance(effect, FixedPattern)
    assert effect.map is not None
    assert effect.map.path == "maps/pattern.npy"
    np.testing.assert_array_equal(effect.map.values, values)


@pytest.mark.parametrize(
    ("path", "values", "reason"),
    [
        ("maps/pattern.npy", None, "No such file or directory"),
        ("../pattern.npy", None, "expected a path within the model's folder"),
        ("/etc/passwd", None, "expected a path within the model's folder"),
        ("", None, "expected a path within the model's folder"),
        ("m.toml", None, "not an .npy file of numbers"),
        ("maps", None, "Is a directory"),
        ("maps/pattern.npy", np.zeros((4, 3), np.float32), "shape (4, 3) differs from the image (3, 4)"),
        ("maps/pattern.npy", np.zeros((3, 4), np.int32), "expected float32, got int32"),
        ("maps/pattern.npy", np.full((3, 4), np.nan, np.float32), "a value is not finite"),
        ("maps/pattern.npy", np.array([[{}]], dtype=object), "not an .npy file of numbers"),
    ],
)
def test_an_unfit_map_is_refused_in_one_line(folder: Path, path: str, values: object, reason: str) -> None:
    if values is not None:
        np.save(folder / "maps" / "pattern.npy", np.asarray(values))
    (folder / "m.toml").write_text(SMALL.replace("maps/pattern.npy", path))
    with pytest.raises(BadInputError, match=r"m\.toml: \[\[effect\]\] 1: map: .*" + re.escape(reason)) as caught:
        load_model(str(folder / "m.toml"))
    assert "\n" not in str(caught.value)


def test_map_that_declares_terabytes_is_refused_without_memory(folder: Path) -> None:
    header = io.BytesIO()
    claim = {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1 << 20)}
    np.lib.format.write_array_header_1_0(header, claim)
    (folder / "maps" / "pattern.npy").write_bytes(header.getvalue())
    with pytest.raises(BadInputError, match="map: "):
        load_model(str(folder / "m.toml"))
