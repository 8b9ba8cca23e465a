"""What is simulated: a camera, flat rectangles before it, and how it records.

Use these types to build a scene in code. A model file is read by
`tofmix.simulation.model_toml`; what a pixel sees of a model is worked out by
`tofmix.simulation.cast`.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.sensors.profile import SensorProfile

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
    yaw_deg, pitch_deg : float
        Right-handed rotation about y, then about x, degrees.
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
    reflectivity: float = 0.8

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError("name: it is empty")
        if not all(abs(x) <= MAX_LENGTH_MM for x in self.center_mm):
            raise ValueError(f"center_mm: {list(self.center_mm)} are not all within +-{MAX_LENGTH_MM:g}")
        if not all(0 < x <= MAX_LENGTH_MM for x in self.size_mm):
            raise ValueError(f"size_mm: {list(self.size_mm)} are not both above 0 and up to {MAX_LENGTH_MM:g}")
        for key in ("yaw_deg", "pitch_deg"):
            if not math.isfinite(getattr(self, key)):
                raise ValueError(f"{key}: {getattr(self, key)} is not finite")
        if not 0 <= self.reflectivity <= 1:
            raise ValueError(f"reflectivity: {self.reflectivity:g} is not in [0, 1]")

    def rotation(self) -> FloatArray:
        """R (3, 3): its columns are the rectangle's u, v and normal axes in the sensor's frame."""
        yaw, pitch = math.radians(self.yaw_deg), math.radians(self.pitch_deg)
        about_y = np.array([[math.cos(yaw), 0.0, math.sin(yaw)], [0.0, 1.0, 0.0], [-math.sin(yaw), 0.0, math.cos(yaw)]])
        about_x = np.array(
            [[1.0, 0.0, 0.0], [0.0, math.cos(pitch), -math.sin(pitch)], [0.0, math.sin(pitch), math.cos(pitch)]]
        )
        rotation: FloatArray = about_x @ about_y
        return rotation


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
    sensor : SensorProfile
        The camera, at the integration time of one sample.
    surfaces : tuple of Surface
        The scene; none is legal and returns nothing anywhere.
    recording : RecordingSettings
        Frames, frame rate, seed.
    text : str
        The model file's text; empty if there is none.
    effects : tuple of Effect
        What the camera does beyond equation (1), in file order.

    Raises
    ------
    ValueError
        If two surfaces have one name, an effect does not fit camera or scene, or a kind is there twice without
        another surface.
    """

    sensor: SensorProfile
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
        """Probability of a random value: the sensor's and what effects add; (row, col) where there is a background."""
        return self.sensor.random_share + sum(effect.outlier_share for effect in self.effects)

    @property
    def moves(self) -> bool:
        """Whether the scene changes from frame to frame."""
        return any(effect.moves for effect in self.effects)

    def moves_surface(self, name: str) -> bool:
        """Whether a surface may stand elsewhere from frame to frame."""
        return any(effect.moves and getattr(effect, "surface", name) == name for effect in self.effects)

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
