"""The group `sensor` of recordings, layers and surfaces files: the camera, its noise, and the learnt noise."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.background_density import BackgroundDensity
from tofmix.errors import BadInputError
from tofmix.io.guard import guard
from tofmix.io.hdf5 import add_group, text_attribute
from tofmix.learnt_noise import LearntNoise
from tofmix.measurement import Measurement, measurement_of
from tofmix.noise_shape import NoiseShape
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
from tofmix.sensor_schema import DENSITY_LISTS, LAW_LISTS, RARE_SENSOR_NUMBERS, SENSOR_NUMBERS, SHAPE_LISTS
from tofmix.share_law import ShareLaw, share_law_of
from tofmix.temporal_filter import TemporalFilter, make_filter

T = TypeVar("T")

_MOST_POINTS = 100_000  # of a list in the group `sensor`
_MOST_COEFFICIENTS = 64  # of a lens; OpenCV has up to 14

_LAW, _SHAPE, _DENSITY = (
    {f"noise_{name}": key for name, key in lists.items()} for lists in (LAW_LISTS, SHAPE_LISTS, DENSITY_LISTS)
)
"""Datasets of an `AmplitudeLaw`, a `NoiseShape` and a `BackgroundDensity`, and their fields, in their order."""

_LEARNT = {
    "noise_drift": "drift_mm",
    "noise_gain_samples": "gain_samples",
    "noise_gain_background": "gain_background",
    "noise_gain_of_one_more": "gain_more",
    "noise_gain_of_first": "gain_first",
}
"""Datasets of learnt noise, and the fields of `LearntNoise`."""

_PRIOR, _MEMORY = "noise_background_prior", "noise_memory"

_WIDTH_SPREAD, _BACKGROUND, _STEP = "noise_width_spread", "noise_background", "range_step_mm"
_FILTER, _FILTER_PARAMETER = "temporal_filter", "temporal_filter_parameter"
_IMAGE_RANK = 2  # (row, col)


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
        _write_learnt(group, sensor.learnt)
    if sensor.range_step_mm is not None:
        _write_step(group, sensor.range_step_mm)
    _write_filter(group, sensor.temporal_filter)


def _write_filter(group: h5py.Group, found: TemporalFilter | None) -> None:
    if found is not None:
        group.attrs[_FILTER], group.attrs[_FILTER_PARAMETER] = found.kind, float(found.parameter)


def _write_step(group: h5py.Group, step: NDArray[np.float64]) -> None:
    """Write the step of the stored ranges: a number as an attribute, else a dataset."""
    if step.ndim == 0:
        group.attrs[_STEP] = float(step)
        return
    dataset = group.create_dataset(_STEP, data=step, chunks=step.shape, fletcher32=True)
    dataset.attrs["units"] = "mm"
    if step.ndim == 1:
        dataset.dims[0].attach_scale(group["noise_range"])
        return
    for axis, name in enumerate(("row", "col")):
        if name in group.file:
            dataset.dims[axis].attach_scale(group.file[name])


def _read_step(group: h5py.Group, path: Path) -> NDArray[np.float64] | None:
    if _STEP in group:
        return _numbers(group, _STEP, path, most=MOST_PIXELS_A_SIDE**2)
    number = _number(group, _STEP, path)
    return None if number is None else np.array(number)


def _write_noise(group: h5py.Group, noise: NoiseCurve, image: tuple[int, int]) -> None:
    """Write a noise curve, with its law of amplitude, shape, widths and background."""
    curve = {"noise_range": (noise.range_mm, "mm"), "noise_sigma": (noise.sigma_mm, "mm")}
    if noise.law is not None:
        curve |= {name: (getattr(noise.law, key), "1") for name, key in _LAW.items()}
    for name, (values, units) in curve.items():
        dataset = group.create_dataset(name, data=values, chunks=values.shape, fletcher32=True)
        dataset.attrs["units"] = units
    # sigma over range: readers of dimension scales draw the curve against range.
    group["noise_range"].make_scale("noise_range")
    group["noise_sigma"].dims[0].attach_scale(group["noise_range"])
    if noise.law is not None:
        group["noise_reference_amplitude"].dims[0].attach_scale(group["noise_range"])
        group["noise_amplitude"].make_scale("noise_amplitude")
        group["noise_amplitude_factor"].dims[0].attach_scale(group["noise_amplitude"])
    _write_noise_parts(group, noise, image)


def _write_learnt(group: h5py.Group, learnt: LearntNoise) -> None:
    """Write learnt noise."""
    group.attrs[_MEMORY] = float(learnt.memory)
    arrays = {name: np.asarray(getattr(learnt, key)) for name, key in _LEARNT.items()}
    if learnt.background is not None:
        arrays[_PRIOR] = np.array(learnt.background)
    for name, values in arrays.items():
        dataset = group.create_dataset(name, data=values, chunks=values.shape, fletcher32=True)
        dataset.attrs["units"] = "mm" if name == "noise_drift" else "nat" if name.startswith("noise_gain_of") else "1"


def _read_learnt(group: h5py.Group, path: Path) -> LearntNoise | None:
    if not any(name in group for name in _LEARNT):
        return None
    arrays: dict[str, NDArray[np.float64]] = {}
    for name in (*_LEARNT, _PRIOR):
        if name in group:
            with guard.reading(path, f"sensor/{name}"):
                arrays[name] = np.asarray(group[name], dtype=np.float64)
        elif name != _PRIOR:
            raise BadInputError(f"{path}: sensor/{name}: missing; learnt noise needs all its datasets")
    prior = arrays.pop(_PRIOR, None)
    if prior is not None and prior.shape != (2,):
        raise BadInputError(f"{path}: sensor/{_PRIOR}: shape {prior.shape}; two numbers are expected")
    values: dict[str, Any] = {_LEARNT[name]: array for name, array in arrays.items()}
    try:
        return LearntNoise(
            background=None if prior is None else (float(prior[0]), float(prior[1])),
            memory=float(group.attrs.get(_MEMORY, 0.0)),
            **values,
        )
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{path}: sensor: {error}") from error


def _write_noise_parts(group: h5py.Group, noise: NoiseCurve, image: tuple[int, int]) -> None:
    """Write the shape, widths and background of a noise curve."""
    if noise.background_density is not None:
        for name, key in _DENSITY.items():
            values = getattr(noise.background_density, key)
            dataset = group.create_dataset(name, data=values, chunks=values.shape, fletcher32=True)
            dataset.attrs["units"] = "mm" if key == "range_mm" else "mm-1"
        group["noise_background_range"].make_scale("noise_background_range")
        group["noise_background_density"].dims[0].attach_scale(group["noise_background_range"])
    if noise.shape is not None:
        for name, key in _SHAPE.items():
            values = getattr(noise.shape, key)
            group.create_dataset(name, data=values, chunks=values.shape, fletcher32=True).attrs["units"] = "1"
        group["noise_shape_z"].make_scale("noise_shape_z")
        group["noise_shape_density"].dims[0].attach_scale(group["noise_shape_z"])
    if noise.width_spread:
        group.attrs[_WIDTH_SPREAD] = float(noise.width_spread)
    if noise.background is not None:
        of_each = np.broadcast_to(noise.background, image)
        options = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
        share = group.create_dataset(_BACKGROUND, data=of_each, chunks=image, **options)
        share.attrs["units"] = "1"
        for axis, name in enumerate(("row", "col")):
            if name in group.file:
                share.dims[axis].attach_scale(group.file[name])


def read_sensor(root: h5py.File, path: Path) -> Sensor:
    """Read the group `sensor`; a file without one gives a sensor of which nothing is known.

    Raises
    ------
    BadInputError
        If an attribute is not a number or out of bounds, or the noise curve is unfit.
    """
    group = root.get("sensor")
    if group is None:
        return Sensor(name="unknown")
    if not isinstance(group, h5py.Group):
        raise BadInputError(f"{path}: sensor: expected a group, got a dataset")
    numbers = {key: _number(group, key, path) for key in (*SENSOR_NUMBERS, *RARE_SENSOR_NUMBERS)}
    # NaN: not known; inf: no such limit, as for a stereo camera's [686, inf).
    known = {key: value for key, value in numbers.items() if value is not None and np.isfinite(value)}
    known.setdefault("outlier_probability", DEFAULT_OUTLIER_PROBABILITY)
    try:
        noise, projection = _read_noise(group, path), _read_projection(group, path)
        learnt = _read_learnt(group, path)
        return Sensor(
            name=text_attribute(group, "name") or "unknown",
            measurement=_read_measurement(group),
            share_law=_read_share_law(group),
            noise=noise,
            projection=projection,
            learnt=learnt,
            range_step_mm=_read_step(group, path),
            temporal_filter=_read_filter(group, path),
            **known,
        )
    except ValueError as error:
        raise BadInputError(f"{path}: sensor: {error}") from error


def _read_filter(group: h5py.Group, path: Path) -> TemporalFilter | None:
    kind = text_attribute(group, _FILTER)
    return make_filter(kind, _number(group, _FILTER_PARAMETER, path) or 0.0) if kind else None


def _read_measurement(group: h5py.Group) -> Measurement | None:
    text = text_attribute(group, "measurement")
    return measurement_of(text) if text else None


def _read_share_law(group: h5py.Group) -> ShareLaw | None:
    text = text_attribute(group, "share_law")
    return share_law_of(text) if text else None


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
    if value.size > _MOST_COEFFICIENTS or (value.size > 0 and value.dtype.kind not in "iuf"):
        raise BadInputError(
            f"{path}: sensor: {key}: expected a short list of numbers, got {value.dtype} of shape {value.shape}"
        )
    return [float(number) for number in value.ravel()]


def _read_noise(group: h5py.Group, path: Path) -> NoiseCurve | None:
    present = [name for name in ("noise_range", "noise_sigma") if name in group]
    if not present:
        return None
    if len(present) == 1:
        raise BadInputError(f"{path}: sensor: {present[0]} alone; noise_range and noise_sigma go together")
    range_mm, sigma_mm = (_numbers(group, name, path) for name in present)
    return NoiseCurve(
        range_mm,
        sigma_mm,
        _read_part(group, path, AmplitudeLaw, _LAW),
        shape=_read_part(group, path, NoiseShape, _SHAPE),
        width_spread=_number(group, _WIDTH_SPREAD, path) or 0.0,
        background=_read_background(group, path),
        background_density=_read_part(group, path, BackgroundDensity, _DENSITY),
    )


def _read_part(group: h5py.Group, path: Path, part: Callable[..., T], names: Mapping[str, str]) -> T | None:
    """A part of the noise from its datasets, in the order of its fields; None without any of them."""
    present = [name for name in names if name in group]
    if not present:
        return None
    if len(present) < len(names):
        together = ", ".join(names) if len(names) > 2 else " and ".join(names)  # noqa: PLR2004  both of two
        raise BadInputError(f"{path}: sensor: {present[0]} alone; {together} go together")
    return part(*(_numbers(group, name, path) for name in names))


def _read_background(group: h5py.Group, path: Path) -> NDArray[np.float64] | None:
    return _numbers(group, _BACKGROUND, path, most=MOST_PIXELS_A_SIDE**2) if _BACKGROUND in group else None


def check_maps(sensor: Sensor, image: tuple[int, int], path: Path) -> None:
    """Refuse a map of background shares, or of steps of the ranges, that is of another image.

    Parameters
    ----------
    sensor : Sensor
        The camera that was read from the file.
    image : (int, int)
        Rows and columns of the file's image.
    path : Path
        The file.

    Raises
    ------
    BadInputError
        If it is.
    """
    background = None if sensor.noise is None else sensor.noise.background
    for name, values in ((_BACKGROUND, background), (_STEP, sensor.range_step_mm)):
        if values is not None and values.ndim == _IMAGE_RANK and values.shape != tuple(image):
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
