"""Position and direction of the camera in the map.

Map frame (as in ROS): x and y level, z up. The camera is at height 0 of the map;
with yaw 0 it looks along x, and y is to its left.
"""

import math
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import FloatArray

MAX_PITCH_DEG = 89.0  # a vertical view has no yaw
MAX_POSITION_MM = 1.0e7  # 10 km from the map's origin


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
        for key in ("x_mm", "y_mm"):
            if not abs(getattr(self, key)) <= MAX_POSITION_MM:
                raise ValueError(f"{key}: {getattr(self, key):g} is not within {MAX_POSITION_MM:g} mm")
        if not math.isfinite(self.yaw_deg):
            raise ValueError(f"yaw_deg: {self.yaw_deg:g} is not finite")
        if not abs(self.pitch_deg) <= MAX_PITCH_DEG:
            raise ValueError(f"pitch_deg: {self.pitch_deg:g} is not within {MAX_PITCH_DEG:g} degrees")

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
