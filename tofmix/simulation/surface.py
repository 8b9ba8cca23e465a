"""A flat rectangle in space: of these a scene is made."""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray

MAX_LENGTH_MM = 1.0e6  # a kilometre: far beyond any range, and no product of lengths overflows


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """A flat rectangle, seen from both sides.

    Its points are ``center + R (u, v, 0)``, ``|u| <= width / 2``, ``|v| <= height / 2``.

    Parameters
    ----------
    name : str
        Its name in the model.
    center_mm : (float, float, float)
        Centre in the sensor's frame, mm: x right, y down, z forward; each within a kilometre.
    size_mm : (float, float)
        Width and height, mm, above 0, up to a kilometre.
    yaw_deg, pitch_deg, roll_deg : float
        Right-handed rotations about y, then about x, then about z, axes of the sensor's frame; degrees.
    reflectivity : float
        In [0, 1].

    Raises
    ------
    ValueError
        If a number is not finite or outside its bounds. The message begins with the key.
    """

    name: str
    center_mm: tuple[float, float, float]
    size_mm: tuple[float, float]
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    reflectivity: float = 0.8

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError("name: it is empty")
        if not all(abs(x) <= MAX_LENGTH_MM for x in self.center_mm):
            raise ValueError(f"center_mm: {list(self.center_mm)} are not all within +-{MAX_LENGTH_MM:g}")
        if not all(0 < x <= MAX_LENGTH_MM for x in self.size_mm):
            raise ValueError(f"size_mm: {list(self.size_mm)} are not both above 0 and up to {MAX_LENGTH_MM:g}")
        for key in ("yaw_deg", "pitch_deg", "roll_deg"):
            if not math.isfinite(getattr(self, key)):
                raise ValueError(f"{key}: {getattr(self, key)} is not finite")
        if not 0 <= self.reflectivity <= 1:
            raise ValueError(f"reflectivity: {self.reflectivity:g} is not in [0, 1]")

    def rotation(self) -> FloatArray:
        """R (3, 3): its columns are the rectangle's u, v and normal axes in the sensor's frame."""
        yaw, pitch, roll = (math.radians(angle) for angle in (self.yaw_deg, self.pitch_deg, self.roll_deg))
        about_y = np.array([[math.cos(yaw), 0.0, math.sin(yaw)], [0.0, 1.0, 0.0], [-math.sin(yaw), 0.0, math.cos(yaw)]])
        about_x = np.array(
            [[1.0, 0.0, 0.0], [0.0, math.cos(pitch), -math.sin(pitch)], [0.0, math.sin(pitch), math.cos(pitch)]]
        )
        about_z = np.array(
            [[math.cos(roll), -math.sin(roll), 0.0], [math.sin(roll), math.cos(roll), 0.0], [0.0, 0.0, 1.0]]
        )
        rotation: FloatArray = about_z @ (about_x @ about_y)
        return rotation
