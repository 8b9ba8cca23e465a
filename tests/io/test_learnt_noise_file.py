"""Learnt noise in the group `sensor` of a file: it comes back to the last digit, and what is broken is named."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.learnt_pixels import camera_with, flat, pixel_noise

from tofmix.errors import BadInputError
from tofmix.io.sensor_group import read_sensor, write_sensor
from tofmix.learnt_noise import LearntNoise
from tofmix.noise_shape import BackgroundDensity
from tofmix.sensor import Sensor

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


def test_noise_without_a_prior_of_background_comes_back_without_one(tmp_path: Path) -> None:
    sensor = camera_with(pixel_noise("skewed"))
    back = _read(_written(tmp_path / "a.h5", sensor))
    assert back is not None
    assert back.background is None
    assert back.same_as(sensor.learnt)


def test_a_sensor_that_learnt_nothing_has_none_of_the_datasets(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.h5", replace(FULL, learnt=None))
    with h5py.File(path) as root:
        assert not set(UNITS) & set(root["sensor"])
        assert "noise_memory" not in root["sensor"].attrs
    assert _read(path) is None


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


@pytest.mark.parametrize("name", sorted(set(UNITS) - {"noise_background_prior"}))
def test_words_in_place_of_numbers_are_refused(tmp_path: Path, name: str) -> None:
    path = _written(tmp_path / "a.h5")
    with h5py.File(path, "r+") as root:
        del root["sensor"][name]
        root["sensor"][name] = "many"
    with pytest.raises(BadInputError, match="sensor"):
        _read(path)


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


def test_a_file_of_uniform_background_has_no_density(tmp_path: Path) -> None:
    with h5py.File(_written(tmp_path / "a.h5")) as root:
        assert not {"noise_background_range", "noise_background_density"} & set(root["sensor"])


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
