"""The least rectangle about the outline of a plane, as the fine image of surfaces shows it.

Use it where a scene is to be described by flat rectangles. What another surface hides is not in an outline: a wall
behind a board has a rectangle over the board, too. A rectangle covers what its outline leaves out, such as a door.

Layers far from a surface may be linked to it, as they lie in its plane. A region of the image belongs to the outline if
the rectangle about it and the larger regions then describes more of the image.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from tofmix.arrays import BoolArray, FloatArray
from tofmix.optics.projection import Projection, beam_directions_of, unit
from tofmix.surfaces.found import WindowSurfaces, plane_ranges


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

    def contains(self, points_mm: FloatArray) -> BoolArray:
        """Whether points (n, 3) of its plane, mm, lie in it; not if they are NaN."""
        away = np.abs((points_mm - self.center_mm) @ self.axes[:, :2])
        touch_mm = 1e-6  # points on a side lie in the rectangle, whatever the rounding
        return np.asarray((away <= self.size_mm / 2.0 + touch_mm).all(axis=-1))


def outline_rectangle(found: WindowSurfaces, surface: int, optics: Projection, *, reach_mm: float) -> Rectangle | None:
    """The least rectangle about the outline of a plane.

    Parameters
    ----------
    found : WindowSurfaces
        The surfaces of a window.
    surface : int
        Number of a plane among them.
    optics : Projection
        Where the pixels look.
    reach_mm : float
        The longest range of the camera. A plane that is seen at grazing incidence ends there.

    Returns
    -------
    Rectangle or None
        None if no part of a pixel shows the surface within the reach.
    """
    (rows, cols, _), factor = found.surface.shape, found.factor
    normal = unit(found.planes.normal[surface].astype(np.float64))
    offset_mm = float(found.planes.offset_mm[surface])
    best, points, gain = None, np.zeros((0, 3)), 0.0
    image = _Image.of(found, surface, beam_directions_of(optics, (rows, cols)))
    for row, col in _regions(found.surface_fine == surface):
        directions = unit(optics.rays(row / factor - 0.5, col / factor - 0.5, shape=(rows, cols)))
        more = _on_plane(directions, normal, offset_mm, reach_mm)
        if best is not None and best.contains(more).all():
            continue
        both = np.concatenate([points, more])
        wider = least_rectangle(both, normal)
        if wider is not None and (best is None or image.gain(wider) > gain):
            best, points, gain = wider, both, image.gain(wider)
    return best


class _Image(NamedTuple):
    """What a rectangle of a plane would describe of each pixel, and cover.

    Parameters
    ----------
    place_mm : (pixel, 3) float64
        Where beams meet the plane; NaN where they do not.
    share : (pixel,) float64
        Share of the surface in the pixel, less that of what lies behind its plane.
    """

    place_mm: FloatArray
    share: FloatArray

    @classmethod
    def of(cls, found: WindowSurfaces, surface: int, directions: FloatArray) -> "_Image":
        """The image of a plane."""
        rows, cols, factor = *found.surface.shape[:2], found.factor
        ranges = plane_ranges(found.planes, np.full((rows, cols), surface), directions)
        own = found.surface_fine == surface
        far = ~own & ~(found.range_fine < np.repeat(np.repeat(ranges, factor, axis=0), factor, axis=1))
        share = (own.astype(np.int8) - far).reshape(rows, factor, cols, factor).mean(axis=(1, 3))
        return cls((directions * ranges[..., np.newaxis]).reshape(-1, 3), share.ravel())

    def gain(self, rectangle: Rectangle) -> float:
        """Pixels of the surface in a rectangle, less those of what it would cover."""
        return float(self.share[rectangle.contains(self.place_mm)].sum())


def _regions(inside: BoolArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Corners (row, col) of parts on the border of each connected region, in parts; the largest first."""
    label, _ = ndimage.label(inside)
    size = np.bincount(label.ravel())[1:]
    boxes = ndimage.find_objects(label)
    for number in np.argsort(-size, kind="stable"):
        box = boxes[number]
        row, col = _border(label[box] == number + 1)
        yield row + box[0].start, col + box[1].start


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
    enough = 3  # points of a polygon, at least
    if len(points) < enough:
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
