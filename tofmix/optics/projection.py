"""Which way the pixels of an image look: the projections that a camera may have, by name.

A projection is a frozen dataclass whose fields are its keys in recordings and models.
To add one, write its file and its line in `PROJECTIONS`: files, simulation, export
and maps follow. Use `beam_directions_of` for the centres of pixels, `cell_nodes`
for the cells that the beams of pixels are.

A field of view as the directions of an image's pixels, and depths along z as ranges.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.pinhole import Pinhole


class Projection(Protocol):
    """Direction of each place of an image (rows, cols), in the sensor's frame: x right, y down, z forward.

    Places are (row, col) in pixels, the centre of the first pixel at (0, 0); they may lie between pixels.
    """

    name: ClassVar[str]

    def rays(self, row: ArrayLike, col: ArrayLike, *, shape: tuple[int, int]) -> FloatArray:
        """Vectors (..., 3) along the beams, of any length, smooth in row and col.

        Raises ValueError, a message that begins with a key, where no beam passes.
        """

    def pixels(self, directions: FloatArray, *, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """Place (row, col) that looks along each direction (..., 3), also outside the image; NaN where none does."""

    def check(self, shape: tuple[int, int]) -> None:
        """Raise ValueError, a message that begins with a key, if a part of the image looks nowhere."""

    def words(self, shape: tuple[int, int]) -> str:
        """Field of view in words, such as ``47 x 39 degrees``."""


PROJECTIONS: dict[str, type[Equiangular] | type[Pinhole]] = {
    Equiangular.name: Equiangular,
    Pinhole.name: Pinhole,
}
"""Projections by their name in files."""

DEFAULT_PROJECTION = Equiangular.name
"""Projection of a file that names none."""


def number_keys(name: str) -> tuple[str, ...]:
    """Keys of a projection that hold one number; all are required."""
    return tuple(field.name for field in fields(PROJECTIONS[name]) if field.default is MISSING)


def list_keys(name: str) -> tuple[str, ...]:
    """Keys of a projection that hold a list of numbers; none is required."""
    return tuple(field.name for field in fields(PROJECTIONS[name]) if field.default is not MISSING)


def make_projection(name: str, values: Mapping[str, float | Sequence[float]]) -> Projection:
    """Make a projection of its keys.

    Parameters
    ----------
    name : str
        A key of `PROJECTIONS`.
    values : mapping
        Its keys; others are passed over.

    Raises
    ------
    ValueError
        If the name is not known, a key is missing, or a number is out of its bounds.
    """
    if name not in PROJECTIONS:
        raise ValueError(f"projection: {name!r} is not known; known: {', '.join(PROJECTIONS)}")
    missing = [key for key in number_keys(name) if key not in values]
    if missing:
        raise ValueError(f"projection: {name} needs {', '.join(missing)}")
    settings: dict[str, Any] = {key: values[key] for key in number_keys(name)}
    settings |= {key: tuple(np.ravel(values[key]).tolist()) for key in list_keys(name) if key in values}
    return PROJECTIONS[name](**settings)


def projection_values(projection: Projection) -> dict[str, float | tuple[float, ...]]:
    """Keys of a projection and their values; lists that are empty are left out."""
    values = {key: getattr(projection, key) for key in number_keys(projection.name)}
    lists = {key: getattr(projection, key) for key in list_keys(projection.name)}
    return values | {key: value for key, value in lists.items() if value}


def beam_directions_of(projection: Projection, shape: tuple[int, int]) -> FloatArray:
    """Unit vectors (row, col, 3) along the beams of the pixels' centres.

    Raises
    ------
    ValueError
        If a pixel looks nowhere. The message begins with a key.
    """
    rows, cols = shape
    rays = projection.rays(*np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), shape=shape)
    # Rays of unit length stay as they are, to the last bit.
    return rays if isinstance(projection, Equiangular) else unit(rays)


def unit(rays: FloatArray) -> FloatArray:
    """Vectors (..., 3) at unit length."""
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def cell_nodes(projection: Projection, row: int, shape: tuple[int, int]) -> FloatArray:
    """Rays at the corners, the middles of the sides and the centres of one row's pixels.

    Parameters
    ----------
    projection : Projection
        The projection.
    row : int
        The image row.
    shape : (int, int)
        Rows and columns of the image.

    Returns
    -------
    (3, 2 cols + 1, 3) float64
        At rows row - 1/2, row, row + 1/2 and columns -1/2, 0, 1/2, ... cols - 1/2: pixel col has the nodes
        ``[:, 2 col : 2 col + 3]``.
    """
    down, across = row + np.array([-0.5, 0.0, 0.5]), np.arange(2 * shape[1] + 1) / 2 - 0.5
    return np.ascontiguousarray(projection.rays(down[:, np.newaxis], across, shape=shape))


def pixel_extent_rad(projection: Projection, shape: tuple[int, int]) -> FloatArray:
    """The larger of a pixel's angles, across and down through its centre, (row, col), rad."""
    if isinstance(projection, Equiangular):
        return np.full(shape, max(projection.pixel_size_rad(shape)))
    extent = np.empty(shape)
    for row in range(shape[0]):
        nodes = unit(cell_nodes(projection, row, shape))
        wide = np.linalg.norm(nodes[1, 2::2] - nodes[1, :-2:2], axis=-1)
        high = np.linalg.norm(nodes[2, 1::2] - nodes[0, 1::2], axis=-1)
        extent[row] = 2.0 * np.arcsin(np.maximum(wide, high) / 2.0)
    return extent


EQUIANGULAR, PINHOLE = "equiangular", "pinhole"
"""Projections that a field of view may be of: equal angles between pixels, or an ideal pinhole."""


def projection_of_view(*, along_z: bool) -> str:
    """Projection of a field of view alone: depths along z are a pinhole's, ranges are of equal angles."""
    return PINHOLE if along_z else EQUIANGULAR


def ideal_pinhole(view_deg: tuple[float, float], shape: tuple[int, int]) -> Pinhole:
    """A pinhole without distortion whose image's outer edges, (rows, cols), are at the field of view.

    Raises
    ------
    ValueError
        If no pinhole sees that much.
    """
    flat_deg = 180.0  # a pinhole sees less than this angle, degrees: a half-space
    if max(view_deg) >= flat_deg:
        raise ValueError(f"{view_deg[0]:g} x {view_deg[1]:g} degrees; a pinhole sees less than {flat_deg:g}")
    rows, cols = shape
    fx, fy = (size / 2 / math.tan(math.radians(angle) / 2) for size, angle in zip((cols, rows), view_deg, strict=True))
    return Pinhole(fx=fx, fy=fy, cx=(cols - 1) / 2, cy=(rows - 1) / 2)


_MOST_RAD = {EQUIANGULAR: (2 * math.pi, math.pi), PINHOLE: (math.pi, math.pi)}
"""Widest field of view of each projection, rad."""


def view_doubt(
    view_deg: tuple[float, float], projection: str, shape: tuple[int, int], *, option: str = "--fov {:.4g}x{:.4g}"
) -> str:
    """Doubt about a field of view that may be in radians; empty without one.

    Both angles may be if no camera of the projection could see more radians. One of them may be if its pixels are
    nearer to squares then.

    Parameters
    ----------
    view_deg : (float, float)
        Full field of view, horizontal and vertical, as given, degrees.
    projection : {"equiangular", "pinhole"}
        What it is of.
    shape : (int, int)
        Rows and columns of the image.
    option : str
        The remedy, with places for both angles.
    """
    possible = [angle < most for angle, most in zip(view_deg, _MOST_RAD[projection], strict=True)]
    horizontal, vertical = (
        math.degrees(angle) if maybe else angle for angle, maybe in zip(view_deg, possible, strict=True)
    )
    if not any(possible):
        return ""
    if not all(possible) and _elongation((horizontal, vertical), shape) >= _elongation(view_deg, shape):
        return ""
    which = "" if all(possible) else f" if {view_deg[possible.index(True)]:g} is"
    remedy = option.format(horizontal, vertical)
    return f"{view_deg[0]:g} x {view_deg[1]:g} degrees is narrow;{which} in radians: {remedy}"


def _elongation(view_deg: tuple[float, float], shape: tuple[int, int]) -> float:
    """Natural logarithm of the longer side of a pixel over the shorter one, as angles."""
    return abs(math.log(view_deg[0] / shape[1] * shape[0] / view_deg[1]))


def centre_doubt(optics: Projection | None, shape: tuple[int, int], *, outside: float = 0.5) -> str:
    """Doubt about a pinhole whose centre is farther outside of an image than a share of it; empty without one.

    Parameters
    ----------
    optics : Projection, optional
        The lens; only a pinhole has a centre.
    shape : (int, int)
        Rows and columns of the image.
    outside : float
        The share.
    """
    if not isinstance(optics, Pinhole):
        return ""
    places = zip((optics.cx, optics.cy), (shape[1], shape[0]), strict=True)
    if all(-outside * size <= centre <= (1 + outside) * size for centre, size in places):
        return ""
    return (
        f"the centre, column {optics.cx:g}, row {optics.cy:g}, is far outside of the image of"
        f" {shape[0]} x {shape[1]} pixels; are the intrinsics those of another image size?"
    )


def ray_factor(optics: Projection, shape: tuple[int, int]) -> FloatArray:
    """Range along the beam over depth along z (row, col) of an image's pixels.

    Raises
    ------
    ValueError
        If a pixel looks nowhere, or 90 degrees or more off the axis.
    """
    return ray_over_depth(beam_directions_of(optics, shape))


def ray_over_depth(directions: FloatArray) -> FloatArray:
    """Range over depth along z of each beam, at least 1.

    Parameters
    ----------
    directions : (row, col, 3) float64
        Unit vectors.

    Returns
    -------
    (row, col) float64
        1 / z.

    Raises
    ------
    ValueError
        If a beam is 90 degrees or more off the axis and has no depth.
    """
    forward = directions[..., 2]
    if not (forward > np.finfo(np.float32).eps).all():
        raise ValueError("a pixel looks 90 degrees or more off the axis and has no depth along z")
    return np.asarray(1.0 / forward)


def largest_angle_deg(one: FloatArray, other: FloatArray) -> float:
    """Largest angle between two images of unit vectors (row, col, 3), degrees."""
    across = np.linalg.norm(np.cross(one, other), axis=-1)
    return float(np.rad2deg(np.arctan2(across, (one * other).sum(axis=-1))).max())
