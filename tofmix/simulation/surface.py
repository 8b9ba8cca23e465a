"""A flat rectangle in space, of which a scene is made; its tilts, and the changes of yaw, pitch and roll for them.

A plane tilts about two axes; a turn about its normal moves its edges alone. Which of yaw, pitch and roll tilts a
surface depends on the surface: a side wall (yaw 90) does not change with pitch, and leans by its roll. So a pose is
fitted in tilts, and is written as changes of yaw and of pitch; or of yaw and of roll, where pitch would change more
than twice as far.

`surface_along` makes a surface whose axes are known, and not its angles.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tofmix.arrays import FloatArray

USUAL_REFLECTIVITY = 0.8
"""Reflectivity, 0 to 1, of a surface that gives none: that of a light wall."""

NEAREST_MM = 1.0
"""No surface is nearer: a recording of whole mm stores no shorter range, and 0 means no sample."""

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
    reflectivity: float = USUAL_REFLECTIVITY

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
        return _rotation(self.yaw_deg, self.pitch_deg, self.roll_deg)

    @property
    def plane_distance_mm(self) -> float:
        """Distance of its plane from the sensor, mm."""
        return abs(float(self.rotation()[:, 2] @ np.array(self.center_mm)))

    def shifted(self, shift_mm: float) -> "Surface":
        """The surface, moved along its normal.

        Raises
        ------
        ValueError
            If it would leave the bounds of a model.
        """
        x, y, z = np.array(self.center_mm) + shift_mm * self.rotation()[:, 2]
        return replace(self, center_mm=(float(x), float(y), float(z)))


@lru_cache(maxsize=256)  # surfaces of a scene, at the poses that a search tries
def _rotation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> FloatArray:
    """R (3, 3) of these angles, read only."""
    yaw, pitch, roll = (math.radians(angle) for angle in (yaw_deg, pitch_deg, roll_deg))
    about_y = np.array([[math.cos(yaw), 0.0, math.sin(yaw)], [0.0, 1.0, 0.0], [-math.sin(yaw), 0.0, math.cos(yaw)]])
    about_x = np.array(
        [[1.0, 0.0, 0.0], [0.0, math.cos(pitch), -math.sin(pitch)], [0.0, math.sin(pitch), math.cos(pitch)]]
    )
    about_z = np.array([[math.cos(roll), -math.sin(roll), 0.0], [math.sin(roll), math.cos(roll), 0.0], [0.0, 0.0, 1.0]])
    rotation: FloatArray = about_z @ (about_x @ about_y)
    rotation.setflags(write=False)
    return rotation


def angles_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Yaw, pitch and roll, degrees, of a rotation R (3, 3): the inverse of `Surface.rotation`.

    Where pitch is 90 degrees, yaw and roll turn about one axis: roll is then 0.
    """
    across = math.hypot(rotation[2, 0], rotation[2, 2])  # |cos pitch|
    pitch = math.atan2(rotation[2, 1], across)
    pole = 1e-9  # cosine of pitch below which yaw and roll turn about one axis
    if across < pole:
        yaw, roll = math.atan2(rotation[0, 2], rotation[0, 0]), 0.0
    else:
        yaw, roll = math.atan2(-rotation[2, 0], rotation[2, 2]), math.atan2(-rotation[0, 1], rotation[1, 1])
    return math.degrees(yaw), math.degrees(pitch), math.degrees(roll)


def surface_along(
    name: str, *, center_mm: FloatArray, size_mm: FloatArray, axes: FloatArray, reflectivity: float = USUAL_REFLECTIVITY
) -> Surface:
    """A surface by the axes of its rectangle.

    Parameters
    ----------
    name : str
        Its name.
    center_mm : (3,) float64
        Its centre, mm.
    size_mm : (2,) float64
        Its lengths along the first and the second axis, mm.
    axes : (3, 3) float64
        A rotation; its columns are the axes of the two sides and the normal. A quarter turn about the normal exchanges
        width and height: of the four that give the same rectangle, the one with the least sum of angles is taken.
    reflectivity : float
        In [0, 1].

    Raises
    ------
    ValueError
        If a number is outside the bounds of a `Surface`.
    """
    u, v, normal = axes.T
    width, height = (float(length) for length in size_mm)
    quarters = [(u, v, (width, height)), (v, -u, (height, width)), (-u, -v, (width, height)), (-v, u, (height, width))]
    found = [(angles_of(np.stack([first, second, normal], axis=1)), size) for first, second, size in quarters]
    (yaw, pitch, roll), size = min(found, key=lambda one: sum(abs(angle) for angle in one[0]))
    x, y, z = (float(place) for place in center_mm)
    return Surface(
        name=name,
        center_mm=(x, y, z),
        size_mm=size,
        yaw_deg=yaw,
        pitch_deg=pitch,
        roll_deg=roll,
        reflectivity=reflectivity,
    )


MOST_DEG = 60.0
"""Largest tilt that is fitted: a surface beyond is another one."""


def tilts_to(surface: Surface, normal: FloatArray) -> tuple[float, float]:
    """Tilts about the surface's own u and v axes that turn its normal to `normal` (3,), a unit vector; degrees."""
    u, v, n = surface.rotation().T @ normal
    across = math.hypot(u, v)
    part = math.degrees(math.atan2(across, n)) / across if across > 0.0 else math.degrees(1.0)
    return -float(v) * part, float(u) * part


def angle_changes(
    surface: Surface,
    tilts_deg: tuple[float, float],
    *,
    most_steps: int = 30,  # of Newton's
) -> tuple[float, float, float]:
    """Changes of yaw, pitch and roll, degrees, that tilt a surface about its own u and v axes.

    Parameters
    ----------
    tilts_deg : (float, float)
        Right-handed tilts about its u axis and about its v axis, degrees: the parts of one rotation.

    Returns
    -------
    (float, float, float)
        One of pitch and roll is 0: roll, unless pitch would change more than twice as far.

    Raises
    ------
    ValueError
        If the tilt is above `MOST_DEG`, or yaw and the other angle turn the surface about one axis alone.
    """
    tilt = math.hypot(*tilts_deg)
    if tilt > MOST_DEG:
        raise ValueError(f"a tilt of {tilt:g} degrees is above {MOST_DEG:g}")
    if tilt == 0.0:
        return 0.0, 0.0, 0.0
    part = math.sin(math.radians(tilt)) / tilt
    wanted = surface.rotation() @ np.array([tilts_deg[1] * part, -tilts_deg[0] * part, math.cos(math.radians(tilt))])
    yaw, pitch, roll = (math.radians(angle) for angle in (surface.yaw_deg, surface.pitch_deg, surface.roll_deg))
    of_pitch, of_roll = abs(math.cos(yaw)), abs(math.cos(pitch) * math.sin(yaw))  # tilt by a small change of each
    by_pitch = 2.0 * of_pitch >= of_roll  # roll only where it tilts twice as far: nearly all models have none
    least_part = 1e-6  # of a degree of tilt that an angle makes for each degree
    if max(of_pitch, of_roll) < least_part:
        raise ValueError(f'"{surface.name}" tilts about one axis alone by its angles; give it another yaw or pitch')
    change = np.zeros(2)
    enough = 1e-13  # difference of two unit normals
    for _ in range(most_steps):
        turned = (yaw + change[0], pitch + change[1] * by_pitch, roll + change[1] * (not by_pitch))
        normal, by_yaw, *others = _normal_and_slopes(*turned)
        if float(np.abs(wanted - normal).max()) < enough:
            break
        slopes = np.stack([by_yaw, others[0 if by_pitch else 1]], axis=1)
        change += np.linalg.lstsq(slopes, wanted - normal, rcond=None)[0]
    else:
        raise ValueError(f'"{surface.name}" cannot be tilted by {tilt:g} degrees with its yaw and one more angle')
    first, second = (math.degrees(math.remainder(float(angle), 2.0 * math.pi)) for angle in change)
    return (first, second, 0.0) if by_pitch else (first, 0.0, second)


def _normal_and_slopes(yaw: float, pitch: float, roll: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The normal (3,) at angles in rad, and its derivatives by yaw, pitch and roll."""
    c, s = math.cos(roll), math.sin(roll)
    about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    sin, cos = math.sin(yaw), math.cos(yaw)
    down, ahead = math.sin(pitch), math.cos(pitch)
    normal = about_z @ np.array([sin, -down * cos, ahead * cos])
    by_yaw = about_z @ np.array([cos, down * sin, -ahead * sin])
    by_pitch = about_z @ np.array([0.0, -ahead * cos, -down * cos])
    return normal, by_yaw, by_pitch, np.array([-normal[1], normal[0], 0.0])
