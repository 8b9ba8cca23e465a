"""MATLAB's .mat: up to version 7 by SciPy, version 7.3 as the HDF5 file that it is.

MATLAB's own order is (row, col, frame). Version 7.3 is read frame by frame; it
stores its axes reversed, which is undone here. Up to version 7 an array is unpacked
into the temporary folder by a process of its own, which a damaged file may crash.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError, ExitCode, StorageError, TofmixError
from tofmix.io import guard
from tofmix.io.importers.arrays import (
    FRAMES_FIRST,
    TIME,
    check_not_empty,
    check_shapes,
    check_time,
    choose,
    frames_first,
    joined,
)
from tofmix.io.importers.base import IMAGE_DIMENSIONS, Axes, Frame, FrameSource, Request, check_numbers, foreign
from tofmix.io.scratch_folder import scratch_folder
from tofmix.io.watchdog import watched

_FRAMES_LAST: Axes = "row,col,frame"
_DIMENSIONS = 3
_UNPACKING_TIMES = 6.0
"""A whole file is unpacked at once, which takes longer than a read."""


@contextmanager
def open_mat(path: Path, request: Request) -> Iterator[FrameSource]:
    """Open a .mat with the depths, and optionally amplitudes and `time`.

    Raises
    ------
    BadInputError
        If it is damaged, holds no fitting array or several, its axes cannot be told, or arrays do not go together.
    """
    if guard.is_hdf5(path):
        with guard.open_for_reading(path) as root:
            yield _of_hdf5(root, path, request)
    else:
        with scratch_folder() as folder:
            yield _of_scipy(path, request, folder)


def _axes(shape: tuple[int, ...], request: Request, what: str) -> Axes:
    """Tell the order of the axes, given in MATLAB's view, by the sensor's image where nobody says."""
    if request.axes is not None or len(shape) != _DIMENSIONS:
        return request.axes or FRAMES_FIRST
    first, last = shape[1:] == request.image, shape[:2] == request.image
    if first == last:
        rows, cols = request.image
        raise BadInputError(
            f"{what}: size {shape} and a sensor of {rows} x {cols} do not tell the order of its axes;"
            f" choose --axes {_FRAMES_LAST} or --axes {FRAMES_FIRST}"
        )
    return FRAMES_FIRST if first else _FRAMES_LAST


def _of_scipy(path: Path, request: Request, folder: Path) -> FrameSource:
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
        shapes = {name: tuple(shape) for name, shape in json.loads(listed).items()}
        name = choose(shapes, request.topic, path)
        names = [name] if request.amplitude is None else [name, choose(shapes, request.amplitude, path)]
        axes = _axes(shapes[name], request, f"{path}: {name}")
        wanted = [*names, TIME] if TIME in shapes else names
        complaint = child.communicate(json.dumps(wanted) + "\n")[1]
    if child.returncode:
        raise _refusal(child, complaint, path)
    with foreign(path):
        held = [np.load(folder / f"{k}.npy", mmap_mode="r", allow_pickle=False) for k in range(len(wanted))]
    arrays = [frames_first(held[k], axes, f"{path}: {one}") for k, one in enumerate(names)]
    time_s = held[-1] if TIME in shapes else None
    return _source(path, name, arrays, time_s, f"array {name} of a .mat")


def _refusal(child: "subprocess.Popen[str]", complaint: str, path: Path) -> TofmixError:
    """What to say of a child that failed."""
    if child.returncode < 0:
        return BadInputError(f"{path}: cannot be read: SciPy's reader crashed on it; the file is damaged")
    reason = complaint.strip().splitlines()
    if child.returncode == ExitCode.STORAGE:
        return StorageError(f"{gettempdir()}: {reason[-1]}; {path} is unpacked there")
    return BadInputError(f"{path}: cannot be read: {reason[-1] if reason else 'no reason given'}")


def _source(path: Path, name: str, arrays: list[NDArray[Any]], time_s: Any, kind: str) -> FrameSource:  # noqa: ANN401  what loadmat gives
    depth, amplitude = arrays[0], arrays[1] if len(arrays) > 1 else None
    if amplitude is not None:
        check_shapes(depth.shape, amplitude.shape, f"{path}: amplitudes beside {name}")
    if time_s is not None:
        check_time(np.asarray(time_s), depth.shape[0], path)
    return FrameSource(
        kind=kind,
        shape=depth.shape,
        dtype=depth.dtype,
        frames=joined(depth, amplitude, None if time_s is None else np.asarray(time_s)),
        has_amplitude=amplitude is not None,
        has_time=time_s is not None,
    )


def _of_hdf5(root: h5py.File, path: Path, request: Request) -> FrameSource:
    with guard.reading(path, "variables"):
        # HDF5 sees MATLAB's axes in reverse.
        shapes = {n: tuple(reversed(item.shape)) for n, item in root.items() if isinstance(item, h5py.Dataset)}
    name = choose(shapes, request.topic, path)
    axes = _axes(shapes[name], request, f"{path}: {name}")
    depth = _Variable(root, name, axes, path)
    amplitude = None
    if request.amplitude is not None:
        amplitude = _Variable(root, choose(shapes, request.amplitude, path), axes, path)
        check_shapes(depth.shape, amplitude.shape, f"{path}: {amplitude.name}")
    time_s = None
    if TIME in shapes:
        with guard.reading(path, TIME):
            time_s = np.asarray(guard.checked_dataset(root, TIME, path)[...])
        check_time(time_s, depth.shape[0], path)
    return FrameSource(
        kind=f"array {name} of a .mat of version 7.3",
        shape=depth.shape,
        dtype=depth.dtype,
        frames=_hdf5_frames(depth, amplitude, time_s),
        has_amplitude=amplitude is not None,
        has_time=time_s is not None,
    )


class _Variable:
    """A variable of a version 7.3 file, frame by frame."""

    def __init__(self, root: h5py.File, name: str, axes: Axes, path: Path) -> None:
        self.name, self._path = name, path
        self._dataset = guard.checked_dataset(root, name, path)
        self._frames_first = axes == FRAMES_FIRST
        self.dtype: np.dtype[Any] = self._dataset.dtype
        check_numbers(self.dtype, f"{path}: {name}")
        stored = self._dataset.shape  # (col, row, frame) of MATLAB's (frame, row, col); (frame, col, row) of its own
        if len(stored) == IMAGE_DIMENSIONS:
            stored = (1, *stored)
            self._single = True
        else:
            self._single = False
        check_not_empty(stored, f"{path}: {name}")
        frames_last = self._frames_first and not self._single
        self.shape: tuple[int, int, int] = stored[::-1] if frames_last else (stored[0], stored[2], stored[1])

    def __getitem__(self, frame: int) -> NDArray[Any]:
        with guard.reading(self._path, self.name):
            if self._single:
                image = self._dataset[...]
            else:
                image = self._dataset[..., frame] if self._frames_first else self._dataset[frame]
        return np.asarray(image).T


def _hdf5_frames(depth: _Variable, amplitude: _Variable | None, time_s: NDArray[Any] | None) -> Iterator[Frame]:
    for number in range(depth.shape[0]):
        yield Frame(
            depth=depth[number],
            amplitude=None if amplitude is None else amplitude[number],
            time_s=None if time_s is None else float(time_s.reshape(-1)[number]),
        )
