"""Which part of an image each cell of a map may cover, for any projection.

`cell_outlines` gives rectangles in the image; the kernel then looks along the pixels
in them. Images of equal angles have their own outlines, in the kernel itself.
"""

from itertools import product

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.optics.projection import Projection, cell_nodes, unit

_POINTS = np.array([p for p in product((0.0, 0.5, 1.0), repeat=3) if p.count(0.5) <= 1])
"""Corners of a cell and the middles of its edges, in cells: where the lens bends an edge outward its middle counts."""

_SLACK_RAD = 1e-6
"""Added to the cone of the image, so that its border lies inside."""


def image_nodes(optics: Projection, shape: tuple[int, int]) -> FloatArray:
    """Rays (2 rows + 1, 2 cols + 1, 3) at the pixels' corners, sides and centres.

    Raises
    ------
    ValueError
        If a part of the image looks nowhere.
    """
    rows, cols = shape
    nodes = np.empty((2 * rows + 1, 2 * cols + 1, 3))
    for row in range(rows):
        nodes[2 * row : 2 * row + 3] = cell_nodes(optics, row, shape)
    return nodes


def image_cone(nodes: FloatArray) -> tuple[FloatArray, float]:
    """A cone around all rays of an image: its axis (3,) of unit length, and its half angle, rad."""
    border = unit(np.concatenate([nodes[0], nodes[-1], nodes[:, 0], nodes[:, -1]]))
    axis = unit(border.mean(axis=0))
    return axis, float(np.arccos(np.clip(border @ axis, -1.0, 1.0)).max()) + _SLACK_RAD


def cell_outlines(
    optics: Projection,
    shape: tuple[int, int],
    low: FloatArray,
    cell_mm: float,
    rotation: FloatArray,
    cone: tuple[FloatArray, float],
) -> FloatArray:
    """Rectangles in the image that contain the visible parts of cells.

    Parameters
    ----------
    optics : Projection
        Where the pixels look.
    shape : (int, int)
        Rows and columns of the image.
    low : (n, 3) float64
        Least x, y and z of the cells relative to the camera, mm, along the map's axes.
    cell_mm : float
        Edge of a cell, mm.
    rotation : (3, 3) float64
        Its columns are the sensor's axes in the map's frame.
    cone : (array, float)
        From `image_cone`.

    Returns
    -------
    (n, 4) float64
        Left, right, top and bottom in pixels from the image's outer corner; left above right for invisible cells, and
        for the cell of the camera or next to it. The whole image where a part of the cell has no place in it.
    """
    rows, cols = shape
    points = (low[:, np.newaxis] + cell_mm * _POINTS) @ rotation
    row, col = optics.pixels(points, shape=shape)
    out = np.stack([col.min(axis=1), col.max(axis=1), row.min(axis=1), row.max(axis=1)], axis=1) + 0.5
    out[np.isnan(out).any(axis=1)] = (0.0, cols, 0.0, rows)
    centre = (low + cell_mm / 2) @ rotation
    distance, radius = np.linalg.norm(centre, axis=1), cell_mm * np.sqrt(0.75)
    axis, half = cone
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.arccos(np.clip(centre @ axis / distance, -1.0, 1.0)) - np.arcsin(np.minimum(radius / distance, 1.0))
    out[(distance <= radius) | (off > half)] = (1.0, 0.0, 1.0, 0.0)
    return out
