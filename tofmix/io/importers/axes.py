"""Orders of axes: their names in an array of a file, and its conversion to a stack of images."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError, UsageError
from tofmix.recording import MOST_TARGETS

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
