"""Equal angles between the pixels of a row and of a column: the projection of a recording that names none."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from tofmix.arrays import FloatArray

_HORIZONTAL_MOST_DEG, _VERTICAL_MOST_DEG = 360.0, 180.0  # a whole turn, and from pole to pole


def check_view(fov_horizontal_deg: float, fov_vertical_deg: float) -> None:
    """Refuse a field of view that cannot be.

    Raises
    ------
    ValueError
        If an angle is not above 0, or above 360 (horizontal) or 180 (vertical) degrees.
    """
    for name, value, most in (
        ("fov_horizontal_deg", fov_horizontal_deg, _HORIZONTAL_MOST_DEG),
        ("fov_vertical_deg", fov_vertical_deg, _VERTICAL_MOST_DEG),
    ):
        if not 0.0 < value <= most:
            raise ValueError(f"{name}: {value:g} is not above 0 and up to {most:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Equiangular:
    """Pixel (row, col) looks along azimuth (col - (cols - 1) / 2) fov_h / cols, and likewise in elevation.

    Parameters
    ----------
    fov_horizontal_deg, fov_vertical_deg : float
        Full field of view, from the outer edge of the first pixel to that of the last; above 0, up to 360 and 180.

    Raises
    ------
    ValueError
        If an angle is outside its bounds.
    """

    name: ClassVar[str] = "equiangular"

    fov_horizontal_deg: float
    fov_vertical_deg: float

    def __post_init__(self) -> None:
        check_view(self.fov_horizontal_deg, self.fov_vertical_deg)

    def pixel_size_rad(self, shape: tuple[int, int]) -> tuple[float, float]:
        """Extent of a pixel of an image (rows, cols) in azimuth and elevation, rad."""
        rows, cols = shape
        return math.radians(self.fov_horizontal_deg / cols), math.radians(self.fov_vertical_deg / rows)

    def rays(self, row: ArrayLike, col: ArrayLike, *, shape: tuple[int, int]) -> FloatArray:
        """Vectors (..., 3) along the beams at places (row, col) of an image; here of unit length."""
        rows, cols = shape
        down, across = np.broadcast_arrays(np.asarray(row, dtype=np.float64), np.asarray(col, dtype=np.float64))
        azimuth = np.deg2rad((across - (cols - 1) / 2) * self.fov_horizontal_deg / cols)
        elevation = np.deg2rad((down - (rows - 1) / 2) * self.fov_vertical_deg / rows)
        level = np.cos(elevation)
        return np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)

    def pixels(self, directions: FloatArray, *, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """Place (row, col) of directions (..., 3), in the image or outside it."""
        rows, cols = shape
        width, height = self.pixel_size_rad(shape)
        x, y, z = np.moveaxis(directions, -1, 0)
        row = np.arctan2(y, np.hypot(x, z)) / height + (rows - 1) / 2
        return row, np.arctan2(x, z) / width + (cols - 1) / 2

    def check(self, shape: tuple[int, int]) -> None:
        """An image of any size has equal angles."""

    def words(self, shape: tuple[int, int]) -> str:  # noqa: ARG002  for projections that need the image's size
        """The field of view in words."""
        return f"{self.fov_horizontal_deg:g} x {self.fov_vertical_deg:g} degrees"
