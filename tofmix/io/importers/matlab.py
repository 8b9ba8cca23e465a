"""MATLAB's .mat: up to version 7 by SciPy, version 7.3 as the HDF5 file that it is.

MATLAB's own order is (row, col, frame). Version 7.3 is read frame by frame; it stores its axes reversed, which is
undone here. Up to version 7 a separate process unpacks an array into the temporary folder; a damaged file may crash it.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError, ExitCode, StorageError, TofmixError
from tofmix.io.atomic.scratch_folder import scratch_folder
from tofmix.io.guard import guard
from tofmix.io.guard.watchdog import watched
from tofmix.io.importers.arrays import (
    TIME,
    SideArrays,
    arrays_beside,
    check_shapes,
    choose,
    joined,
    sizes_of,
    stack_of,
)
from tofmix.io.importers.axes import FRAMES_FIRST, FRAMES_LAST, STACK_DIMENSIONS, axes_of
from tofmix.io.importers.base import FrameSource, SourceRequest, foreign
from tofmix.io.importers.datasets import DatasetFrames
from tofmix.io.importers.streams import set_of
from tofmix.io.importers.times import times_of_array
from tofmix.io.importers.units import unit_in_name

_BYTES = set_of("int8 uint8 logical char")
"""MATLAB's classes of 8 bits."""

_NUMBERS = _BYTES | set_of("int16 uint16 int32 uint32 int64 uint64 single double sparse")
_STRUCTS = ("struct", "object", "cell", "opaque", "unknown")
"""MATLAB's classes of variables that hold others."""

_UNPACKING_TIMES = 6.0
"""Factor on the time limit of a read: a whole file is unpacked at once."""


@contextmanager
def open_mat(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open a .mat with the depths, and optionally amplitudes and `time`."""
    if guard.is_hdf5(path):
        with guard.open_for_reading(path) as root:
            yield _of_hdf5(root, path, request)
    else:
        with scratch_folder() as folder:
            yield _of_scipy(path, request, folder)


def _with_axes(shape: tuple[int, ...], request: SourceRequest, what: str) -> SourceRequest:
    """Determine the order of the axes, in MATLAB's view; from the sensor's image if it is not given."""
    image = request.image or request.shape
    if request.axes is not None or len(shape) != STACK_DIMENSIONS:
        return request
    first, last = shape[1:] == image, shape[:2] == image
    if first == last:
        known = "" if image is None else f" and a sensor of {image[0]} x {image[1]}"
        raise BadInputError(
            f"{what}: the order of its axes does not follow from size {shape}{known};"
            f" choose --axes {FRAMES_LAST} or --axes {FRAMES_FIRST}"
        )
    return replace(request, axes=FRAMES_FIRST if first else FRAMES_LAST)


def _of_scipy(path: Path, request: SourceRequest, folder: Path) -> FrameSource:
    program = [sys.executable, "-P", str(Path(__file__).with_name("mat_child.py")), str(path), str(folder)]
    pipe = subprocess.PIPE
    with (
        watched(str(path), times=_UNPACKING_TIMES),
        subprocess.Popen(program, stdin=pipe, stdout=pipe, stderr=pipe, text=True, start_new_session=True) as child,  # noqa: S603  our own
    ):
        assert child.stdout is not None  # noqa: S101  for the type checker: it is a pipe
        listed = child.stdout.readline()
        if not listed:
            raise _refusal(child, child.communicate()[1], path)
        found = json.loads(listed)
        shapes = {name: tuple(shape) for name, (shape, kind) in found.items() if kind in _NUMBERS}
        _refuse_structs(shapes, [f"{name} ({kind})" for name, (_, kind) in found.items() if kind in _STRUCTS], path)
        name = choose(
            shapes, request.topic, path, request.axes, {n for n, (_, kind) in found.items() if kind in _BYTES}
        )
        names = [name] if request.amplitude is None else [name, choose(shapes, request.amplitude, path, request.axes)]
        beside = arrays_beside(shapes, name, request, path)
        request = _with_axes(shapes[name], request, f"{path}: {name}")
        names += [beside.status] if beside.status is not None else []
        wanted = [*names, TIME] if TIME in shapes else names
        complaint = child.communicate(json.dumps(wanted) + "\n")[1]
    if child.returncode:
        raise _refusal(child, complaint, path)
    with foreign(path):
        held = [np.load(folder / f"{k}.npy", mmap_mode="r", allow_pickle=False) for k in range(len(wanted))]
    arrays = [stack_of(held[k], request, f"{path}: {one}") for k, one in enumerate(names)]
    stored = np.asarray(held[-1]) if TIME in shapes else None
    status = arrays.pop() if beside.status is not None else None
    amplitude = arrays[1] if request.amplitude is not None else None
    return _source(path, name, arrays[0], amplitude, status, stored, beside, request.time_unit_s)


def _refuse_structs(shapes: dict[str, tuple[int, ...]], holders: list[str], path: Path) -> None:
    """Raise `BadInputError` if all images may be within variables that hold others, which are not read."""
    if holders and not any(len(shape) > 1 and min(shape) > 1 for shape in shapes.values()):
        name = holders[0].split(" ")[0]
        raise BadInputError(
            f"{path}: no array of frames, but {', '.join(holders)}, whose parts are not read; in MATLAB: depth ="
            f" {name}.depth; save('{path.stem}_depth.mat', 'depth')"
        )


def _refusal(child: "subprocess.Popen[str]", complaint: str, path: Path) -> TofmixError:
    """Error of a child process that failed."""
    if child.returncode < 0:
        return BadInputError(f"{path}: cannot be read: SciPy's reader crashed on it; the file is damaged")
    reason = complaint.strip().splitlines()
    if child.returncode == ExitCode.STORAGE:
        return StorageError(f"{gettempdir()}: {reason[-1]}; {path} is unpacked in this folder")
    return BadInputError(f"{path}: cannot be read: {reason[-1] if reason else 'no reason given'}")


def _source(
    path: Path,
    name: str,
    depth: NDArray[Any],
    amplitude: NDArray[Any] | None,
    status: NDArray[Any] | None,
    stored_time: NDArray[Any] | None,
    beside: SideArrays,
    time_unit_s: float | None,
) -> FrameSource:
    if amplitude is not None:
        check_shapes(depth.shape, amplitude.shape, f"{path}: amplitudes beside {name}")
    time_s: NDArray[Any] | None = None
    said: tuple[str, ...] = ()
    if stored_time is not None:
        time_s, said = times_of_array(stored_time, depth.shape[0], f"{path}: {TIME}", time_unit_s)
    return FrameSource(
        kind=f"array {name} of a .mat",
        shape=sizes_of(depth)[0],
        targets=sizes_of(depth)[1],
        dtype=depth.dtype,
        unit_mm=unit_in_name(name),
        frames=joined(depth, amplitude, time_s, status),
        status_valid=beside.codes,
        has_amplitude=amplitude is not None,
        has_time=time_s is not None,
        stream=name,
        notes=(*beside.notes, *said),
    )


def _of_hdf5(root: h5py.File, path: Path, request: SourceRequest) -> FrameSource:
    with guard.reading(path, "variables"):
        # HDF5 sees MATLAB's axes in reverse.
        datasets = {name: item for name, item in root.items() if isinstance(item, h5py.Dataset)}
        shapes = {name: tuple(reversed(item.shape)) for name, item in datasets.items()}
        bytewise = {name for name, item in datasets.items() if item.dtype.itemsize == 1}
        holders = [name for name, item in root.items() if isinstance(item, h5py.Group) and not name.startswith("#")]
    _refuse_structs(shapes, [f"{name} (struct)" for name in holders], path)
    name = choose(shapes, request.topic, path, request.axes, bytewise)
    beside = arrays_beside(shapes, name, request, path)
    request = _with_axes(shapes[name], request, f"{path}: {name}")
    depth = _variable(root, name, shapes[name], request, path)
    status = None if beside.status is None else _variable(root, beside.status, shapes[beside.status], request, path)
    amplitude = None
    if request.amplitude is not None:
        other = choose(shapes, request.amplitude, path, request.axes)
        check_shapes(shapes[name], shapes[other], f"{path}: {other}")
        amplitude = _variable(root, other, shapes[other], request, path)
    time_s: NDArray[Any] | None = None
    said: tuple[str, ...] = ()
    if TIME in shapes:
        with guard.reading(path, TIME):
            time_s = np.asarray(guard.checked_dataset(root, TIME, path)[...])
        time_s, said = times_of_array(time_s, depth.shape[0], f"{path}: {TIME}", request.time_unit_s)
    return FrameSource(
        kind=f"array {name} of a .mat of version 7.3",
        shape=depth.shape,
        targets=depth.targets,
        dtype=depth.dtype,
        unit_mm=unit_in_name(name),
        frames=joined(depth, amplitude, time_s, status),
        status_valid=beside.codes,
        has_amplitude=amplitude is not None,
        has_time=time_s is not None,
        stream=name,
        notes=(*beside.notes, *said),
    )


def _variable(root: h5py.File, name: str, shape: tuple[int, ...], request: SourceRequest, path: Path) -> DatasetFrames:
    """A variable of a version 7.3 file, which stores axes in reverse order."""
    axes = axes_of(shape, request.axes, None, f"{path}: {name}")
    return DatasetFrames(guard.checked_dataset(root, name, path), axes[::-1], None, path, name)
