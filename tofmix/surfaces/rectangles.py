"""The least rectangle about the outline of a plane, as the fine image of surfaces shows it.

Use it where a scene is to be described by flat rectangles. What another surface hides is not in an outline: a wall
behind a board has a rectangle over the board, too. A rectangle covers what its outline leaves out, such as a door.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from tofmix.arrays import FloatArray
from tofmix.optics.projection import Projection, unit

_ENOUGH = 3
"""Points of a polygon, at least."""


class Rectangle(NamedTuple):
    """A rectangle in the sensor's frame.

    Parameters
    ----------
    center_mm : (3,) float64
        Its centre.
    size_mm : (2,) float64
        Lengths of its sides, above 0.
    axes : (3, 3) float64
        A rotation; its columns are the directions of both sides and the plane's normal.
    """

    center_mm: FloatArray
    size_mm: FloatArray
    axes: FloatArray


def outline_rectangle(
    surface_fine: NDArray[np.integer],
    surface: int,
    normal: FloatArray,
    offset_mm: float,
    optics: Projection,
    *,
    factor: int,
    reach_mm: float,
) -> Rectangle | None:
    """The least rectangle about the outline of a plane.

    Parameters
    ----------
    surface_fine : (row_fine, col_fine) int32
        Number of the surface of each part of a pixel.
    surface : int
        The number of this one.
    normal, offset_mm : (3,) float64, float
        Its plane n . x = offset, n a unit vector, the offset above 0, mm.
    optics : Projection
        Where the pixels look.
    factor : int
        Parts along each side of a pixel.
    reach_mm : float
        The longest range of the camera. A plane that is seen at grazing incidence ends there.

    Returns
    -------
    Rectangle or None
        None if no part of a pixel shows the surface within the reach.
    """
    row, col = _border(surface_fine == surface)
    shape = surface_fine.shape[0] // factor, surface_fine.shape[1] // factor
    directions = unit(optics.rays(row / factor - 0.5, col / factor - 0.5, shape=shape))
    return least_rectangle(_on_plane(directions, normal, offset_mm, reach_mm), normal)


def _border(inside: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Corners (row, col) of parts, counted in parts, at which a region and the rest meet."""
    padded = np.pad(inside, 1).astype(np.int8)
    around = padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]
    row, col = np.nonzero((around > 0) & (around < 4))  # noqa: PLR2004  parts about a corner
    return row.astype(np.float64), col.astype(np.float64)


def _on_plane(directions: FloatArray, normal: FloatArray, offset_mm: float, reach_mm: float) -> FloatArray:
    """Points (n, 3) at which beams meet a plane, or the places in their direction where the reach ends."""
    along = directions @ normal
    aside = directions - along[:, np.newaxis] * normal
    length = np.linalg.norm(aside, axis=1)
    farthest = np.sqrt(max(reach_mm**2 - offset_mm**2, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(along > 0.0, offset_mm * length / along, np.inf)
        aside = np.where(length[:, np.newaxis] > 0.0, aside / length[:, np.newaxis], 0.0)
    return np.asarray(offset_mm * normal + np.minimum(distance, farthest)[:, np.newaxis] * aside)


def least_rectangle(points: FloatArray, normal: FloatArray) -> Rectangle | None:
    """The rectangle of the least area about points of a plane.

    One side of it lies along a side of the points' convex hull.

    Parameters
    ----------
    points : (n, 3) float64
        Points of one plane, mm.
    normal : (3,) float64
        The plane's normal, a unit vector.

    Returns
    -------
    Rectangle or None
        None if the points lie on a line.

    References
    ----------
    H. Freeman, R. Shapira, "Determining the minimum-area encasing rectangle for an arbitrary closed curve",
    Communications of the ACM 18 (1975) 409, doi:10.1145/360881.360919.
    """
    if len(points) < _ENOUGH:
        return None
    first = unit(np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal))
    basis = np.stack([first, np.cross(normal, first)], axis=1)
    middle = points.mean(axis=0)
    flat = (points - middle) @ basis
    try:
        hull = flat[ConvexHull(flat).vertices]
    except QhullError:
        return None
    sides = unit(np.roll(hull, -1, axis=0) - hull)
    turned = np.stack([hull @ sides.T, hull @ np.stack([-sides[:, 1], sides[:, 0]])], axis=-1)  # (corner, side, 2)
    low, high = turned.min(axis=0), turned.max(axis=0)
    best = int(np.argmin((high - low).prod(axis=1)))
    u = basis @ sides[best]
    axes = np.stack([u, np.cross(normal, u), normal], axis=1)
    return Rectangle(
        center_mm=middle + axes[:, :2] @ (low[best] + high[best]) / 2.0, size_mm=high[best] - low[best], axes=axes
    )
