"""The group `sensor` of recordings, layers and surfaces files: the camera, its noise, and the learnt noise."""

from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import IMAGE_RANK
from tofmix.errors import BadInputError
from tofmix.io.guard import guard
from tofmix.io.hdf5 import PACKED, add_group, text_attribute
from tofmix.noise_shape import BackgroundDensity, LearntNoise, NoiseShape
from tofmix.optics.projection import (
    DEFAULT_PROJECTION,
    PROJECTIONS,
    Projection,
    list_keys,
    make_projection,
    number_keys,
    projection_values,
)
from tofmix.recording import MOST_PIXELS_A_SIDE
from tofmix.sensor import DEFAULT_OUTLIER_PROBABILITY, AmplitudeLaw, NoiseCurve, Sensor
from tofmix.sensor_schema import RARE_SENSOR_NUMBERS, SENSOR_NUMBERS, measurement_of, share_law_of
from tofmix.temporal_filter import TemporalFilter, make_filter

T = TypeVar("T")

_MOST_POINTS = 100_000  # of a list in the group `sensor`

_Table = dict[str, tuple[str, str, str | None]]
"""Datasets that go together: the field that each holds, its unit, and the dimension scale of its one axis."""

_CURVE: _Table = {
    "noise_range": ("range_mm", "mm", "noise_range"),
    "noise_sigma": ("sigma_mm", "mm", "noise_range"),
}
_LAW: _Table = {
    "noise_reference_amplitude": ("reference", "1", "noise_range"),
    "noise_amplitude": ("amplitude", "1", "noise_amplitude"),
    "noise_amplitude_factor": ("factor", "1", "noise_amplitude"),
}
_SHAPE: _Table = {
    "noise_shape_z": ("z", "1", "noise_shape_z"),
    "noise_shape_density": ("density", "1", "noise_shape_z"),
}
_DENSITY: _Table = {
    "noise_background_range": ("range_mm", "mm", "noise_background_range"),
    "noise_background_density": ("density", "mm-1", "noise_background_range"),
}
_LEARNT: _Table = {
    "noise_drift": ("drift_mm", "mm", None),
    "noise_gain_samples": ("gain_samples", "1", None),
    "noise_gain_background": ("gain_background", "1", None),
    "noise_gain_of_one_more": ("gain_more", "nat", None),
    "noise_gain_of_first": ("gain_first", "nat", None),
}
_PRIOR: _Table = {"noise_background_prior": ("background", "1", None)}
_MEMORY, _WIDTH_SPREAD = "noise_memory", "noise_width_spread"
_BACKGROUND, _STEP = "noise_background", "range_step_mm"
_FILTER, _FILTER_PARAMETER = "temporal_filter", "temporal_filter_parameter"
_FILTER_FURTHER = {"threshold_mm": "temporal_filter_threshold_mm", "median": "temporal_filter_median"}
_MOST_OF_IMAGE = MOST_PIXELS_A_SIDE**2


def write_sensor(root: h5py.File, sensor: Sensor, *, image: tuple[int, int]) -> None:
    """Write the group `sensor` of an image (rows, cols); a number that is not known is NaN."""
    group = add_group(root, "sensor")
    group.attrs["name"] = sensor.name
    for name, text in (("measurement", sensor.measurement), ("share_law", sensor.share_law)):
        group.attrs.update({} if text is None else {name: text.value})
    for key in SENSOR_NUMBERS:
        value = getattr(sensor, key)
        group.attrs[key] = np.nan if value is None else float(value)
    for key in RARE_SENSOR_NUMBERS:
        extra = getattr(sensor, key)
        if extra is not None:
            group.attrs[key] = float(extra)
    if sensor.projection is not None:
        group.attrs["projection"] = sensor.projection.name
        for key, value in projection_values(sensor.projection).items():
            group.attrs[key] = value
    if sensor.noise is not None:
        _write_noise(group, sensor.noise, image)
    if sensor.learnt is not None:
        group.attrs[_MEMORY] = float(sensor.learnt.memory)
        _write_tables(group, (sensor.learnt, _LEARNT | ({} if sensor.learnt.background is None else _PRIOR)))
    _write_samples(group, sensor)


def _write_noise(group: h5py.Group, noise: NoiseCurve, image: tuple[int, int]) -> None:
    """Write a noise curve, with its law of amplitude, shape, widths and background."""
    _write_tables(group, (noise, _CURVE), (noise.law, _LAW))
    _write_tables(group, (noise.background_density, _DENSITY))
    _write_tables(group, (noise.shape, _SHAPE))
    if noise.width_spread:
        group.attrs[_WIDTH_SPREAD] = float(noise.width_spread)
    if noise.background is not None:
        of_each = np.broadcast_to(noise.background, image)
        share = group.create_dataset(_BACKGROUND, data=of_each, chunks=image, **PACKED)
        share.attrs["units"] = "1"
        _attach_image(share)


def _write_tables(group: h5py.Group, *tables: tuple[object, _Table]) -> None:
    """Write the datasets of objects that are there, then their scales: readers draw a curve against its range."""
    there = [(found, table) for found, table in tables if found is not None]
    for found, table in there:
        for name, (key, units, _) in table.items():
            values = np.asarray(getattr(found, key))
            dataset = group.create_dataset(name, data=values, chunks=values.shape, fletcher32=True)
            dataset.attrs["units"] = units
    for name, (_, _, scale) in (item for _, table in there for item in table.items()):
        if scale == name:
            group[name].make_scale(name)
        elif scale is not None:
            group[name].dims[0].attach_scale(group[scale])


def _write_samples(group: h5py.Group, sensor: Sensor) -> None:
    """Write the step of the stored ranges, a number as an attribute, else a dataset; then the filter over time."""
    step = sensor.range_step_mm
    if step is not None and step.ndim == 0:
        group.attrs[_STEP] = float(step)
    elif step is not None:
        _write_step(group, step)
    if sensor.temporal_filter is not None:
        _write_filter(group, sensor.temporal_filter)


def _write_filter(group: h5py.Group, found: TemporalFilter) -> None:
    group.attrs[_FILTER] = found.kind
    group.attrs[_FILTER_PARAMETER] = float(found.parameter)
    for key, value in found.further.items():
        group.attrs[_FILTER_FURTHER[key]] = float(value)


def _read_filter(group: h5py.Group, kind: str | None, path: Path) -> TemporalFilter | None:
    if not kind:
        return None
    return make_filter(
        kind,
        _number(group, _FILTER_PARAMETER, path) or 0.0,
        **{key: _number(group, name, path) for key, name in _FILTER_FURTHER.items()},
    )


def _write_step(group: h5py.Group, step: NDArray[np.float64]) -> None:
    dataset = group.create_dataset(_STEP, data=step, chunks=step.shape, fletcher32=True)
    dataset.attrs["units"] = "mm"
    if step.ndim == 1:
        dataset.dims[0].attach_scale(group["noise_range"])
    else:
        _attach_image(dataset)


def _attach_image(dataset: h5py.Dataset) -> None:
    for axis, name in enumerate(("row", "col")):
        if name in dataset.file:
            dataset.dims[axis].attach_scale(dataset.file[name])


def read_sensor(root: h5py.File, path: Path) -> Sensor:
    """Read the group `sensor`; a file without one gives a sensor of which nothing is known."""
    group = root.get("sensor")
    if group is None:
        return Sensor(name="unknown")
    if not isinstance(group, h5py.Group):
        raise BadInputError(f"{path}: sensor: expected a group, got a dataset")
    numbers = {key: _number(group, key, path) for key in (*SENSOR_NUMBERS, *RARE_SENSOR_NUMBERS)}
    # NaN: not known; inf: no such limit, as for a stereo camera's [686, inf).
    known = {key: value for key, value in numbers.items() if value is not None and np.isfinite(value)}
    known.setdefault("outlier_probability", DEFAULT_OUTLIER_PROBABILITY)
    texts = {key: text_attribute(group, key) for key in ("measurement", "share_law", _FILTER)}
    measurement, share_law, kind = texts.values()
    try:
        return Sensor(
            name=text_attribute(group, "name") or "unknown",
            measurement=measurement_of(measurement) if measurement else None,
            share_law=share_law_of(share_law) if share_law else None,
            noise=_read_noise(group, path),
            projection=_read_projection(group, path),
            learnt=_read_learnt(group, path),
            range_step_mm=_read_step(group, path),
            temporal_filter=_read_filter(group, kind, path),
            **known,
        )
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{path}: sensor: {error}") from error


def _read_projection(group: h5py.Group, path: Path) -> Projection | None:
    """The projection; None for equal angles over the field of view."""
    if "projection" not in group.attrs:
        return None
    name = text_attribute(group, "projection") or ""
    if name == DEFAULT_PROJECTION:
        return None
    if name not in PROJECTIONS:
        raise ValueError(f"projection: {name!r} is not known; known: {', '.join(PROJECTIONS)}")
    values: dict[str, float | list[float]] = {}
    for key in number_keys(name):
        number = _number(group, key, path)
        if number is not None:
            values[key] = number
    for key in list_keys(name):
        if key in group.attrs:
            values[key] = _short_list(group, key, path)
    return make_projection(name, values)


def _short_list(group: h5py.Group, key: str, path: Path) -> list[float]:
    value = np.asarray(group.attrs[key])
    most_coefficients = 64  # of a lens; OpenCV has up to 14
    if value.size > most_coefficients or (value.size > 0 and value.dtype.kind not in "iuf"):
        raise BadInputError(
            f"{path}: sensor: {key}: expected a short list of numbers, got {value.dtype} of shape {value.shape}"
        )
    return [float(number) for number in value.ravel()]


def _read_noise(group: h5py.Group, path: Path) -> NoiseCurve | None:
    curve = _read_table(group, _CURVE, path)
    if curve is None:
        return None
    law, shape, density = (_read_table(group, table, path) for table in (_LAW, _SHAPE, _DENSITY))
    return NoiseCurve(
        **curve,
        law=None if law is None else AmplitudeLaw(**law),
        shape=None if shape is None else NoiseShape(**shape),
        width_spread=_number(group, _WIDTH_SPREAD, path) or 0.0,
        background=_numbers(group, _BACKGROUND, path, most=_MOST_OF_IMAGE) if _BACKGROUND in group else None,
        background_density=None if density is None else BackgroundDensity(**density),
    )


def _read_learnt(group: h5py.Group, path: Path) -> LearntNoise | None:
    learnt = _read_table(group, _LEARNT, path, most=_MOST_OF_IMAGE)
    if learnt is None:
        return None
    prior = _read_table(group, _PRIOR, path)
    background = None if prior is None else prior["background"]
    if background is not None and background.shape != (2,):
        raise BadInputError(f"{path}: sensor/{next(iter(_PRIOR))}: shape {background.shape}; two numbers are expected")
    pair = None if background is None else (float(background[0]), float(background[1]))
    return LearntNoise(background=pair, memory=_number(group, _MEMORY, path) or 0.0, **learnt)


def _read_step(group: h5py.Group, path: Path) -> NDArray[np.float64] | None:
    if _STEP in group:
        return _numbers(group, _STEP, path, most=_MOST_OF_IMAGE)
    number = _number(group, _STEP, path)
    return None if number is None else np.array(number)


def _read_table(group: h5py.Group, table: _Table, path: Path, *, most: int = _MOST_POINTS) -> dict[str, Any] | None:
    """Datasets that go together, by the fields that they hold; None without any."""
    missing = [name for name in table if name not in group]
    if len(missing) == len(table):
        return None
    if missing:
        raise BadInputError(f"{path}: sensor/{missing[0]}: missing; {', '.join(table)} go together")
    return {key: _numbers(group, name, path, most=most) for name, (key, _, _) in table.items()}


def check_maps(sensor: Sensor, image: tuple[int, int], path: Path) -> None:
    """Refuse a map of background shares, or of steps of the ranges, that is of another image than the file's."""
    background = None if sensor.noise is None else sensor.noise.background
    for name, values in ((_BACKGROUND, background), (_STEP, sensor.range_step_mm)):
        if values is not None and values.ndim == IMAGE_RANK and values.shape != tuple(image):
            raise BadInputError(f"{path}: sensor/{name}: shape {values.shape} differs from the image {tuple(image)}")


def _numbers(group: h5py.Group, name: str, path: Path, *, most: int = _MOST_POINTS) -> NDArray[np.float64]:
    dataset = guard.checked_dataset(group, name, path)
    if dataset.dtype.kind not in "iuf":
        raise BadInputError(f"{path}: sensor/{name}: expected numbers, got {dataset.dtype}")
    if dataset.size > most:
        raise BadInputError(f"{path}: sensor/{name}: shape {dataset.shape}; expected at most {most} values")
    with guard.reading(path, f"sensor/{name}"):
        return np.asarray(dataset[...], dtype=np.float64)


def _number(group: h5py.Group, key: str, path: Path) -> float | None:
    if key not in group.attrs:
        return None
    value = np.asarray(group.attrs[key])
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise BadInputError(f"{path}: sensor: {key}: expected one number, got {group.attrs[key]!r}")
    return float(value.reshape(-1)[0])
