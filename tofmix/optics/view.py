"""A field of view as the directions of an image's pixels, and depths along z as ranges."""

import math

from tofmix.arrays import FloatArray
from tofmix.optics.geometry import ray_over_depth
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import Projection, beam_directions_of

EQUIANGULAR = "equiangular"
PINHOLE = "pinhole"
PROJECTIONS_OF_VIEW = (EQUIANGULAR, PINHOLE)
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


def ray_factor(optics: Projection, shape: tuple[int, int]) -> FloatArray:
    """Range along the beam over depth along z (row, col) of an image's pixels.

    Raises
    ------
    ValueError
        If a pixel looks nowhere, or 90 degrees or more off the axis.
    """
    return ray_over_depth(beam_directions_of(optics, shape))
