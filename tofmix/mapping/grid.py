"""The cells of a map, the camera among them, and the part of its image that a cell may cover.

The cells of a map: cubes on a lattice that does not move with the camera.

Cell k of an axis spans [k cell_mm, (k + 1) cell_mm), so maps of several poses lie on the same grid.

Position and direction of the camera in the map.

Map frame (as in ROS): x and y level, z up. The camera is at height 0 of the map;
with yaw 0 it looks along x, and y is to its left.

Which part of an image each cell of a map may cover, for any projection.

`cell_outlines` gives rectangles in the image; the kernel then looks along the pixels
in them. Images of equal angles have their own outlines, in the kernel itself.
"""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.mapping.beams import Beams
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import Projection, cell_nodes, unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Place and direction of the camera.

    Parameters
    ----------
    x_mm, y_mm : float
        Place in the map, mm, each within 10 km.
    yaw_deg : float
        Direction of view, anticlockwise from the x axis, degrees.
    pitch_deg : float
        How far the camera looks down, degrees, within 89; below 0 it looks up. It does not roll.

    Raises
    ------
    ValueError
        If a number is not finite or outside its bounds.
    """

    x_mm: float = 0.0
    y_mm: float = 0.0
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0

    def __post_init__(self) -> None:
        max_position_mm = 1.0e7  # 10 km from the map's origin
        for key in ("x_mm", "y_mm"):
            if not abs(getattr(self, key)) <= max_position_mm:
                raise ValueError(f"{key}: {getattr(self, key):g} is not within {max_position_mm:g} mm")
        if not math.isfinite(self.yaw_deg):
            raise ValueError(f"yaw_deg: {self.yaw_deg:g} is not finite")
        max_pitch_deg = 89.0  # a vertical view has no yaw
        if not abs(self.pitch_deg) <= max_pitch_deg:
            raise ValueError(f"pitch_deg: {self.pitch_deg:g} is not within {max_pitch_deg:g} degrees")

    def rotation(self) -> FloatArray:
        """(3, 3): its columns are the sensor's axes (x right, y down, z forward) in the map's frame."""
        yaw, pitch = math.radians(self.yaw_deg), math.radians(self.pitch_deg)
        ahead, left = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([-math.sin(yaw), math.cos(yaw), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        forward = math.cos(pitch) * ahead - math.sin(pitch) * up
        down = -math.cos(pitch) * up - math.sin(pitch) * ahead
        return np.column_stack([-left, down, forward])

    def position(self) -> FloatArray:
        """(3,): the camera's place in the map, mm; its height is 0."""
        return np.array([self.x_mm, self.y_mm, 0.0])


_POINTS = np.array([p for p in product((0.0, 0.5, 1.0), repeat=3) if p.count(0.5) <= 1])
"""Corners of a cell and the middles of its edges, in cells: where the lens bends an edge outward its middle counts."""


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
    slack_rad = 1e-6  # added to the cone of the image, so that its border lies inside
    return axis, float(np.arccos(np.clip(border @ axis, -1.0, 1.0)).max()) + slack_rad


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


_BORDER = 33  # directions on each side of the field of view whose ends bound the grid


@dataclass(frozen=True, slots=True, kw_only=True)
class VoxelGrid:
    """A box of cubic cells.

    Parameters
    ----------
    cell_mm : float
        Edge of a cell, mm, above 0.
    first : (int, int, int)
        Lattice number of the first cell along x, y and z.
    shape : (int, int, int)
        Cells along x, y and z, each at least 1.

    Raises
    ------
    ValueError
        If a number is outside its bounds, or there are over 50 million cells.
    """

    cell_mm: float
    first: tuple[int, int, int]
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.cell_mm) and self.cell_mm > 0):
            raise ValueError(f"cell_mm: {self.cell_mm:g} is not a finite number above 0")
        if min(self.shape) < 1:
            raise ValueError(f"shape: {self.shape} holds no cell")
        max_cells = 50_000_000  # most cells of a grid: about 2 GB while it is made
        if self.size > max_cells:
            raise ValueError(
                f"{self.size:,} cells of {self.cell_mm:g} mm are more than {max_cells:,}; take larger cells"
            )

    @property
    def origin_mm(self) -> FloatArray:
        """(3,): the grid's corner of least x, y and z, mm."""
        return np.array(self.first, dtype=np.float64) * self.cell_mm

    def centres_mm(self, axis: int) -> FloatArray:
        """Centres of the cells along an axis, mm."""
        number = np.arange(self.shape[axis], dtype=np.float64)
        return (self.first[axis] + number + 0.5) * self.cell_mm

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    def with_levels(self, height_mm: tuple[float, float]) -> "VoxelGrid":
        """The same grid, extended upward or downward to a band of heights.

        Raises
        ------
        ValueError
            If the band is empty, or the cells become too many.
        """
        low, high = lattice_span(height_mm, self.cell_mm)
        low, high = min(low, self.first[2]), max(high, self.first[2] + self.shape[2])
        return replace(self, first=(*self.first[:2], low), shape=(*self.shape[:2], high - low))

    def levels(self, height_mm: tuple[float, float]) -> slice:
        """Which levels along z a band of heights meets: the band is rounded outward to whole cells.

        Raises
        ------
        ValueError
            If the band is empty or outside the grid.
        """
        low, high = lattice_span(height_mm, self.cell_mm)
        if low < self.first[2] or high > self.first[2] + self.shape[2]:
            raise ValueError(f"heights {height_mm[0]:g} to {height_mm[1]:g} mm are not all within the grid")
        return slice(low - self.first[2], high - self.first[2])


def lattice_span(interval_mm: tuple[float, float], cell_mm: float) -> tuple[int, int]:
    """First cell, and the cell after the last, of the lattice that an interval [low, high] meets.

    Raises
    ------
    ValueError
        If low is not below high, or one is not finite.
    """
    low, high = interval_mm
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ValueError(f"{low:g},{high:g}: the first must be below the second, and both finite")
    slack = 1e-9  # 300 / 0.1 is 2999.9999999999995: an end on the lattice stays there
    return math.floor(low / cell_mm + slack), math.ceil(high / cell_mm - slack)


def plan_grid(beams: Beams, pose: Pose, *, cell_mm: float, height_mm: tuple[float, float] | None = None) -> VoxelGrid:
    """The smallest grid that holds the camera and all ranges with information from its beams.

    Parameters
    ----------
    beams : Beams
        The pixels of the camera.
    pose : Pose
        Where it stood.
    cell_mm : float
        Edge of a cell, mm, above 0.
    height_mm : (float, float), optional
        Band of heights above the camera, mm, rounded outward to whole cells; all visible heights without it.

    Returns
    -------
    Grid
        The same for all images of a camera from a pose, unless it has no range limit or a surface lies behind it.

    Raises
    ------
    ValueError
        If the cells are too many, or a number is outside its bounds.
    """
    if not (math.isfinite(cell_mm) and cell_mm > 0):
        raise ValueError(f"cell_mm: {cell_mm:g} is not a finite number above 0")
    reach = max(beams.reach_mm, cell_mm)
    ends = np.vstack([np.zeros(3), reach * _directions(beams)]) @ pose.rotation().T + pose.position()
    low, high = ends.min(axis=0), ends.max(axis=0)
    spans = [lattice_span((low[axis] - cell_mm / 2, high[axis] + cell_mm / 2), cell_mm) for axis in range(3)]
    if height_mm is not None:
        spans[2] = lattice_span(height_mm, cell_mm)
    return VoxelGrid(
        cell_mm=float(cell_mm),
        first=(spans[0][0], spans[1][0], spans[2][0]),
        shape=(spans[0][1] - spans[0][0], spans[1][1] - spans[1][0], spans[2][1] - spans[2][0]),
    )


def _directions(beams: Beams) -> FloatArray:
    """Unit vectors (n, 3) over the field of view, in the sensor's frame; of equal angles also 0 and right angles."""
    optics = beams.optics
    if not isinstance(optics, Equiangular):
        rows, cols = beams.shape
        places = np.linspace(-0.5, rows - 0.5, _BORDER), np.linspace(-0.5, cols - 0.5, _BORDER)
        return unit(optics.rays(*np.meshgrid(*places, indexing="ij"), shape=beams.shape)).reshape(-1, 3)
    angles = math.radians(optics.fov_horizontal_deg), math.radians(optics.fov_vertical_deg)
    azimuth, elevation = (_with_right_angles(angle / 2) for angle in angles)
    az, el = np.meshgrid(azimuth, elevation)
    return np.column_stack([(np.sin(az) * np.cos(el)).ravel(), np.sin(el).ravel(), (np.cos(az) * np.cos(el)).ravel()])


def _with_right_angles(half: float) -> FloatArray:
    right = np.array([-np.pi, -np.pi / 2, 0.0, np.pi / 2, np.pi])
    return np.concatenate([np.linspace(-half, half, _BORDER), right[np.abs(right) <= half]])
