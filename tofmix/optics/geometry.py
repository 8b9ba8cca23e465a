"""Directions of pixels, range and depth, phase and range.

Ranges in recordings and layers are radial. The angles here are of an equiangular grid: equal angles between neighbours.
`tofmix.optics.projection` has it among other projections.

Phase and range of an amplitude-modulated continuous-wave camera.
"""

import numpy as np

from tofmix.arrays import FloatArray

SPEED_OF_LIGHT_MM_S = 299_792_458_000.0  # in vacuum, mm/s; exact by the definition of the metre


def unambiguous_range_mm(modulation_frequency_hz: float) -> float:
    """Range at which the phase has turned once, d_u = c / (2 f).

    Parameters
    ----------
    modulation_frequency_hz : float
        Modulation frequency, above 0.

    Returns
    -------
    float
        d_u in mm; 7494.8 at 20 MHz.

    Raises
    ------
    ValueError
        If the frequency is not above 0.

    References
    ----------
    Lange and Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448.
    """
    if not modulation_frequency_hz > 0:
        raise ValueError(f"modulation_frequency_hz: {modulation_frequency_hz} is not above 0")
    return SPEED_OF_LIGHT_MM_S / (2.0 * modulation_frequency_hz)


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
