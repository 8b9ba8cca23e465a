"""HDF5: one dataset of any file, with its amplitudes, times and camera.

`--dataset` names it; without, it is the only one of frames, or `range`. Its attribute `units` or `unit`, its packing
and fill values (`tofmix.io.importers.datasets`), its dimension scales, and a group `sensor` as in a recording are used
where they are there.
"""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError, UsageError
from tofmix.io import hdf5, sensor_group
from tofmix.io.guard import guard
from tofmix.io.importers.arrays import (
    Frames,
    arrays_beside,
    check_shapes,
    choose,
    joined,
    kind_of_names,
    numbered_images,
)
from tofmix.io.importers.base import (
    FRAMES_FIRST,
    WITH_TARGETS,
    Frame,
    FrameSource,
    SourceRequest,
    axes_of,
    axis_name,
    check_frame,
    foreign,
    unused,
)
from tofmix.io.importers.datasets import Packing, dataset_frames, packing_of
from tofmix.io.importers.times import time_unit_s, times_of_array
from tofmix.io.layers.layers_file import FORMAT as LAYERS_FORMAT
from tofmix.io.next_command import import_command
from tofmix.io.recording.range_check import unit_in_name, unit_mm_of

_RANGE, _AMPLITUDE, _TIME = "range", "amplitude", "time"
_CLASSIC = (b"CDF\x01", b"CDF\x02", b"CDF\x05")
"""First bytes of netCDF's classic formats."""
_OF_OUR_OWN = ("truth/", "sensor/noise_")
"""Groups of a recording whose datasets are no samples."""


@contextmanager
def open_hdf5(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open an HDF5 file."""
    _refuse_classic(path)
    with guard.open_for_reading(path) as root:
        yield _source(root, path, request)


def _refuse_classic(path: Path) -> None:
    """Refuse netCDF's formats before netCDF-4, which are not HDF5, with the command that converts them."""
    with foreign(path), path.open("rb") as file:
        is_classic = file.read(4) in _CLASSIC
    if is_classic:
        new = path.with_name(f"{path.stem}_nc4.nc")
        raise BadInputError(
            f"{path}: classic netCDF, not netCDF-4: {shlex.join(['nccopy', '-k', 'nc4', str(path), str(new)])}; then"
            f" {import_command(new)}"
        )


def _source(root: h5py.File, path: Path, request: SourceRequest) -> FrameSource:
    if hdf5.text_attribute(root, "format") == LAYERS_FORMAT:
        raise BadInputError(f"{path}: a layers file, not a recording: tofmix report {path}")
    with guard.reading(path, "datasets"):
        shapes = _datasets(root)
    wanted = None if request.topic is None else request.topic.strip("/")
    of_frames = None if request.axes is not None else numbered_images(shapes, wanted)
    if of_frames is not None:
        return _one_dataset_a_frame(root, of_frames, path, request)
    name = choose(
        shapes,
        wanted,
        path,
        _axes_asked(root, shapes, request),
        {name for name in shapes if root[name].dtype.itemsize == 1},
    )
    of_range = name.rpartition("/")[2] == _RANGE and request.amplitude is None
    beside = arrays_beside(shapes, name, request, path, (_companion(name, _AMPLITUDE),) if of_range else ())
    notes = [*_axes_guessed(root, name, request, path), *beside.notes]
    depth = _frames(root, name, shapes, path, request)
    dataset = guard.checked_dataset(root, name, path)
    packing = _packing(root, dataset, path)
    other = _amplitude(name, shapes, path, request)
    light = None
    if other is not None:
        amplitude = _frames(root, other, shapes, path, request)
        light = map(_packing(root, guard.checked_dataset(root, other, path), path).unpacked, amplitude.images)
    time_s = _time(root, name, shapes, depth.shape[0], path, request, notes)
    status = None if beside.status is None else _frames(root, beside.status, shapes, path, request)
    return FrameSource(
        kind=f"dataset {name}{'' if other is None else f' with {other}'} of an HDF5 file",
        shape=depth.shape,
        targets=depth.targets,
        dtype=packing.dtype or depth.dtype,
        frames=joined(map(packing.as_marked, depth.images), light, time_s, None if status is None else status.images),
        unit_mm=_unit(dataset, name, path, request),
        **packing.stated(),
        status_valid=beside.codes,
        has_amplitude=other is not None,
        has_time=time_s is not None,
        sensor=sensor_group.read_sensor(root, path) if isinstance(root.get("sensor"), h5py.Group) else None,
        stream=name,
        notes=tuple(notes),
    )


def _one_dataset_a_frame(root: h5py.File, names: list[str], path: Path, request: SourceRequest) -> FrameSource:
    """Images of one frame each, in the order of the numbers in their names."""
    if request.amplitude is not None:
        raise UsageError(f"--amplitude does not apply to {path}: {names[0]} and others are one dataset a frame")
    first = guard.checked_dataset(root, names[0], path)
    packing, unit_mm = _packing(root, first, path), _unit(first, names[0], path, request)

    def images() -> Iterator[Frame]:
        for name in names:
            dataset = guard.checked_dataset(root, name, path)
            with guard.reading(path, name):
                image = np.asarray(dataset[...])
            stated = _packing(root, dataset, path), _unit(dataset, name, path, request)
            if stated != (packing, unit_mm):
                raise BadInputError(
                    f"{path}: {name}: {_stated(*stated)}, {names[0]} has {_stated(packing, unit_mm)}; store all frames"
                    " alike"
                )
            same = check_frame(image, first.shape, first.dtype, f"{path}: {name}")
            yield Frame(depth=packing.as_marked(same))

    return FrameSource(
        kind=f"{len(names)} datasets of an HDF5 file, one a frame",
        shape=(len(names), *first.shape),
        dtype=packing.dtype or first.dtype,
        frames=images(),
        unit_mm=unit_mm,
        **packing.stated(),
        stream=kind_of_names(names[0]),
        notes=(
            f"{path}: {names[0]} to {names[-1]} are taken as {len(names)} frames, in this order",
            *_not_frames(root, names, path),
        ),
    )


def _stated(packing: Packing, unit_mm: float | None) -> str:
    """The packing and the unit of a dataset in words."""
    parts = [f"scale_factor {packing.scale_factor:g}", f"add_offset {packing.add_offset:g}"]
    parts += ["no unit" if unit_mm is None else f"units of {unit_mm:g} mm"]
    parts += [f"fill values {', '.join(f'{value:g}' for value in packing.invalid) or 'none'}"]
    return ", ".join([*parts, f"valid from {packing.valid_span[0]:g} to {packing.valid_span[1]:g}"])


def _not_frames(root: h5py.File, names: list[str], path: Path) -> list[str]:
    """Note on the datasets beside the frames, by their kinds."""
    kinds: dict[str, int] = {}
    taken = kind_of_names(names[0])
    with guard.reading(path, "datasets"):
        for name, item in every_dataset(root):
            kind = kind_of_names(name)
            if item.dtype.kind in "iuf" and kind != taken:
                kinds[kind] = kinds.get(kind, 0) + 1
    return [unused(path, "datasets", [f"{kind} ({count})" for kind, count in kinds.items()])] if kinds else []


def _packing(root: h5py.File, dataset: h5py.Dataset, path: Path) -> Packing:
    with guard.reading(path, dataset.name):
        return packing_of(dataset, path, netcdf=path.suffix.lower() == ".nc" or "_NCProperties" in root.attrs)


def _datasets(root: h5py.File) -> dict[str, tuple[int, ...]]:
    """Datasets of numbers by their path, with their shapes; no dimension scales and nothing of a `truth`."""
    return {
        name: item.shape
        for name, item in every_dataset(root)
        if item.dtype.kind in "iuf" and item.shape and not name.startswith(_OF_OUR_OWN)
    }


def every_dataset(root: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Each dataset once, with its path, by names, as of `visititems`, whose time grows with the square of the depth."""
    seen: set[tuple[int, int]] = set()
    left: list[tuple[str, h5py.Group, str]] = [("", root, "/")]
    while left:
        path, parent, name = left.pop()
        item = parent[name]
        place = h5py.h5o.get_info(item.id)
        if (place.fileno, place.addr) in seen:
            continue
        seen.add((place.fileno, place.addr))
        if isinstance(item, h5py.Dataset):
            yield path, item
        elif isinstance(item, h5py.Group):
            own = sorted(item, key=lambda of: of.encode("utf-8", "surrogateescape"), reverse=True)
            links = (of for of in own if isinstance(item.get(of, getlink=True), h5py.HardLink))
            left += [(f"{path}/{of}".lstrip("/"), item, of) for of in links]


def _scales(dataset: h5py.Dataset) -> str | None:
    """Axes of a dataset by the names of its dimension scales, if these are known names."""
    names = [axis_name(dim[0].name.rsplit("/", 1)[-1]) if len(dim) else "" for dim in dataset.dims]
    known = [order.split(",") for order in (FRAMES_FIRST, WITH_TARGETS)]
    return ",".join(names) if sorted(names) in [sorted(order) for order in known] else None


def _axes_guessed(root: h5py.File, name: str, request: SourceRequest, path: Path) -> Iterator[str]:
    """Note on axes that are told by other names than those of a recording."""
    asked = None if request.axes is not None else _scales(root[name])
    if asked is None:
        return
    theirs = ",".join(dim[0].name.rsplit("/", 1)[-1] for dim in root[name].dims)
    if theirs != asked:
        yield f"{path}: {name}: the dimensions {theirs} are taken as --axes {asked}"


def _axes_asked(root: h5py.File, shapes: dict[str, tuple[int, ...]], request: SourceRequest) -> str | None:
    """Axes that select the dataset: the requested ones, or those of the scales of a dataset ``range``."""
    if request.axes is None and _RANGE in shapes:
        return _scales(root[_RANGE])
    return request.axes


def _frames(
    root: h5py.File, name: str, shapes: dict[str, tuple[int, ...]], path: Path, request: SourceRequest
) -> Frames:
    dataset = guard.checked_dataset(root, name, path)
    with guard.reading(path, name):
        asked = request.axes or _scales(dataset)
    names = axes_of(shapes[name], asked, request.shape, f"{path}: {name}")
    return dataset_frames(dataset, names, request.shape, path, name)


def _amplitude(name: str, shapes: dict[str, tuple[int, ...]], path: Path, request: SourceRequest) -> str | None:
    """The requested amplitudes, or those next to a dataset ``range``."""
    if request.amplitude is not None:
        other = choose(shapes, request.amplitude.strip("/"), path, request.axes)
        check_shapes(shapes[name], shapes[other], f"{path}: {other}")
        return other
    other = _companion(name, _AMPLITUDE)
    return other if name.rpartition("/")[2] == _RANGE and shapes.get(other) == shapes[name] else None


def _companion(name: str, other: str) -> str:
    group = name.rpartition("/")[0]
    return f"{group}/{other}" if group else other


def _time(
    root: h5py.File,
    name: str,
    shapes: dict[str, tuple[int, ...]],
    frames: int,
    path: Path,
    request: SourceRequest,
    notes: list[str],
) -> FloatArray | None:
    """Times of the frames, s, by the unit of `request` or of the dataset."""
    other = _companion(name, _TIME)
    if other not in shapes:
        return None
    dataset = guard.checked_dataset(root, other, path)
    units = _unit_text(dataset)
    unit_s = request.time_unit_s or (None if units is None else time_unit_s(units))
    if unit_s is None and units is not None:
        notes.append(f"{path}: not used: {other} in {units!r}, no known unit of time (--time-unit gives it)")
        return None
    with guard.reading(path, other):
        stored = np.asarray(dataset[...])
    time_s, said = times_of_array(_packing(root, dataset, path).unpacked(stored), frames, f"{path}: {other}", unit_s)
    notes += said
    return time_s


def _unit_text(dataset: h5py.Dataset) -> str | None:
    """The attribute ``units``, or ``unit``, in any case; None without text there."""
    keys = sorted(
        (key for key in dataset.attrs if key.lower() in ("units", "unit")), key=lambda key: (key != "units", key)
    )
    texts = (hdf5.text_attribute(dataset, key) for key in keys)
    return next((text for text in texts if text and text.strip()), None)


def _unit(dataset: h5py.Dataset, name: str, path: Path, request: SourceRequest) -> float | None:
    text = _unit_text(dataset)
    if request.unit_mm is not None:
        return None
    if text is None:
        return unit_in_name(name)
    unit = unit_mm_of(text)
    if unit is None:
        raise BadInputError(f"{path}: {name}: units {text!r} are not a known unit of length; give --units or --scale")
    return unit
