"""A field of view as the directions of an image's pixels, and depths along z as ranges."""

import math

from tofmix.arrays import FloatArray
from tofmix.optics.geometry import ray_over_depth
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import Projection, beam_directions_of

EQUIANGULAR, PINHOLE = "equiangular", "pinhole"
"""Projections that a field of view may be of: equal angles between pixels, or an ideal pinhole."""

_FLAT_DEG = 180.0
"""A pinhole sees less than this angle, degrees: a half-space."""


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
    if max(view_deg) >= _FLAT_DEG:
        raise ValueError(f"{view_deg[0]:g} x {view_deg[1]:g} degrees; a pinhole sees less than {_FLAT_DEG:g}")
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
