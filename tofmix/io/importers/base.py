"""Interface of the importers: frames of a source, one after the other, and the orders of axes of an array.

Values are converted afterwards, in one place: `tofmix.io.importers.conversion`.
"""

import logging
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError, TofmixError, UsageError, os_error_text
from tofmix.optics.pinhole import Pinhole
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE, MOST_TARGETS
from tofmix.sensor import Sensor

BLOCK_BYTES = 64_000_000
"""Most bytes of a source that are held at once, where a frame is not larger."""

_MOST_SAMPLES_A_FRAME = 1 << 26
"""Four targets of the largest image: a frame is held whole."""

DepthAxis = Literal["z", "ray"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceRequest:
    """Options of an import."""

    topic: str | None = None
    """Topic, array, channel, sequence of images, or name of a file of one stream, with the depths, whatever its name
    says; without it, the only fitting one."""
    amplitude: str | None = None
    """Topic or array with the amplitudes; for sources with one array, the path of another source."""
    camera_info: str | None = None  # topic with the intrinsics; the depth topic's sibling without it
    axes: str | None = None  # order of the axes of an array, as `tofmix.io.importers.base.check_axes` has it
    shape: tuple[int, int] | None = None
    """Rows and columns of the image, if the source stores its pixels in one line or axis."""
    image: tuple[int, int] | None = None  # rows and columns of the sensor, which determine the order of axes
    unit_mm: float | None = None  # given unit of the depths, mm; it overrides that of the source
    lens_given: bool = False  # whether the directions of the pixels were given; they override those of the source
    columns: Mapping[str, str] = field(default_factory=dict)
    """Columns of a table by their names there, lower case, and their meanings here, such as ``{"y": "row"}``."""
    valid_status: tuple[str, tuple[int, ...]] | None = None
    """Name of a column, dataset or array of codes, and the codes of valid samples."""
    status_codes: tuple[int, ...] = ()  # codes of valid samples by the camera's data sheet; empty where it names none
    time_unit_s: float | None = None  # given unit of the times, s; it overrides that of the source
    keep_values: bool = False  # whether zeros of real numbers and fill values are kept as ranges
    as_amplitude: bool = False  # whether the frames are amplitudes, whose names need not say depth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One frame: depths in the source's own numbers, amplitude, time in s from any origin.

    Depths, amplitudes and status codes are (row, col), or (target, row, col) where a pixel returns several targets.
    `new_start` says that the source counts its frames anew here, so that its clock may start again too.
    """

    depth: NDArray[Any]
    amplitude: NDArray[Any] | None = None
    time_s: float | None = None
    status: NDArray[Any] | None = None
    new_start: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameSource:
    """An open source."""

    kind: str  # description in words
    shape: tuple[int, int, int]  # frames, rows, columns
    dtype: np.dtype[Any]  # type of the depths
    frames: Iterator[Frame]  # the frames in order; read once
    targets: int = 0  # length of the frames' axis of targets; 0 where they have none
    unit_mm: float | None = None  # mm of one unit, where the source says
    unit_unknown: str = ""
    """Reason why the unit must be given, as in "mono16 without a unit"; empty where it is known or may be guessed."""
    # scale_factor, add_offset: Packing: a depth in `unit_mm` is the stored number times the factor, plus the offset.
    scale_factor: float = 1.0
    add_offset: float = 0.0
    invalid: tuple[float, ...] = ()  # values that the source says are no samples
    valid_span: tuple[float, float] = (-math.inf, math.inf)
    """Least and largest valid value that the source states, in its own numbers."""
    status_valid: tuple[int, ...] = ()  # codes of valid samples, where frames carry `status`
    depth_axis: DepthAxis = "ray"  # what its depths are along, where its kind says
    # has_amplitude, has_time: Whether frames carry them.
    has_amplitude: bool = False
    has_time: bool = False
    pinhole: Pinhole | None = None  # directions of its pixels, if the source has them
    rectified: bool = False  # whether the source marks the lens distortion as removed
    lens_unknown: str = ""  # reason why the source has no lens where one may be expected; empty otherwise
    sensor: Sensor | None = None  # data of the camera in the source
    stream: str | None = None
    """Name of the array, channel or sequence of the depths, which may say that it holds none; empty where the name of
    the file is all there is, None where the depths have been told otherwise."""
    notes: tuple[str, ...] = ()  # notes for the user

    def check(self, what: object) -> "FrameSource":
        """Return the source itself; `BadInputError` if its images, or its number of frames, are too large."""
        if self.shape[0] > MOST_FRAMES:
            raise BadInputError(f"{what}: {self.shape[0]} frames; no more than {MOST_FRAMES}")
        check_size(self.shape[1:], what)
        if self.targets * self.shape[1] * self.shape[2] > _MOST_SAMPLES_A_FRAME:
            size = f"{self.targets} targets of {_size(self.shape[1:])} pixels"
            raise BadInputError(f"{what}: {size}; no more than {_MOST_SAMPLES_A_FRAME} samples a frame")
        return self


@contextmanager
def foreign(what: object) -> Iterator[None]:
    """Turn any error of a library on damaged input into one `BadInputError` that begins with `what`.

    Keep other code of tofmix out of the block: an error in it must not look like a bad file.
    """
    try:
        yield
    except TofmixError:
        raise
    except OSError as error:
        text = os_error_text(error, str(what)) if error.errno else f"{what}: {_one_line(error)}"
        raise BadInputError(text) from error
    except Exception as error:
        raise BadInputError(f"{what}: cannot be read: {_one_line(error)}") from error


@contextmanager
def complaints_are_errors(logger: str, what: object) -> Iterator[None]:
    """Raise `BadInputError` for a fault that a library only logs, such as a truncated page."""
    log, collector = logging.getLogger(logger), _LogCollector()
    propagate, log.propagate = log.propagate, False
    log.addHandler(collector)
    try:
        yield
    finally:
        log.removeHandler(collector)
        log.propagate = propagate
    if collector.messages:
        raise BadInputError(f"{what}: cannot be read: {collector.messages[0]}")


class _LogCollector(logging.Handler):
    """Collects warnings and worse."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(_one_line(record.getMessage()))


def _one_line(reason: object) -> str:
    return " ".join(str(reason).split()) or type(reason).__name__


def check_frame(depth: NDArray[Any], shape: tuple[int, int], dtype: np.dtype[Any], what: object) -> NDArray[Any]:
    """Refuse a frame that differs from the first one."""
    if depth.shape != shape:
        raise BadInputError(f"{what}: {_size(depth.shape)} pixels, the first frame has {_size(shape)}")
    if depth.dtype != dtype:
        raise BadInputError(f"{what}: type {depth.dtype}, the first frame has {dtype}")
    return depth


def check_size(shape: tuple[int, ...], what: object) -> None:
    """Refuse an image larger than any camera's, before it is read."""
    if max(shape) > MOST_PIXELS_A_SIDE:
        raise BadInputError(f"{what}: {_size(shape)} pixels; no more than {MOST_PIXELS_A_SIDE} a side")


def check_numbers(dtype: np.dtype[Any], what: object) -> None:
    """Refuse a type that is no whole or real number."""
    if dtype.kind not in "iuf":
        raise BadInputError(f"{what}: expected whole or real numbers, got {dtype}")


def unused(what: object, kind: str, names: Iterable[str], remedy: str = "") -> str:
    """Note that names the parts of a source that are not used, such as its columns, and perhaps a remedy."""
    return f"{what}: not used: {kind} {', '.join(names)}{f' ({remedy})' if remedy else ''}"


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(length) for length in shape)


def with_amplitude(source: FrameSource, amplitude: FrameSource, what: Path) -> FrameSource:
    """Join the frames of a source that has depths and of one that has amplitudes."""
    sizes = [(*one.shape, *(one.targets,) * (one.targets > 0)) for one in (amplitude, source)]
    if sizes[0] != sizes[1]:
        raise BadInputError(f"{what}: amplitudes {_size(sizes[0])}, depths {_size(sizes[1])}")
    pairs = zip(source.frames, amplitude.frames, strict=True)
    return replace(source, frames=(replace(a, amplitude=b.depth) for a, b in pairs), has_amplitude=True)


FRAMES_FIRST = "frame,row,col"
FRAMES_LAST = "row,col,frame"
WITH_TARGETS = "frame,target,row,col"
IMAGE = ("row", "col")
IMAGE_DIMENSIONS, STACK_DIMENSIONS = len(IMAGE), len(FRAMES_FIRST.split(","))
_KNOWN = ("frame", "target", *IMAGE)
_WITH_ZONES = ({"frame", "zone"}, {"frame", "zone", "target"})
_SPELT = {
    name: axis
    for axis, names in {
        "frame": "time t frames index",
        "row": "y rows height v",
        "col": "x cols column columns width u",
        "target": "targets return returns echo",
        "zone": "pixel zones",
    }.items()
    for name in names.split()
}
"""Other names of axes, as files and people have them."""


def axis_name(name: str) -> str:
    """Our name of an axis."""
    return _SPELT.get(name.strip().lower(), name.strip().lower())


def check_axes(text: str) -> str:
    """The requested order of axes, without blanks."""
    names = [axis_name(name) for name in text.split(",")]
    fits = {"frame", *IMAGE} <= set(names) <= set(_KNOWN) or set(names) in _WITH_ZONES
    if len(set(names)) < len(names) or not fits:
        raise UsageError(
            f"--axes: {text!r} is not an order of frame, row and col, or of frame and zone, each with or without target"
        )
    return ",".join(names)


def axes_of(shape: tuple[int, ...], asked: str | None, image: tuple[int, int] | None, what: object) -> tuple[str, ...]:
    """Names of the axes of an array.

    Parameters
    ----------
    shape : tuple of int
        The array's.
    asked : str, optional
        Result of `check_axes`.
    image : (int, int), optional
        Rows and columns, where the zones of a frame lie in one axis; the axis is then ``zone``.
    what : object
        The array, for messages.
    """
    if len(shape) == IMAGE_DIMENSIONS:
        if image is not None and shape != image and asked is None:
            if shape[1] != image[0] * image[1]:
                raise BadInputError(f"{what}: frames of {shape[1]} values do not fill {image[0]} x {image[1]} pixels")
            return ("frame", "zone")
        return IMAGE
    if asked is not None:
        names = tuple(asked.split(","))
        if len(names) != len(shape):
            raise BadInputError(f"{what}: shape {shape} has {len(shape)} axes, --axes names {len(names)}")
        if "zone" in names:
            _check_zones(shape[names.index("zone")], image, what)
        return names
    if len(shape) == len(_KNOWN):
        raise BadInputError(f"{what}: shape {shape}: name the axes, such as --axes {WITH_TARGETS}")
    if len(shape) != STACK_DIMENSIONS:
        raise BadInputError(f"{what}: expected (frame, row, col), got shape {shape}")
    if image is not None and shape[1] == image[0] * image[1] and shape[1:] != image and shape[2] <= MOST_TARGETS:
        return ("frame", "zone", "target")
    return tuple(FRAMES_FIRST.split(","))


def _check_zones(zones: int, image: tuple[int, int] | None, what: object) -> None:
    if image is None:
        raise BadInputError(f"{what}: {zones} zones in one axis; give their image: --shape ROWSxCOLS")
    if zones != image[0] * image[1]:
        raise BadInputError(f"{what}: {zones} zones do not fill {image[0]} x {image[1]} pixels")


def stack_shape(
    shape: tuple[int, ...], names: tuple[str, ...], image: tuple[int, int] | None, what: object
) -> tuple[int, int, tuple[int, int]]:
    """Frames, targets (0 without such an axis) and (rows, columns) of an array with these axes."""
    by_name = dict(zip(names, shape, strict=True))
    if 0 in shape:
        raise BadInputError(f"{what}: expected (frame, row, col), got shape {shape}")
    if "zone" in by_name and image is not None:
        by_name["row"], by_name["col"] = image
    targets = by_name.get("target", 0)
    if targets > MOST_TARGETS:
        raise BadInputError(f"{what}: {targets} targets; no more than {MOST_TARGETS}")
    return by_name.get("frame", 1), targets, (by_name["row"], by_name["col"])


def as_stack(array: NDArray[Any], names: tuple[str, ...], image: tuple[int, int] | None, what: object) -> NDArray[Any]:
    """View an array as (frame, row, col), or as (frame, target, row, col) where it has targets."""
    frames, targets, pixels = stack_shape(array.shape, names, image, what)
    if "zone" in names:
        order = [names.index(name) for name in ("frame", "target", "zone") if name in names]
        return np.transpose(array, order).reshape(frames, *(targets,) * (targets > 0), *pixels)
    order = [names.index(name) for name in _KNOWN if name in names]
    ordered = np.transpose(array, order)
    return ordered if "frame" in names else ordered[np.newaxis]
