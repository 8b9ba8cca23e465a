"""The model of a simulation: a camera, flat rectangles before it, and the recording.

Use these types to build a scene in code. A model file is read by `tofmix.simulation.model_toml`;
`tofmix.simulation.casting.cast` computes the surfaces in each pixel of a model.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tofmix.arrays import BoolArray, FloatArray
from tofmix.errors import BadInputError
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.measured_scene import MeasuredScene
from tofmix.simulation.surface import Surface

if TYPE_CHECKING:
    from tofmix.simulation.effects.base import Effect


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
    scene : MeasuredScene, optional
        What a recording saw, in place of rectangles; `surfaces` are then the planes of its surfaces, in its order.

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
    scene: MeasuredScene | None = None

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

    @property
    def seen(self) -> BoolArray:
        """Pixels (row, col) of which the scene predicts any sample: all of rectangles, others of a measured scene."""
        return np.ones(self.sensor.shape, dtype=np.bool_) if self.scene is None else self.scene.lost < 1.0

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
