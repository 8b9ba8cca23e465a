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
from tofmix.io.guard import guard
from tofmix.io.guard.watchdog import watched
from tofmix.io.importers.arrays import Container, Frames, frames_of, source_of
from tofmix.io.importers.base import (
    FRAMES_FIRST,
    FRAMES_LAST,
    STACK_DIMENSIONS,
    FrameSource,
    SourceRequest,
    axes_of,
    foreign,
)
from tofmix.io.importers.conversion import set_of
from tofmix.io.importers.datasets import dataset_frames
from tofmix.io.locks import scratch_folder

_BYTES = set_of("int8 uint8 logical char")
"""MATLAB's classes of 8 bits."""

_NUMBERS = _BYTES | set_of("int16 uint16 int32 uint32 int64 uint64 single double sparse")
_STRUCTS = ("struct", "object", "cell", "opaque", "unknown")
"""MATLAB's classes of variables that hold others."""


@contextmanager
def open_mat(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open a .mat with the depths, and optionally amplitudes and `time`."""
    if guard.is_hdf5(path):
        with guard.open_for_reading(path) as root:
            yield source_of(_OfHdf5(root, path), request, path)
    else:
        with scratch_folder() as folder:
            yield _of_scipy(path, request, folder)


class _Matlab(Container):
    """A .mat, whose order of axes may follow from the sensor's image."""

    def __init__(self, kind: str, path: Path, shapes: dict[str, tuple[int, ...]], bytewise: set[str]) -> None:
        super().__init__(kind, shapes, bytewise)
        self._path = path

    def with_axes(self, name: str, request: SourceRequest) -> SourceRequest:
        shape, image = self.shapes[name], request.image or request.shape
        if request.axes is not None or len(shape) != STACK_DIMENSIONS:
            return request
        first, last = shape[1:] == image, shape[:2] == image
        if first == last:
            known = "" if image is None else f" and a sensor of {image[0]} x {image[1]}"
            raise BadInputError(
                f"{self._path}: {name}: the order of its axes does not follow from size {shape}{known};"
                f" choose --axes {FRAMES_LAST} or --axes {FRAMES_FIRST}"
            )
        return replace(request, axes=FRAMES_FIRST if first else FRAMES_LAST)


class _OfScipy(_Matlab):
    """Up to version 7: a child process lists its arrays, then unpacks some into a folder."""

    def __init__(self, path: Path, folder: Path, child: "subprocess.Popen[str]") -> None:
        assert child.stdout is not None  # noqa: S101  for the type checker: it is a pipe
        self._folder, self._child = folder, child
        self._held: dict[str, NDArray[Any]] = {}
        listed = child.stdout.readline()
        if not listed:
            raise _refusal(child, child.communicate()[1], path)
        found = json.loads(listed)
        shapes = {name: tuple(shape) for name, (shape, kind) in found.items() if kind in _NUMBERS}
        _refuse_structs(shapes, [f"{name} ({kind})" for name, (_, kind) in found.items() if kind in _STRUCTS], path)
        super().__init__("a .mat", path, shapes, {name for name, (_, kind) in found.items() if kind in _BYTES})

    def load(self, names: list[str]) -> None:
        complaint = self._child.communicate(json.dumps(names) + "\n")[1]
        if self._child.returncode:
            raise _refusal(self._child, complaint, self._path)
        with foreign(self._path):
            for number, name in enumerate(names):
                self._held[name] = np.load(self._folder / f"{number}.npy", mmap_mode="r", allow_pickle=False)

    def frames(self, name: str, request: SourceRequest) -> Frames:
        return frames_of(self._held[name], request, f"{self._path}: {name}")

    def values(self, name: str) -> NDArray[Any]:
        return np.asarray(self._held[name])


class _OfHdf5(_Matlab):
    """Version 7.3, in which HDF5 sees MATLAB's axes in reverse."""

    def __init__(self, root: h5py.File, path: Path) -> None:
        self._root = root
        with guard.reading(path, "variables"):
            datasets = {name: item for name, item in root.items() if isinstance(item, h5py.Dataset)}
            shapes = {name: tuple(reversed(item.shape)) for name, item in datasets.items()}
            bytewise = {name for name, item in datasets.items() if item.dtype.itemsize == 1}
            holders = [name for name, item in root.items() if isinstance(item, h5py.Group) and not name.startswith("#")]
        _refuse_structs(shapes, [f"{name} (struct)" for name in holders], path)
        super().__init__("a .mat of version 7.3", path, shapes, bytewise)

    def frames(self, name: str, request: SourceRequest) -> Frames:
        dataset = guard.checked_dataset(self._root, name, self._path)
        axes = axes_of(self.shapes[name], request.axes, None, f"{self._path}: {name}")
        return dataset_frames(dataset, axes[::-1], None, self._path, name)

    def values(self, name: str) -> NDArray[Any]:
        with guard.reading(self._path, name):
            return np.asarray(guard.checked_dataset(self._root, name, self._path)[...])


def _of_scipy(path: Path, request: SourceRequest, folder: Path) -> FrameSource:
    program = [sys.executable, "-P", str(Path(__file__).with_name("mat_child.py")), str(path), str(folder)]
    pipe = subprocess.PIPE
    unpacking_times = 6.0  # factor on the time limit of a read: a whole file is unpacked at once
    with (
        watched(str(path), times=unpacking_times),
        subprocess.Popen(program, stdin=pipe, stdout=pipe, stderr=pipe, text=True, start_new_session=True) as child,  # noqa: S603  our own
    ):
        return source_of(_OfScipy(path, folder, child), request, path)


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
