"""NumPy's .npy and .npz, never unpickled.

Both are read frame by frame. Where frames are not the first axis in memory, an
.npy is mapped and an array of an .npz is read whole.
"""

import math
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.importers.axes import FRAMES_FIRST, IMAGE_DIMENSIONS, STACK_DIMENSIONS, as_stack, axes_of
from tofmix.io.importers.base import (
    Frame,
    FrameSource,
    Request,
    check_numbers,
    foreign,
)

TIME = "time"
"""Name of an array of one number a frame, s."""

_WITH_TARGETS = STACK_DIMENSIONS + 1  # frames, rows, columns and targets
_PREFERRED = "range"


@contextmanager
def open_npy(path: Path, request: Request) -> Iterator[FrameSource]:
    """Open an .npy, (frame, row, col) or (row, col), or of the requested axes.

    Raises
    ------
    BadInputError
        If it is damaged, holds objects, or is of another shape.
    """
    with ExitStack() as stack:
        with foreign(path):
            file = stack.enter_context(path.open("rb"))
            shape, fortran, dtype = _header(file)
        check_numbers(dtype, path)
        if _in_order(shape, request, path) and not fortran:
            check_not_empty(shape, path)
            found, targets = (shape[0], shape[1], shape[2]), 0
            images = _unpacked(file, found, dtype, path)
        else:
            with foreign(path):
                array = np.load(path, mmap_mode="r", allow_pickle=False)
            frames = stack_of(array, request, path)
            found, targets = sizes_of(frames)
            images = iter(frames)
        yield FrameSource(
            kind="NumPy array", shape=found, targets=targets, dtype=dtype, frames=joined(images, None, None)
        )


@contextmanager
def open_npz(path: Path, request: Request) -> Iterator[FrameSource]:
    """Open an .npz with the depths, and optionally amplitudes and `time`.

    Raises
    ------
    BadInputError
        If it is damaged, holds no fitting array or several, or arrays do not go together.
    """
    with ExitStack() as stack:
        with foreign(path):
            archive = stack.enter_context(zipfile.ZipFile(path))
            members = {name.removesuffix(".npy"): name for name in archive.namelist() if name.endswith(".npy")}
        shapes = {}
        for name, member in members.items():
            with foreign(f"{path}: {name}"), archive.open(member) as file:
                shapes[name] = _header(file)[0]
        name = choose(shapes, request.topic, path, request.axes)
        depth = _Member(archive, members[name], request, f"{path}: {name}", stack)
        amplitude = None
        if request.amplitude is not None:
            other = choose(shapes, request.amplitude, path, request.axes)
            amplitude = _Member(archive, members[other], request, f"{path}: {other}", stack)
            check_shapes(depth.sizes, amplitude.sizes, f"{path}: {other}")
        time_s = None
        if TIME in members:
            with foreign(f"{path}: {TIME}"), archive.open(members[TIME]) as file:
                time_s = npy_format.read_array(file, allow_pickle=False)
            check_time(time_s, depth.shape[0], path)
        yield FrameSource(
            kind=f"array {name} of an .npz",
            shape=depth.shape,
            targets=depth.targets,
            dtype=depth.dtype,
            frames=joined(depth, amplitude, time_s),
            has_amplitude=amplitude is not None,
            has_time=time_s is not None,
        )


class _Member:
    """One array of an archive, frame by frame; an iterator of (row, col) or (target, row, col)."""

    def __init__(self, archive: zipfile.ZipFile, member: str, request: Request, what: str, stack: ExitStack) -> None:
        with foreign(what):
            file = stack.enter_context(archive.open(member))
            shape, fortran, dtype = _header(file)
        check_numbers(dtype, what)
        if _in_order(shape, request, what) and not fortran:
            check_not_empty(shape, what)
            self.shape: tuple[int, int, int] = shape[0], shape[1], shape[2]
            self.targets = 0
            self._frames: Iterator[NDArray[Any]] = _unpacked(file, self.shape, dtype, what)
        else:
            with foreign(what), archive.open(member) as again:
                whole = npy_format.read_array(again, allow_pickle=False)
            frames = stack_of(whole, request, what)
            self.shape, self.targets = sizes_of(frames)
            self._frames = iter(frames)
        self.dtype = dtype

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of all axes."""
        return (*self.shape, *(self.targets,) * (self.targets > 0))

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return self._frames


def _unpacked(
    file: IO[bytes], shape: tuple[int, int, int], dtype: np.dtype[Any], what: object
) -> Iterator[NDArray[Any]]:
    size = math.prod(shape[1:]) * dtype.itemsize
    for number in range(shape[0]):
        with foreign(what):
            data = file.read(size)
        if len(data) < size:
            raise BadInputError(f"{what}: ends in frame {number} of {shape[0]}")
        yield np.frombuffer(data, dtype=dtype).reshape(shape[1:])


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = npy_format.read_magic(file)
    read = npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    return shape, fortran, dtype


def choose(shapes: dict[str, tuple[int, ...]], wanted: str | None, path: Path, axes: str | None = None) -> str:
    """Name of the array to read: the wanted one, else the only one of frames, else ``range``.

    Frames are arrays with as many axes as `axes` names, three without it.

    Raises
    ------
    BadInputError
        If none fits, or several fit; the text lists the candidates.
    """
    dimensions = len((axes or FRAMES_FIRST).split(","))
    images = [name for name, shape in shapes.items() if len(shape) == dimensions]
    images = images or [name for name, shape in shapes.items() if len(shape) == IMAGE_DIMENSIONS and min(shape) > 1]
    # A single array of four axes is accepted too; the next step asks the user for its axes.
    images = images or [name for name, shape in shapes.items() if len(shape) == _WITH_TARGETS]
    listed = ", ".join(f"{name} {shape}" for name, shape in sorted(shapes.items())) or "none"
    if wanted is not None:
        if wanted not in shapes:
            raise BadInputError(f"{path}: no array {wanted!r}; it holds: {listed}")
        return wanted
    if _PREFERRED in images:
        return _PREFERRED
    if len(images) != 1:
        raise BadInputError(f"{path}: several arrays may hold the depths; choose one with --dataset: {listed}")
    return images[0]


def _in_order(shape: tuple[int, ...], request: Request, what: object) -> bool:
    """Whether an array is (frame, row, col) as it is."""
    names = axes_of(shape, request.axes, request.shape, what) if len(shape) == STACK_DIMENSIONS else ()
    return ",".join(names) == FRAMES_FIRST


def stack_of(array: NDArray[Any], request: Request, what: object) -> NDArray[Any]:
    """View an array as (frame, row, col) or (frame, target, row, col); a single image is one frame.

    Raises
    ------
    BadInputError
        If it is of another shape, empty, or holds no numbers.
    """
    check_numbers(array.dtype, what)
    return as_stack(array, axes_of(array.shape, request.axes, request.shape, what), request.shape, what)


def sizes_of(stack: NDArray[Any]) -> tuple[tuple[int, int, int], int]:
    """(frames, rows, columns) of a stack, and its targets."""
    targets = stack.shape[1] if stack.ndim > STACK_DIMENSIONS else 0
    return (stack.shape[0], stack.shape[-2], stack.shape[-1]), targets


def check_not_empty(shape: tuple[int, ...], what: object) -> None:
    """Refuse an array without samples, or that is not a sequence of images."""
    if len(shape) != STACK_DIMENSIONS or 0 in shape:
        raise BadInputError(f"{what}: expected (frame, row, col), got shape {shape}")


def check_shapes(depth: tuple[int, ...], amplitude: tuple[int, ...], what: object) -> None:
    """Refuse amplitudes of another shape."""
    if depth != amplitude:
        raise BadInputError(f"{what}: shape {amplitude} differs from the depths' {depth}")


def check_time(time_s: NDArray[Any], frames: int, path: Path) -> None:
    """Refuse a time that is not one number a frame."""
    if time_s.size != frames or time_s.dtype.kind not in "iuf":
        raise BadInputError(f"{path}: {TIME}: expected {frames} numbers, got {time_s.dtype} of shape {time_s.shape}")


def joined(
    depth: Iterable[NDArray[Any]],
    amplitude: Iterable[NDArray[Any]] | None,
    time_s: NDArray[Any] | None,
) -> Iterator[Frame]:
    """Frames of arrays that have been checked to go together."""
    amplitudes = None if amplitude is None else iter(amplitude)
    for number, frame in enumerate(depth):
        yield Frame(
            depth=frame,
            amplitude=None if amplitudes is None else next(amplitudes),
            time_s=None if time_s is None else float(time_s.reshape(-1)[number]),
        )
