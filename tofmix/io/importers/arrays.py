"""NumPy's .npy and .npz, never unpickled.

Both are read frame by frame. Where frames are not the first axis in memory, an
.npy is mapped and an array of an .npz is read whole.
"""

import math
import re
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Container as Names
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io.importers.base import (
    FRAMES_FIRST,
    IMAGE_DIMENSIONS,
    STACK_DIMENSIONS,
    Frame,
    FrameSource,
    SourceRequest,
    as_stack,
    axes_of,
    check_numbers,
    foreign,
    unused,
)
from tofmix.io.importers.conversion import codes_of, depths_among, is_status_name
from tofmix.io.importers.times import times_of_array
from tofmix.io.recording.range_check import unit_in_name

TIME = "time"
"""Name of an array of one time a frame."""

_WITH_TARGETS = STACK_DIMENSIONS + 1  # frames, rows, columns and targets
_PREFERRED = "range"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frames:
    """An array as frames, (row, col) or (target, row, col), in order; `shape` is (frames, rows, columns)."""

    images: Iterable[NDArray[Any]]
    shape: tuple[int, int, int]
    targets: int
    dtype: np.dtype[Any]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of all axes."""
        return (*self.shape, *(self.targets,) * (self.targets > 0))


class Container(ABC):
    """A file of named arrays.

    Parameters
    ----------
    kind : str
        The file in words.
    shapes : dict
        Shape of each array by its name.
    bytewise : container of str
        Arrays whose values have 8 bits.
    """

    def __init__(self, kind: str, shapes: dict[str, tuple[int, ...]], bytewise: Names[str]) -> None:
        self.kind, self.shapes, self.bytewise = kind, shapes, bytewise

    def load(self, names: list[str]) -> None:  # noqa: B027  most have nothing to do
        """Make these arrays ready for reading."""

    def with_axes(self, name: str, request: SourceRequest) -> SourceRequest:  # noqa: ARG002  MATLAB's differ
        """The request with the axes of the depths."""
        return request

    @abstractmethod
    def frames(self, name: str, request: SourceRequest) -> Frames:
        """An array as frames."""

    @abstractmethod
    def values(self, name: str) -> NDArray[Any]:
        """A whole array."""


def source_of(arrays: Container, request: SourceRequest, path: Path) -> FrameSource:
    """The depths of a file of arrays, with its amplitudes, status codes and times."""
    shapes = arrays.shapes
    name = choose(shapes, request.topic, path, request.axes, arrays.bytewise)
    other = None if request.amplitude is None else choose(shapes, request.amplitude, path, request.axes)
    beside = arrays_beside(shapes, name, request, path)
    request = arrays.with_axes(name, request)
    arrays.load([one for one in (name, other, beside.status, TIME if TIME in shapes else None) if one is not None])
    depth = arrays.frames(name, request)
    amplitude = None if other is None else arrays.frames(other, request)
    if amplitude is not None and amplitude.sizes != depth.sizes:
        raise BadInputError(f"{path}: {other}: shape {amplitude.sizes} differs from the depths' {depth.sizes}")
    status = None if beside.status is None else arrays.frames(beside.status, request)
    time_s: NDArray[Any] | None = None
    said: tuple[str, ...] = ()
    if TIME in shapes:
        time_s, said = times_of_array(arrays.values(TIME), depth.shape[0], f"{path}: {TIME}", request.time_unit_s)
    return FrameSource(
        kind=f"array {name} of {arrays.kind}",
        shape=depth.shape,
        targets=depth.targets,
        dtype=depth.dtype,
        unit_mm=unit_in_name(name),
        frames=joined(
            depth.images,
            None if amplitude is None else amplitude.images,
            time_s,
            None if status is None else status.images,
        ),
        status_valid=beside.codes,
        has_amplitude=amplitude is not None,
        has_time=time_s is not None,
        stream=name,
        notes=(*beside.notes, *said),
    )


@contextmanager
def open_npy(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open an .npy, (frame, row, col) or (row, col), or of the requested axes."""
    with ExitStack() as stack:
        with foreign(path):
            file = stack.enter_context(path.open("rb"))
        depth = _read_frames(file, lambda: np.load(path, mmap_mode="r", allow_pickle=False), request, path)
        yield FrameSource(
            kind="NumPy array",
            shape=depth.shape,
            targets=depth.targets,
            dtype=depth.dtype,
            frames=joined(depth.images, None, None),
            stream="",
        )


@contextmanager
def open_npz(path: Path, request: SourceRequest) -> Iterator[FrameSource]:
    """Open an .npz with the depths, and optionally amplitudes and `time`."""
    with ExitStack() as stack:
        with foreign(path):
            archive = stack.enter_context(zipfile.ZipFile(path))
        yield source_of(_Archive(archive, path, stack), request, path)


class _Archive(Container):
    """An .npz."""

    def __init__(self, archive: zipfile.ZipFile, path: Path, stack: ExitStack) -> None:
        self._archive, self._path, self._stack = archive, path, stack
        members = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
        headers = {}
        for name in members:
            with foreign(f"{path}: {name}"), archive.open(f"{name}.npy") as file:
                headers[name] = _header(file)
        shapes = {name: shape for name, (shape, _, _) in headers.items()}
        super().__init__("an .npz", shapes, {name for name, (_, _, dtype) in headers.items() if dtype.itemsize == 1})

    def frames(self, name: str, request: SourceRequest) -> Frames:
        what = f"{self._path}: {name}"
        with foreign(what):
            file = self._stack.enter_context(self._archive.open(f"{name}.npy"))
        return _read_frames(file, lambda: self.values(name), request, what)

    def values(self, name: str) -> NDArray[Any]:
        with foreign(f"{self._path}: {name}"), self._archive.open(f"{name}.npy") as file:
            return npy_format.read_array(file, allow_pickle=False)


def _read_frames(file: IO[bytes], whole: Callable[[], NDArray[Any]], request: SourceRequest, what: object) -> Frames:
    """Frames of an .npy, one by one from the file where they lie in order there, else of the whole array."""
    with foreign(what):
        shape, fortran, dtype = _header(file)
    check_numbers(dtype, what)
    if _in_order(shape, request, what) and not fortran:
        check_not_empty(shape, what)
        found = shape[0], shape[1], shape[2]
        return Frames(images=_unpacked(file, found, dtype, what), shape=found, targets=0, dtype=dtype)
    with foreign(what):
        array = whole()
    return frames_of(array, request, what)


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


def choose(
    shapes: dict[str, tuple[int, ...]],
    wanted: str | None,
    path: Path,
    axes: str | None = None,
    bytewise: Names[str] = (),
) -> str:
    """Name of the array to read: the wanted one, else the only one of frames, else ``range``.

    Frames are arrays with as many axes as `axes` names, three without it; `bytewise` are those of 8 bits.
    """
    dimensions = len((axes or FRAMES_FIRST).split(","))
    images = [name for name, shape in shapes.items() if len(shape) == dimensions]
    images = images or [name for name, shape in shapes.items() if len(shape) == IMAGE_DIMENSIONS and min(shape) > 1]
    # A single array of four axes is accepted too; the next step asks the user for its axes.
    images = images or [name for name, shape in shapes.items() if len(shape) == _WITH_TARGETS]
    listed = ", ".join(f"{name} {shape}" for name, shape in sorted(shapes.items())) or "none"
    if not images and wanted is None:
        raise BadInputError(f"{path}: no array of frames (frame, row, col); it holds: {listed}")
    if wanted is not None:
        if wanted not in shapes:
            raise BadInputError(f"{path}: no array {wanted!r}; it holds: {listed}")
        return wanted
    if _PREFERRED in images:
        return _PREFERRED
    if len(images) > 1:
        images = depths_among(images, bytewise)
    if len(images) != 1:
        raise BadInputError(f"{path}: several arrays may hold the depths; choose one with --dataset: {listed}")
    return images[0]


class SideArrays(NamedTuple):
    """Arrays beside the depths: that of the status codes, if there is one, the valid codes, and notes on the others."""

    status: str | None
    codes: tuple[int, ...]
    notes: tuple[str, ...]


def arrays_beside(
    shapes: dict[str, tuple[int, ...]], name: str, request: SourceRequest, path: Path, used: Names[str] = ()
) -> SideArrays:
    """Find the status codes of the depths `name`, and name the arrays that are not used.

    These are arrays of the same shape, and times and status codes beside the depths; `used` are others that are used.
    """
    group = name.rpartition("/")[0]
    others = [one for one in shapes if one != name and one != (request.amplitude or "").strip("/")]
    near = [one for one in others if request.valid_status is not None or one.rpartition("/")[0] == group]
    if request.valid_status is None:
        near = [one for one in near if shapes[one] == shapes[name]]
    status = next((one for one in near if codes_of(one, request)), None)
    if status is not None:
        check_shapes(shapes[name], shapes[status], f"{path}: {status}")
    elif request.valid_status is not None:
        raise BadInputError(f"{path}: --valid-status: no array {request.valid_status[0]!r} beside {name}")
    time = f"{group}/{TIME}" if group else TIME
    left = [
        one
        for one in others
        if one not in (status, time)
        and one not in used
        and (
            shapes[one] == shapes[name]
            or (one.rpartition("/")[0] == group and (is_status_name(one) or is_time_name(one)))
        )
    ]
    codes = [one for one in left if is_status_name(one) and shapes[one] == shapes[name]]
    times = [one for one in left if is_time_name(one) and shapes[one] != shapes[name]]
    lights = [one for one in left if one.rpartition("/")[2] == "amplitude" and shapes[one] == shapes[name]]
    notes = []
    if codes:
        notes.append(unused(path, "array", codes, f"--valid-status {codes[0]}=5,9 says which codes are valid"))
    if lights:
        notes.append(unused(path, "array", lights, f"--amplitude {lights[0]} uses it"))
    if times:
        notes.append(unused(path, "array", times, f"times are read from an array {TIME}"))
    if plain := [one for one in left if one not in (*codes, *lights, *times)]:
        notes.append(unused(path, "array", plain))
    return SideArrays(status, () if status is None else codes_of(status, request) or (), tuple(notes))


def is_time_name(name: str) -> bool:
    """Whether an array holds times by its name, such as ``timestamps`` or ``t_ms``."""
    last = name.rpartition("/")[2].lower()
    return (
        re.fullmatch(r"(?:.*_)?(?:times?|(?:time[_ ]?)?stamps?)(?:_(?:s|ms|us|ns))?|t(?:_(?:s|ms|us|ns))?", last)
        is not None
    )


def kind_of_names(name: str) -> str:
    """A name with its numbers as ``#``: those of one sequence are of one kind."""
    return re.sub(r"\d+", "#", name)


def numbered_images(shapes: dict[str, tuple[int, ...]], wanted: str | None = None) -> list[str] | None:
    """Names of images of one shape that differ in numbers alone, such as ``frame_0/depth``, in their order.

    `wanted` is the requested kind, such as ``frame_#/depth``. None where there are no such images, there are several
    kinds of them of which none is of depths, or something else holds frames.
    """
    if any(len(shape) >= STACK_DIMENSIONS for shape in shapes.values()):
        return None
    kinds: dict[str, list[str]] = {}
    for name, shape in shapes.items():
        if len(shape) == IMAGE_DIMENSIONS and min(shape) > 1:
            kinds.setdefault(kind_of_names(name), []).append(name)
    several = {kind: names for kind, names in kinds.items() if len(names) > 1 and "#" in kind}
    if wanted is not None:
        chosen = [wanted] if wanted in several else []
    else:
        chosen = list(several) if len(several) == 1 else depths_among(several)
    if len(chosen) != 1 or len({shapes[name] for name in several[chosen[0]]}) > 1:
        return None
    return sorted(several[chosen[0]], key=natural)


def natural(name: str) -> list[tuple[int, int, str]]:
    """Sort key in which 2 comes before 10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def _in_order(shape: tuple[int, ...], request: SourceRequest, what: object) -> bool:
    """Whether an array is (frame, row, col) as it is."""
    names = axes_of(shape, request.axes, request.shape, what) if len(shape) == STACK_DIMENSIONS else ()
    return ",".join(names) == FRAMES_FIRST


def frames_of(array: NDArray[Any], request: SourceRequest, what: object) -> Frames:
    """Frames of an array in memory; a single image is one frame."""
    check_numbers(array.dtype, what)
    stack = as_stack(array, axes_of(array.shape, request.axes, request.shape, what), request.shape, what)
    targets = stack.shape[1] if stack.ndim > STACK_DIMENSIONS else 0
    return Frames(
        images=stack, shape=(stack.shape[0], stack.shape[-2], stack.shape[-1]), targets=targets, dtype=stack.dtype
    )


def check_not_empty(shape: tuple[int, ...], what: object) -> None:
    """Refuse an array without samples, or that is not a sequence of images."""
    if len(shape) != STACK_DIMENSIONS or 0 in shape:
        raise BadInputError(f"{what}: expected (frame, row, col), got shape {shape}")


def check_shapes(depth: tuple[int, ...], amplitude: tuple[int, ...], what: object) -> None:
    """Refuse amplitudes of another shape."""
    if depth != amplitude:
        raise BadInputError(f"{what}: shape {amplitude} differs from the depths' {depth}")


def joined(
    depth: Iterable[NDArray[Any]],
    amplitude: Iterable[NDArray[Any]] | None,
    time_s: NDArray[Any] | None,
    status: Iterable[NDArray[Any]] | None = None,
) -> Iterator[Frame]:
    """Frames of arrays that have been checked to go together."""
    amplitudes = None if amplitude is None else iter(amplitude)
    codes = None if status is None else iter(status)
    for number, frame in enumerate(depth):
        yield Frame(
            depth=frame,
            amplitude=None if amplitudes is None else next(amplitudes),
            time_s=None if time_s is None else float(time_s.reshape(-1)[number]),
            status=None if codes is None else next(codes),
        )
