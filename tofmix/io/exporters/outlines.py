"""Outlines of surfaces as the fine image shows them, as polygons, by shapely.

The borders between surfaces are traced once for both sides: the polygons of neighbours have the same points along
their common border, before and after points are left out, and there is no gap between them in the image.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.io.exporters.placing import on_planes
from tofmix.io.extras import need
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.surfaces.found import NO_SURFACE


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """Polygons of one surface in the image; holes are the parts that other surfaces hide.

    Parameters
    ----------
    surface, window : int
        Number of the surface, and its window.
    polygons : list of shapely.Polygon
        In pixels (col, row), the centre of the first pixel at (0, 0).
    """

    surface: int
    window: int
    polygons: list[Any]


def outlines(file: SurfacesFile, windows: Sequence[int]) -> list[Outline]:
    """Outlines of the planes of some windows, those that are nowhere the nearest included; not of smooth surfaces."""
    found: list[Outline] = []
    for window in windows:
        polygons, numbers = trace(file.read_image("surface_fine", window), file.factor)
        found += [
            Outline(surface=surface, window=window, polygons=polygons[numbers == surface].tolist())
            for surface in np.flatnonzero((file.surface_window == window) & ~file.planes.is_smooth).tolist()
        ]
    return found


def trace(
    numbers: NDArray[np.int32], factor: int, *, tolerance: float = 1.0
) -> tuple[NDArray[np.object_], NDArray[np.int32]]:
    """Polygons of the regions of an image of numbers.

    Parameters
    ----------
    numbers : (row, col) int32
        Number of each part of a pixel; `NO_SURFACE`: none.
    factor : int
        Parts along each side of a pixel.
    tolerance : float
        Parts of a pixel: points whose triangle with their neighbours is smaller than a square of this side are left
        out. A border that runs across the parts has steps that are artefacts of the image; the triangle at a step of
        one part by one is half a part. Longer steps, of nearly level borders, stay: triangles as large may be corners
        of a thin surface.

    Returns
    -------
    polygons : (n,) object
        shapely polygons in pixels (col, row), by number and place.
    number : (n,) int32
        Of each polygon.
    """
    shapely = need("shapely", extra="export", what="the outline of a surface")
    faces = shapely.get_parts(shapely.polygonize(shapely.linestrings(_borders(numbers))))
    inside = shapely.get_coordinates(shapely.point_on_surface(faces)).astype(np.intp)
    number = numbers[inside[:, 1], inside[:, 0]]
    faces, number = faces[number != NO_SURFACE], number[number != NO_SURFACE]
    faces = shapely.normalize(shapely.coverage_simplify(faces, tolerance))
    left, top, _, _ = shapely.bounds(faces).reshape(-1, 4).T
    order = np.lexsort((left, top, number))
    return shapely.transform(faces[order], lambda places: places / factor - 0.5), number[order]


def _borders(numbers: NDArray[np.int32]) -> FloatArray:
    """Sides of parts with another number, or the image's end, beyond: (n, 2, 2), ends of each as (x, y) in parts."""
    padded = np.pad(numbers, 1, constant_values=NO_SURFACE)
    y, x = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    level = [[x, y], [x + 1, y]]
    y, x = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    upright = [[x, y], [x, y + 1]]
    return np.concatenate([np.moveaxis(np.array(ends, dtype=np.float64), -1, 0) for ends in (level, upright)])


def placed(file: SurfacesFile, surface: int, places: FloatArray) -> FloatArray:
    """Places (n, 2) of the image, (col, row), on the plane of a surface: (n, 3) metres, as `on_planes`."""
    return on_planes(file, np.full(len(places), surface), places[:, 1], places[:, 0])
