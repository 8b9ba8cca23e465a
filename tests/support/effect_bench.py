"""Two scenes for effects: a slanted wall, whose every pixel sees one surface, and three boards with mixed pixels."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from tofmix.sensor import NoiseCurve
from tofmix.sensors import CompleteCamera, load_profile
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.render import render_blocks
from tofmix.simulation.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Callable

Floats = NDArray[np.float64]

WALL = Surface(name="wall", center_mm=(0, 0, 2500), size_mm=(20_000, 4000), yaw_deg=50, reflectivity=0.7)
BOARDS = (
    Surface(name="near", center_mm=(-490, 0, 2400), size_mm=(1000, 80), pitch_deg=10),
    Surface(name="middle", center_mm=(512, 0, 3600), size_mm=(1000, 100), reflectivity=0.5),
    Surface(name="far", center_mm=(0, -250, 4800), size_mm=(900, 500)),
)


@dataclass(frozen=True)
class Recorded:
    """A recording in memory: ranges (frame, pixel) in mm, NaN where invalid; amplitudes; truth; model."""

    range_mm: Floats
    stored: NDArray[np.uint16]
    amplitude: Floats
    truth: Truth
    model: Model

    @property
    def true_mm(self) -> Floats:
        """Range (pixel,) of the first surface of each pixel."""
        return self.truth.range_true[..., 0].ravel().astype(np.float64)

    @property
    def true_amplitude(self) -> Floats:
        """Amplitude (pixel,) of the first surface of each pixel."""
        return self.truth.amplitude[..., 0].ravel().astype(np.float64)

    def sigma(self, range_mm: Floats) -> Floats:
        """The sensor's sigma(r)."""
        return self.model.sensor.noise.sigma(range_mm)


def effect(kind: str, **parameters: object) -> Effect:
    make: Callable[..., Effect] = EFFECTS[kind]
    return make(**parameters)


@contextmanager
def light_alone() -> Iterator[None]:
    """Recordings whose amplitudes have no noise, so that they tell which surface a sample is of."""

    def none(pixels: int, **_: int) -> Floats:
        return np.zeros(pixels)

    names = (f"tofmix.simulation.{module}.amplitude_draws" for module in ("render", "exposure"))
    first, second = (patch(name, none) for name in names)
    with first, second:
        yield


class Bench:
    """Records the two scenes with effects; amplitudes are those of the light, without noise."""

    def __init__(self) -> None:
        self._casts: dict[str, Truth] = {}
        base = replace(load_profile("sr3000"), integration_time_ms=1.2, reference_integration_time_ms=1.2)
        self.wall_sensor: CompleteCamera = replace(
            base,
            rows=6,
            cols=40,
            fov_horizontal_deg=50.0,
            fov_vertical_deg=8.0,
            outlier_probability=0.0,
            noise=NoiseCurve(np.array([1000.0, 8000.0]), np.array([4.0, 60.0])),
        )
        self.boards_sensor: CompleteCamera = replace(
            base,
            rows=9,
            cols=11,
            fov_vertical_deg=39.0 * 9 / 144,
            fov_horizontal_deg=47.0 * 11 / 176,
            noise=base.noise_at(1.2),
            outlier_probability=0.02,
        )

    def wall(self, *effects: Effect, frames: int = 20, seed: int = 3, **sensor: Any) -> Recorded:  # noqa: ANN401  fields of a CompleteCamera
        """The slanted wall: 1.8 to 6.2 m, one surface a pixel, no random values."""
        return self._record(replace(self.wall_sensor, **sensor), (WALL,), effects, frames, seed)

    def boards(self, *effects: Effect, frames: int = 20, seed: int = 3, **sensor: Any) -> Recorded:  # noqa: ANN401  fields of a CompleteCamera
        """Three boards: one to three surfaces a pixel, gaps, and one random value in 50 samples."""
        return self._record(replace(self.boards_sensor, **sensor), BOARDS, effects, frames, seed)

    def _cast(self, model: Model) -> Truth:
        """What the pixels see: cast once for all effects that leave it as it is."""
        if model.moves:
            return cast_scene(model)
        key = repr((model.sensor, model.placed(0.0), model.outlier_share))
        if key not in self._casts:
            self._casts[key] = cast_scene(model)
        return self._casts[key]

    def _record(
        self, sensor: CompleteCamera, surfaces: tuple[Surface, ...], effects: tuple[Effect, ...], frames: int, seed: int
    ) -> Recorded:
        recording = RecordingSettings(frames=frames, seed=seed, frame_rate_hz=10.0)
        model = Model(sensor=sensor, surfaces=surfaces, effects=effects, recording=recording)
        truth = self._cast(model)
        with light_alone():
            block = next(render_blocks(model, truth, n_frames=frames, seed=seed, block_frames=frames))
        stored = block.range_mm.reshape(frames, -1)
        return Recorded(
            range_mm=np.where(stored > 0, stored, np.nan),
            stored=stored,
            amplitude=block.amplitude.reshape(frames, -1).astype(np.float64),
            truth=truth,
            model=model,
        )


def neutral_values(kind: type[Effect]) -> dict[str, float]:
    """Each parameter at which an effect vanishes, with that value."""
    return {name: p.zero for name, p in kind.parameters().items() if p.zero is not None}
