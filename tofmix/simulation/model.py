"""The model of a simulation, its rectangles and their tilts, and the surfaces that its pixels see.

The model of a simulation: a camera, flat rectangles before it, and the recording.

Use these types to build a scene in code. A model file is read by `tofmix.simulation.model_toml`;
`tofmix.simulation.casting.cast` computes the surfaces in each pixel of a model.

A flat rectangle in space: of these a scene is made.

Tilts of a surface about its own two axes, and the changes of yaw, pitch and roll that make them.

A plane tilts about two axes; a turn about its normal moves its edges alone. Which of yaw, pitch and roll tilts a
surface depends on the surface: a side wall (yaw 90) does not change with pitch, and leans by its roll. So a pose is
fitted in tilts, and is written as changes of yaw and of pitch; or of yaw and of roll, where pitch would change more
than twice as far.

Surfaces of every pixel of a scene: the truth of a recording, from which samples are drawn.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import ByteArray, Float32Array, FloatArray
from tofmix.errors import BadInputError
from tofmix.sensors.camera import CompleteCamera

if TYPE_CHECKING:
    from tofmix.simulation.effects.base import Effect


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


MOST_DEG = 60.0
"""Largest tilt that is fitted: a surface beyond is another one."""

PITCH_FIRST = 2.0
"""Roll is changed where it tilts a surface so many times as far as pitch does: nearly all models have no roll."""

_STEPS = 30  # of Newton's
_ENOUGH = 1e-13  # difference of two unit normals
_LEAST_PART = 1e-6  # of a degree of tilt that an angle makes for each degree


def tilts_to(surface: "Surface", normal: FloatArray) -> tuple[float, float]:
    """Tilts about the surface's own u and v axes that turn its normal to `normal` (3,), a unit vector; degrees."""
    u, v, n = surface.rotation().T @ normal
    across = math.hypot(u, v)
    part = math.degrees(math.atan2(across, n)) / across if across > 0.0 else math.degrees(1.0)
    return -float(v) * part, float(u) * part


def angle_changes(surface: "Surface", tilts_deg: tuple[float, float]) -> tuple[float, float, float]:
    """Changes of yaw, pitch and roll, degrees, that tilt a surface about its own u and v axes.

    Parameters
    ----------
    surface : Surface
        The surface.
    tilts_deg : (float, float)
        Right-handed tilts about its u axis and about its v axis, degrees: the parts of one rotation.

    Returns
    -------
    (float, float, float)
        One of pitch and roll is 0: roll, unless pitch would change more than `PITCH_FIRST` times as far.

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
    by_pitch = PITCH_FIRST * of_pitch >= of_roll
    if max(of_pitch, of_roll) < _LEAST_PART:
        raise ValueError(f'"{surface.name}" tilts about one axis alone by its angles; give it another yaw or pitch')
    change = np.zeros(2)
    for _ in range(_STEPS):
        turned = (yaw + change[0], pitch + change[1] * by_pitch, roll + change[1] * (not by_pitch))
        normal, by_yaw, *others = _normal_and_slopes(*turned)
        if float(np.abs(wanted - normal).max()) < _ENOUGH:
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


_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """Surfaces, ranges and shares of each pixel. The layers of a pixel run from near to far.

    Parameters
    ----------
    n_modes : (row, col) uint8
        Surfaces in the beam.
    range_true : (row, col, layer) float32
        Mean range of each surface's sub-beams, mm; NaN past `n_modes`.
    weight_true : (row, col, layer) float32
        p(c_i): area share times 1 - p(c_r), effects' outliers included; NaN past `n_modes`.
    weight_no_return : (row, col) float32
        p(c_0): share of the sub-beams that meet nothing, times 1 - p(c_r).
    surface : (row, col, layer) int16
        Number of the surface in the model, from 0; -1 past `n_modes`.
    amplitude : (row, col, layer) float32
        Amplitude of a sample of each surface; 0 past `n_modes`.
    """

    n_modes: ByteArray
    range_true: Float32Array
    weight_true: Float32Array
    weight_no_return: Float32Array
    surface: NDArray[np.int16]
    amplitude: Float32Array

    def padded(self, layers: int) -> Self:
        """The same with room for `layers` surfaces a pixel, at least as many as it has."""
        more = layers - self.range_true.shape[2]

        def pad(values: NDArray[_T], padding: float) -> NDArray[_T]:
            return np.pad(values, ((0, 0), (0, 0), (0, more)), constant_values=padding)

        return replace(
            self,
            range_true=pad(self.range_true, np.nan),
            weight_true=pad(self.weight_true, np.nan),
            surface=pad(self.surface, -1),
            amplitude=pad(self.amplitude, 0.0),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSettings:
    """How many frames, how fast, and from which seed.

    Parameters
    ----------
    frames : int
        Number of frames, at least 1.
    frame_rate_hz : float
        Frames a second, above 0.
    seed : int
        Seed of every random draw, at least 0.

    Raises
    ------
    ValueError
        If a number is outside its bounds. The message begins with the key.
    """

    frames: int = 100
    frame_rate_hz: float = 25.0
    seed: int = 1

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise ValueError(f"frames: {self.frames} is not at least 1")
        if not (math.isfinite(self.frame_rate_hz) and self.frame_rate_hz > 0):
            raise ValueError(f"frame_rate_hz: {self.frame_rate_hz:g} is not a finite number above 0")
        if self.seed < 0:
            raise ValueError(f"seed: {self.seed} is not at least 0")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Model:
    """A scene and the camera that records it.

    Parameters
    ----------
    sensor : CompleteCamera
        The camera, at the integration time of one sample.
    surfaces : tuple of Surface
        The scene; it may be empty, and then no pixel has a return.
    recording : RecordingSettings
        Frames, frame rate, seed.
    text : str
        The model file's text; empty if there is none.
    effects : tuple of Effect
        Effects of the camera beyond equation (1), in file order.

    Raises
    ------
    ValueError
        If two surfaces have one name, an effect does not fit camera or scene, or a kind is there twice without
        another surface.
    """

    sensor: CompleteCamera
    surfaces: tuple[Surface, ...] = ()
    recording: RecordingSettings = RecordingSettings()
    text: str = ""
    effects: "tuple[Effect, ...]" = ()

    def __post_init__(self) -> None:
        names = [surface.name for surface in self.surfaces]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise ValueError(f'surfaces {names.index(name) + 1} and {k + 1} are both named "{name}"')
        self._check_effects(tuple(names))
        most = float(np.max(self.outlier_share))
        if self.sensor.noise.background is not None and most >= 1.0:
            raise ValueError(f"[sensor.noise]: background: with all other random values it is {most:g}, not below 1")

    def _check_effects(self, names: tuple[str, ...]) -> None:
        seen: dict[tuple[str, str], int] = {}
        for number, effect in enumerate(self.effects, 1):
            try:
                effect.check(self.sensor, names)
            except ValueError as error:
                raise ValueError(f"[[effect]] {number}: {error}") from None
            surface = getattr(effect, "surface", "")
            if first := seen.get((effect.kind, surface)):
                where = f' of "{surface}"' if surface else ""
                raise ValueError(
                    f"[[effect]] {number}: kind: {effect.kind}{where} is [[effect]] {first} already; "
                    "a kind may be there twice only with another surface"
                )
            seen[effect.kind, surface] = number

    def acting(self) -> "tuple[Effect, ...]":
        """The effects in the order in which they act: by level, then as in the file."""
        return tuple(sorted(self.effects, key=lambda effect: effect.level))

    @property
    def outlier_share(self) -> float | FloatArray:
        """Probability of a random value: the sensor's and that of effects; (row, col) with a background."""
        return self.sensor.random_share + sum(effect.outlier_share for effect in self.effects)

    @property
    def moves(self) -> bool:
        """Whether the scene changes from frame to frame."""
        return any(effect.moves for effect in self.effects)

    def moves_surface(self, name: str) -> bool:
        """Whether a surface moves from frame to frame."""
        return any(effect.moves and getattr(effect, "surface", name) == name for effect in self.effects)

    def with_recording(self, *, frames: int | None = None, seed: int | None = None) -> "Model":
        """The model with another number of frames, and another seed, where they are given."""
        given = {name: value for name, value in (("frames", frames), ("seed", seed)) if value is not None}
        return replace(self, recording=replace(self.recording, **given))

    def placed(self, time_s: float) -> "tuple[Surface, ...]":
        """The surfaces where the geometry effects put them at a time.

        Raises
        ------
        BadInputError
            If one leaves the bounds of a model.
        """
        surfaces = self.surfaces
        for effect in self.acting():
            try:
                surfaces = tuple(effect.place(surface, time_s) for surface in surfaces)
            except ValueError as error:
                raise BadInputError(f"[[effect]] {effect.kind}: at {time_s:g} s: {error}") from None
        return surfaces
