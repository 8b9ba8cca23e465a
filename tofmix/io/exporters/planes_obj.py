"""Surfaces as Wavefront OBJ: the visible part of each as triangles in space, facing the sensor."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.io.atomic.storage import AtomicFile
from tofmix.io.exporters.edges_obj import VERTEX
from tofmix.io.exporters.outlines import Outline, placed
from tofmix.io.extras import need
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.version import __version__


def write(file: AtomicFile, source: SurfacesFile, outlines: Sequence[Outline], title: str) -> None:
    """Write one object a surface. Faces of OBJ have no holes, so that polygons are cut into triangles."""
    text = [f"# {title}", f"# written by tofmix {__version__}", "# metres: x to the right, y down, z away"]
    first = 1  # OBJ counts vertices from 1
    for outline in outlines:
        text.append(f"o surface_{outline.surface}")
        for polygon in outline.polygons:
            vertices, faces = triangles(polygon)
            places = placed(source, outline.surface, vertices)
            known = np.isfinite(places[:, 0])
            number = first + np.cumsum(known) - 1
            text += [VERTEX.format(*place) for place in places[known].tolist()]
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
