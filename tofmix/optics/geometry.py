"""Directions of pixels, and the ratio of range along the beam to depth along z.

Ranges in recordings and layers are radial. The angles here are of an equiangular grid: equal angles between neighbours.
`tofmix.optics.projection` has it among other projections.
"""

import numpy as np

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


def ray_over_depth(directions: FloatArray) -> FloatArray:
    """Range over depth along z of each beam, at least 1.

    Parameters
    ----------
    directions : (row, col, 3) float64
        Unit vectors.

    Returns
    -------
    (row, col) float64
        1 / z.

    Raises
    ------
    ValueError
        If a beam is 90 degrees or more off the axis and has no depth.
    """
    forward = directions[..., 2]
    if not (forward > np.finfo(np.float32).eps).all():
        raise ValueError("a pixel looks 90 degrees or more off the axis and has no depth along z")
    return np.asarray(1.0 / forward)


def largest_angle_deg(one: FloatArray, other: FloatArray) -> float:
    """Largest angle between two images of unit vectors (row, col, 3), degrees."""
    across = np.linalg.norm(np.cross(one, other), axis=-1)
    return float(np.rad2deg(np.arctan2(across, (one * other).sum(axis=-1))).max())
