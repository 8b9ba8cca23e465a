"""Flat rectangles before a camera of angular cells, or before a pinhole with a lens: what each pixel's beam meets.

Use `cast` once a scene. A place of the image has two coordinates: azimuth and elevation without a `Lens`, and tangents
on the image plane, as the lens distorts them, with one. Cells that an edge crosses are divided again and again, down to
1/256 of a pixel, so that shares are right to 0.001; a cell whose corners and centre all meet one surface counts as that
surface's.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

FIRST_CELLS = 4  # cells along a pixel's side before any is divided
LAST_CELLS = 128  # and after; each of these is then sampled at four points
MIN_SHARE = 1.0e-4
_NEWTON_STEPS = 8  # from the imaged radius; the lenses of the bench need four for 1e-15
_LEAF = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))  # four points, no two in line


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """A flat rectangle in the sensor's frame: x right, y down, z forward, mm."""

    name: str
    center_mm: tuple[float, float, float]
    size_mm: tuple[float, float]
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    reflectivity: float = 0.6

    def axes(self) -> Array:
        """The rectangle's u, v and normal axes as columns: yaw about y first, then pitch about x."""
        yaw, pitch = math.radians(self.yaw_deg), math.radians(self.pitch_deg)
        about_y = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
        about_x = np.array([[1, 0, 0], [0, math.cos(pitch), -math.sin(pitch)], [0, math.sin(pitch), math.cos(pitch)]])
        axes: Array = about_x @ about_y
        return axes

    def shifted(self, shift_mm: float) -> "Surface":
        """The same rectangle, moved along its own normal R (0, 0, 1)."""
        center = np.array(self.center_mm) + shift_mm * self.axes()[:, 2]
        return replace(self, center_mm=(float(center[0]), float(center[1]), float(center[2])))


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """A pinhole with radial distortion, in units that stay the same if the image has other numbers of rows and columns.

    A point at the undistorted tangents (x, y) is imaged at (x, y) (1 + k1 s + k2 s^2 + k3 s^3), s = x^2 + y^2.
    """

    focal: tuple[float, float]
    """Focal lengths in image widths and image heights."""
    off_center: tuple[float, float] = (0.0, 0.0)
    """Where the axis meets the image, from its middle to the right and down, in image widths and heights."""
    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """k1, k2, k3."""

    def distorted(self, radius: Array) -> Array:
        """Imaged radius of undistorted radii, both as tangents."""
        k1, k2, k3 = self.radial
        s = radius**2
        out: Array = radius * (1 + s * (k1 + s * (k2 + s * k3)))
        return out

    def undistorted(self, radius: Array) -> Array:
        """Undistorted radius of imaged radii, by Newton's method."""
        k1, k2, k3 = self.radial
        out = np.array(radius, dtype=np.float64)
        for _ in range(_NEWTON_STEPS):
            s = out**2
            out -= (self.distorted(out) - radius) / (1 + s * (3 * k1 + s * (5 * k2 + s * 7 * k3)))
        return out

    def direction(self, x: Array, y: Array) -> Array:
        """Unit directions (3, ...) of places of the image."""
        imaged = np.hypot(x, y)
        scale = np.where(imaged > 0, self.undistorted(imaged) / np.where(imaged > 0, imaged, 1.0), 1.0)
        ray = np.stack([x * scale, y * scale, np.ones_like(scale)])
        out: Array = ray / np.sqrt((ray**2).sum(axis=0))
        return out

    def solid_angle(self, x: Array, y: Array) -> Array:
        """Solid angle per area of the image at places of it, sr per squared tangent."""
        k1, k2, k3 = self.radial
        imaged = np.hypot(x, y)
        radius = self.undistorted(imaged)
        s = radius**2
        growth = 1 + s * (3 * k1 + s * (5 * k2 + s * 7 * k3))  # of the imaged radius with the undistorted one
        across = np.where(imaged > 0, radius / np.where(imaged > 0, imaged, 1.0), 1.0)
        out: Array = across / growth / (1 + s) ** 1.5
        return out

    def pixels(self, rows: int, cols: int) -> tuple[float, float, float, float]:
        """Fx, fy, cx, cy in pixels; the centre of pixel (0, 0) is at 0, 0."""
        return (
            self.focal[0] * cols,
            self.focal[1] * rows,
            (cols - 1) / 2 + self.off_center[0] * cols,
            (rows - 1) / 2 + self.off_center[1] * rows,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """The image: rows and columns of equal cells, and how far the camera sees.

    The cells are angular; with a `lens` they are squares on its image plane, in which beams count by solid
    angle, and the fields of view say nothing.
    """

    rows: int
    cols: int
    fov_horizontal_deg: float
    fov_vertical_deg: float
    range_max_mm: float
    lens: Lens | None = None

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.rows * self.cols

    @property
    def cell_rad(self) -> tuple[float, float]:
        """A pixel's extent in azimuth and elevation, rad; with a lens, in tangents."""
        if self.lens is not None:
            return 1 / (self.lens.focal[0] * self.cols), 1 / (self.lens.focal[1] * self.rows)
        return math.radians(self.fov_horizontal_deg) / self.cols, math.radians(self.fov_vertical_deg) / self.rows

    @property
    def middle(self) -> tuple[float, float]:
        """The place (x, y) of the image's middle."""
        if self.lens is None:
            return 0.0, 0.0
        (right, down), (wide, high) = self.lens.off_center, self.lens.focal
        return -right / wide, -down / high

    def places(self) -> tuple[Array, Array]:
        """Places (x, y) of the pixels' centres, each (pixel,)."""
        wide, high = self.cell_rad
        x = (np.arange(self.cols) - (self.cols - 1) / 2) * wide
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * high
        if self.lens is not None:
            x, y = x + self.middle[0], y + self.middle[1]
        return np.tile(x, self.rows), np.repeat(y, self.cols)

    def direction(self, x: Array, y: Array) -> Array:
        """Unit directions (3, ...) of places of the image."""
        return direction(x, y) if self.lens is None else self.lens.direction(x, y)

    def angles(self) -> tuple[Array, Array]:
        """Azimuth and elevation (pixel,) of the pixels' centres, rad."""
        if self.lens is None:
            return self.places()
        x, y, z = self.lens.direction(*self.places())
        return np.arctan2(x, z), np.arcsin(y)


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """What each pixel's beam meets, from near to far; L is the largest number of surfaces in one beam."""

    share: Array
    """(L, pixel) float64. Area shares; 0 where a beam has fewer surfaces."""
    range_mm: Array
    """(L, pixel) float64. Mean range of each surface's part of the beam."""
    cosine: Array
    """(L, pixel) float64. Mean cosine of incidence."""
    surface: Array
    """(L, pixel) int64. Number of the surface; -1 where there is none."""
    nothing: Array
    """(pixel,) float64. The share that meets no surface."""


def direction(azimuth: Array, elevation: Array) -> Array:
    """Unit directions (3, ...) of beams."""
    return np.stack([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])


def first_hit(surfaces: list[Surface], azimuth: Array, elevation: Array, range_max_mm: float) -> tuple[Array, ...]:
    """Surface number (-1: none), range and cosine of incidence of thin beams, each of the angles' shape."""
    return first_along(surfaces, direction(azimuth, elevation), range_max_mm)


def first_along(surfaces: list[Surface], beam: Array, range_max_mm: float) -> tuple[Array, ...]:
    """The same for unit directions (3, ...)."""
    shape = beam.shape[1:]
    number = np.full(shape, -1, dtype=np.int64)
    nearest = np.full(shape, np.inf)
    cosine = np.zeros(shape)
    for k, surface in enumerate(surfaces):
        axes, center = surface.axes(), np.array(surface.center_mm)
        slope = np.tensordot(axes[:, 2], beam, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = (axes[:, 2] @ center) / slope
            inside = (away > 0) & (away <= range_max_mm) & (away < nearest)
            for axis in (0, 1):
                along = away * np.tensordot(axes[:, axis], beam, 1) - axes[:, axis] @ center
                inside &= np.abs(along) <= surface.size_mm[axis] / 2
        number[inside], nearest[inside], cosine[inside] = k, away[inside], np.abs(slope[inside])
    return number, nearest, cosine


class _Sums:
    """Share, share x range and share x cosine of each (surface, pixel)."""

    def __init__(self, surfaces: list[Surface], view: View) -> None:
        self.surfaces, self.view = surfaces, view
        self.total = np.zeros((3, len(surfaces) * view.pixels))
        self.whole = np.zeros(view.pixels)

    def hit(self, x: Array, y: Array) -> tuple[Array, ...]:
        return first_along(self.surfaces, self.view.direction(x, y), self.view.range_max_mm)

    def add(self, pixel: Array, x: Array, y: Array, hits: tuple[Array, ...], share: float) -> None:
        """Add cells of a size, `share` of a pixel each; behind a lens each counts by its solid angle."""
        number, away, cosine = hits
        met = number >= 0
        index = number[met] * self.view.pixels + pixel[met]
        size = np.ones(index.size)
        if self.view.lens is not None:
            solid = self.view.lens.solid_angle(x, y)
            self.whole += share * np.bincount(pixel.ravel(), solid.ravel(), self.whole.size)
            size = solid[met]
        for row, value in enumerate((None, away, cosine)):
            weight = size if value is None else size * value[met]
            self.total[row] += share * np.bincount(index, weight, self.total.shape[1])

    def shares(self) -> Array:
        """The sums (3, surface, pixel) as shares of each pixel."""
        total = self.total.reshape(3, len(self.surfaces), self.view.pixels)
        return total if self.view.lens is None else total / self.whole


def cast(surfaces: list[Surface], view: View) -> Beams:
    """Cast all beams of a scene; the last scenes are kept, so change nothing in what it returns."""
    return _cast(tuple(surfaces), view)


@lru_cache(maxsize=64)
def _cast(surfaces: tuple[Surface, ...], view: View) -> Beams:
    sums = _Sums(list(surfaces), view)
    wide, high = view.cell_rad
    pixel, x, y = _first_cells(sums)
    cells = 2 * FIRST_CELLS
    while pixel.size and cells <= LAST_CELLS:
        center = sums.hit(x, y)
        mixed = np.zeros(pixel.size, dtype=bool)
        for i, j in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
            mixed |= sums.hit(x + i * wide / cells, y + j * high / cells)[0] != center[0]
        sums.add(pixel[~mixed], x[~mixed], y[~mixed], tuple(part[~mixed] for part in center), cells**-2)
        pixel, x, y = _divided(view, pixel[mixed], x[mixed], y[mixed], cells)
        cells *= 2
    sums.add(pixel, x, y, sums.hit(x, y), cells**-2)
    return _sorted_beams(sums.shares())


def _first_cells(sums: _Sums) -> tuple[Array, Array, Array]:
    """Cast the first cells of all pixels, which share their corners; the pixel and angles of those to divide."""
    view = sums.view
    wide, high = view.cell_rad
    down, across = view.rows * FIRST_CELLS, view.cols * FIRST_CELLS
    edge_x = (np.arange(across + 1) - across / 2) * wide / FIRST_CELLS
    edge_y = (np.arange(down + 1) - down / 2) * high / FIRST_CELLS
    if view.lens is not None:
        edge_x, edge_y = edge_x + view.middle[0], edge_y + view.middle[1]
    corner = sums.hit(*np.meshgrid(edge_x, edge_y))[0]
    x, y = np.meshgrid(edge_x[:-1] + wide / FIRST_CELLS / 2, edge_y[:-1] + high / FIRST_CELLS / 2)
    center = sums.hit(x, y)
    mixed = np.zeros(x.shape, dtype=bool)
    for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]):
        mixed |= part != center[0]
    row, col = np.indices(x.shape) // FIRST_CELLS
    pixel = row * view.cols + col
    sums.add(pixel[~mixed], x[~mixed], y[~mixed], tuple(part[~mixed] for part in center), FIRST_CELLS**-2)
    return _divided(view, pixel[mixed], x[mixed], y[mixed], FIRST_CELLS)


def _divided(view: View, pixel: Array, x: Array, y: Array, cells: int) -> tuple[Array, Array, Array]:
    """Four quarters of each cell; of the smallest cells four points, no two in line."""
    wide, high = view.cell_rad
    points = _LEAF if cells == LAST_CELLS else tuple((i, j) for i in (-0.25, 0.25) for j in (-0.25, 0.25))
    return (
        np.tile(pixel, 4),
        np.concatenate([x + i * wide / cells for i, _ in points]),
        np.concatenate([y + j * high / cells for _, j in points]),
    )


def _sorted_beams(total: Array) -> Beams:
    """Near to far, without shares below `MIN_SHARE`; the others fill the beam."""
    share = np.where(total[0] >= MIN_SHARE, total[0], 0.0)
    nothing = 1.0 - total[0].sum(axis=0)
    nothing[nothing < MIN_SHARE] = 0.0
    whole = share.sum(axis=0) + nothing
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.where(share > 0, total[1] / total[0], np.inf)
        cosine = np.where(share > 0, total[2] / total[0], 0.0)
    order = np.argsort(away, axis=0, kind="stable")[: max(1, int((share > 0).sum(axis=0).max()))]
    near = np.take_along_axis(away, order, 0)
    return Beams(
        share=np.take_along_axis(share / whole, order, 0),
        range_mm=np.where(np.isfinite(near), near, 0.0),
        cosine=np.take_along_axis(cosine, order, 0),
        surface=np.where(np.isfinite(near), order, -1),
        nothing=nothing / whole,
    )
