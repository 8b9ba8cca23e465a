"""Outlines of surfaces as the fine image shows them, as polygons, by shapely; in space in JSON and Wavefront OBJ.

The borders between surfaces are traced once for both sides: the polygons of neighbours have the same points along
their common border, before and after points are left out, and there is no gap between them in the image.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.io.exporters.edge_lines import obj_header, obj_vertices, short
from tofmix.io.exporters.placing import on_planes
from tofmix.io.next_command import need
from tofmix.io.storage import AtomicFile
from tofmix.io.surfaces_file import SurfacesFile
from tofmix.surfaces.found import NO_SURFACE


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """Polygons of one surface in the image; holes are the parts that other surfaces hide."""

    # surface, window: Number of the surface, and its window.
    surface: int
    window: int
    polygons: list[Any]  # in pixels (col, row), the centre of the first pixel at (0, 0)


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


def write_json(file: AtomicFile, source: SurfacesFile, outlines: Sequence[Outline], title: str) -> None:
    """Write one object a surface; the points of an outline are in metres, and the last is the first again."""
    content = {
        "title": title,
        "frame": "of the sensor: x to the right, y down, z away; plane n . x = offset; outlines in metres",
        "surfaces": [_surface(source, outline) for outline in outlines],
    }
    file.sink.write(f"{json.dumps(content, allow_nan=False)}\n".encode())


def _surface(source: SurfacesFile, outline: Outline) -> dict[str, Any]:
    planes, k = source.planes, outline.surface
    return {
        "surface": k,
        "window": outline.window,
        "normal": [short(value) for value in planes.normal[k]],
        "offset_mm": short(planes.offset_mm[k]),
        "rms_mm": short(planes.rms_mm[k]),
        "n_pixels": int(planes.n_pixels[k]),
        "polygons": [_polygon(source, k, polygon) for polygon in outline.polygons],
    }


def _polygon(source: SurfacesFile, surface: int, polygon: Any) -> dict[str, Any]:  # noqa: ANN401  shapely has no types
    return {
        "outline": _ring(source, surface, polygon.exterior),
        "holes": [_ring(source, surface, ring) for ring in polygon.interiors],
    }


def _ring(source: SurfacesFile, surface: int, ring: Any) -> list[list[float]]:  # noqa: ANN401  shapely has no types
    """Points of a ring that lie on the plane, closed; a beam next to a grazing one may miss the plane."""
    places = placed(source, surface, np.asarray(ring.coords)[:-1])
    decimals = 6  # of a metre: micrometres
    known: list[list[float]] = np.round(places[np.isfinite(places).all(axis=-1)], decimals).tolist()
    return [*known, *known[:1]]


def write_obj(file: AtomicFile, source: SurfacesFile, outlines: Sequence[Outline], title: str) -> None:
    """Write one object a surface. Faces of OBJ have no holes, so that polygons are cut into triangles."""
    text, first = obj_header(title), 1
    for outline in outlines:
        text.append(f"o surface_{outline.surface}")
        for polygon in outline.polygons:
            vertices, faces = triangles(polygon)
            places = placed(source, outline.surface, vertices)
            known = np.isfinite(places[:, 0])
            number = first + np.cumsum(known) - 1
            text += obj_vertices(places[known])
            text += ["f {} {} {}".format(*number[face]) for face in faces if known[face].all()]
            first += int(known.sum())
    file.sink.write("\n".join([*text, ""]).encode("ascii"))


def triangles(polygon: Any) -> tuple[FloatArray, NDArray[np.intp]]:  # noqa: ANN401  shapely has no types
    """Triangles of a polygon by constrained Delaunay triangulation.

    Returns
    -------
    vertices : (n, 2) float64
        Corners of the polygon (x, y).
    faces : (m, 3) int
        Corners of each triangle. In an image, whose y runs downward, they run anticlockwise.
    """
    shapely = need("shapely", extra="export", what="the outline of a surface")
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    corners = shapely.get_coordinates(shapely.orient_polygons(parts, exterior_cw=True)).reshape(-1, 4, 2)[:, :3]
    vertices, index = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3)
