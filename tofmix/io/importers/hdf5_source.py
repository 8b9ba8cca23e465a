"""HDF5: one dataset of any file, with its amplitudes, times and camera.

`--dataset` names it; without, it is the only one of frames, or `range`. Its attributes `units` and `_FillValue`, its
dimension scales, and a group `sensor` as in a recording are used where they are there.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io import hdf5, sensor_group
from tofmix.io.guard import guard
from tofmix.io.importers.arrays import check_shapes, check_time, choose, joined
from tofmix.io.importers.axes import FRAMES_FIRST, WITH_TARGETS, axes_of
from tofmix.io.importers.base import FrameSource, Request
from tofmix.io.importers.datasets import DatasetFrames
from tofmix.io.importers.units import unit_mm_of
from tofmix.io.layers.layers_file import FORMAT as LAYERS_FORMAT

_RANGE, _AMPLITUDE, _TIME = "range", "amplitude", "time"
_OF_OUR_OWN = ("truth/", "sensor/noise_")
"""Groups of a recording whose datasets are no samples."""


@contextmanager
def open_hdf5(path: Path, request: Request) -> Iterator[FrameSource]:
    """Open an HDF5 file.

    Raises
    ------
    BadInputError
        If it is damaged, holds no fitting dataset or several, or datasets do not go together.
    """
    with guard.open_for_reading(path) as root:
        yield _source(root, path, request)


def _source(root: h5py.File, path: Path, request: Request) -> FrameSource:
    if hdf5.text_attribute(root, "format") == LAYERS_FORMAT:
        raise BadInputError(f"{path}: a layers file, not a recording: tofmix report {path}")
    with guard.reading(path, "datasets"):
        shapes = _datasets(root)
    name = choose(
        shapes, None if request.topic is None else request.topic.strip("/"), path, _axes_asked(root, shapes, request)
    )
    depth = _frames(root, name, shapes, path, request)
    dataset = guard.checked_dataset(root, name, path)
    amplitude = _amplitude(root, name, shapes, path, request)
    time_s = _time(root, name, shapes, depth.shape[0], path)
    return FrameSource(
        kind=f"dataset {name}{'' if amplitude is None else f' with {amplitude.name}'} of an HDF5 file",
        shape=depth.shape,
        targets=depth.targets,
        dtype=depth.dtype,
        frames=joined(depth, amplitude, time_s),
        unit_mm=_unit(dataset, name, path, request),
        invalid=_fill(dataset, path),
        has_amplitude=amplitude is not None,
        has_time=time_s is not None,
        sensor=sensor_group.read_sensor(root, path) if isinstance(root.get("sensor"), h5py.Group) else None,
    )


def _datasets(root: h5py.File) -> dict[str, tuple[int, ...]]:
    """Datasets of numbers by their path, with their shapes; no dimension scales and nothing of a `truth`."""
    found: dict[str, tuple[int, ...]] = {}

    def add(name: str, item: h5py.HLObject) -> None:
        own = name.startswith(_OF_OUR_OWN)
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and item.shape and not own:
            found[name] = item.shape

    root.visititems(add)
    return found


def _scales(dataset: h5py.Dataset) -> str | None:
    """Axes of a dataset by the names of its dimension scales, if these are known names."""
    names = [dim[0].name.rsplit("/", 1)[-1] if len(dim) else "" for dim in dataset.dims]
    known = [order.split(",") for order in (FRAMES_FIRST, WITH_TARGETS)]
    return ",".join(names) if sorted(names) in [sorted(order) for order in known] else None


def _axes_asked(root: h5py.File, shapes: dict[str, tuple[int, ...]], request: Request) -> str | None:
    """Axes that select the dataset: the requested ones, or those of the scales of a dataset ``range``."""
    if request.axes is None and _RANGE in shapes:
        return _scales(root[_RANGE])
    return request.axes


def _frames(
    root: h5py.File, name: str, shapes: dict[str, tuple[int, ...]], path: Path, request: Request
) -> DatasetFrames:
    dataset = guard.checked_dataset(root, name, path)
    with guard.reading(path, name):
        asked = request.axes or _scales(dataset)
    names = axes_of(shapes[name], asked, request.shape, f"{path}: {name}")
    return DatasetFrames(dataset, names, request.shape, path, name)


def _amplitude(
    root: h5py.File, name: str, shapes: dict[str, tuple[int, ...]], path: Path, request: Request
) -> DatasetFrames | None:
    """The requested amplitudes, or those next to a dataset ``range``."""
    if request.amplitude is not None:
        other = choose(shapes, request.amplitude.strip("/"), path, request.axes)
        check_shapes(shapes[name], shapes[other], f"{path}: {other}")
        return _frames(root, other, shapes, path, request)
    other = _companion(name, _AMPLITUDE)
    if name.rpartition("/")[2] == _RANGE and shapes.get(other) == shapes[name]:
        return _frames(root, other, shapes, path, request)
    return None


def _companion(name: str, other: str) -> str:
    group = name.rpartition("/")[0]
    return f"{group}/{other}" if group else other


def _time(root: h5py.File, name: str, shapes: dict[str, tuple[int, ...]], frames: int, path: Path) -> FloatArray | None:
    other = _companion(name, _TIME)
    if other not in shapes:
        return None
    dataset = guard.checked_dataset(root, other, path)
    if hdf5.text_attribute(dataset, "units") not in (None, "s"):
        return None
    with guard.reading(path, other):
        time_s = np.asarray(dataset[...], dtype=np.float64)
    check_time(time_s, frames, path)
    return time_s


def _unit(dataset: h5py.Dataset, name: str, path: Path, request: Request) -> float | None:
    text = hdf5.text_attribute(dataset, "units")
    if text is None or request.unit_mm is not None:
        return None
    unit = unit_mm_of(text)
    if unit is None:
        raise BadInputError(f"{path}: {name}: units {text!r} are not a known unit of length; give --units or --scale")
    return unit


def _fill(dataset: h5py.Dataset, path: Path) -> tuple[float, ...]:
    try:
        fill = hdf5.fill_value(dataset)
    except BadInputError as error:
        raise BadInputError(f"{path}: {error}") from error
    return () if fill is None else (float(fill[0]),)
