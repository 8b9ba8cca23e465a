"""Where a pixel looks, and how depth along z and range along the beam go together.

Ranges in recordings and layers are radial. The pixel grid of a recording is
equiangular: equal angles between neighbours. A pinhole camera has equal steps on
its image plane instead; `pinhole_directions` is for its depth images.
"""

import numpy as np

from tofmix.arrays import FloatArray

_HORIZONTAL_MOST_DEG, _VERTICAL_MOST_DEG = 360.0, 180.0


_FAR = 1e100
"""Larger than any tangent of an angle, and its square is a number."""


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


def pixel_angles(pixels: int, fov_deg: float) -> FloatArray:
    """Angle from the axis of each of `pixels` in a row or column, (pixels,) rad: (i - (n - 1) / 2) fov / n."""
    return np.asarray(np.deg2rad((np.arange(pixels) - (pixels - 1) / 2) * fov_deg / pixels), dtype=np.float64)


def beam_directions(rows: int, cols: int, *, fov_horizontal_deg: float, fov_vertical_deg: float) -> FloatArray:
    """Unit vectors along the beams of an equiangular pixel grid.

    Parameters
    ----------
    rows, cols : int
        Size of the image.
    fov_horizontal_deg, fov_vertical_deg : float
        Full field of view.

    Returns
    -------
    (row, col, 3) float64
        (sin az cos el, sin el, cos az cos el) in the sensor's frame: x right, y down, z forward.

    Raises
    ------
    ValueError
        If the field of view cannot be.
    """
    check_view(fov_horizontal_deg, fov_vertical_deg)
    azimuth, elevation = np.meshgrid(pixel_angles(cols, fov_horizontal_deg), pixel_angles(rows, fov_vertical_deg))
    level = np.cos(elevation)
    return np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)


def pinhole_directions(
    rows: int, cols: int, *, focal_px: tuple[float, float], centre_px: tuple[float, float]
) -> FloatArray:
    """Unit vectors along the beams of a pinhole camera without lens distortion.

    Parameters
    ----------
    rows, cols : int
        Size of the image.
    focal_px : (float, float)
        fx, fy.
    centre_px : (float, float)
        cx, cy: column and row, from 0 at the centre of the first pixel.

    Returns
    -------
    (row, col, 3) float64
        Along ((col - cx) / fx, (row - cy) / fy, 1).

    Raises
    ------
    ValueError
        If a focal length is not above 0, or a number is not finite.
    """
    if not (np.isfinite([*focal_px, *centre_px]).all() and min(focal_px) > 0):
        raise ValueError(f"focal lengths {focal_px} and centre {centre_px} are not those of a camera")
    with np.errstate(over="ignore"):  # a damaged file's numbers: such a beam has no part along z
        x, y = np.meshgrid(
            (np.arange(cols) - centre_px[0]) / focal_px[0], (np.arange(rows) - centre_px[1]) / focal_px[1]
        )
        beams = np.stack([np.clip(x, -_FAR, _FAR), np.clip(y, -_FAR, _FAR), np.ones((rows, cols))], axis=-1)
    return np.asarray(beams / np.linalg.norm(beams, axis=-1, keepdims=True))


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
