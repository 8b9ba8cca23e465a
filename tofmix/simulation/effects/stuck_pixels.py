"""Pixels that always return one value."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import FrameSamples
from tofmix.simulation.effects.base import Context, Effect, EffectTruth, Latent, Level, Target
from tofmix.simulation.effects.hidden import HiddenState, PixelValue
from tofmix.simulation.effects.parameter import PixelMap, UniformPrior, number, pixel_map
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.simulation.distribution import Prediction

_HIGHEST_MM = 65_534  # the largest range that a recording stores


@dataclass(frozen=True, slots=True, kw_only=True)
class StuckPixels(Effect):
    """Some pixels always return one value: a share drawn once a recording, or the pixels of a map.

    The cause is a defect of the chip: a pixel that its dark current saturates, or that does not work. Makers accept
    some 0.01 to 0.1 %. No other effect, including dropout, changes the value of a stuck pixel.
    """

    kind: ClassVar[str] = "stuck_pixels"
    level: ClassVar[Level] = Level.READ_OUT
    signature: ClassVar[str] = "pixels without any spread"
    typical: ClassVar[str] = "0.01 to 0.1 % of the pixels"
    basis: ClassVar[str] = "assumed"
    target: ClassVar[Target] = Target.VALUES
    latent: ClassVar[Latent] = Latent.PIXEL
    hidden: ClassVar[HiddenState | None] = PixelValue()
    exact_law: ClassVar[bool] = True
    predicts: ClassVar[str] = (
        "exact for the map, or for the pixels that the seed draws; over all draws a pixel is stuck or not"
    )

    share: float = number(
        "Share of the pixels.",
        unit="1",
        low=0,
        high=1,
        default=0,
        zero=0,
        typical=(1e-4, 0.01),
        prior=UniformPrior(low=0, high=1),
    )
    value_mm: float = number("What they return.", unit="mm", low=1, high=_HIGHEST_MM, default=1)
    map: PixelMap | None = pixel_map(  # noqa: RUF009
        "Value of each stuck pixel, NaN for working pixels; replaces the other parameters."
    )

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:
        """Refuse values that a recording cannot store."""
        Effect.check(self, sensor, surfaces)
        if self.map is not None:
            stuck = self.map.values[~np.isnan(self.map.values)]
            bad = stuck[(stuck < 1) | (stuck > _HIGHEST_MM)]
            if bad.size:
                raise ValueError(f"map: {bad[0]:g} mm is not in [1, {_HIGHEST_MM}]")

    def explain(self) -> str:
        """One sentence."""
        if self.map is not None:
            return f"the pixels in {self.map.path or 'a map'} always return one value"
        return f"{100 * self.share:g} % of the pixels always return {self.value_mm:g} mm"

    def size_of_map(self) -> str:
        """How many pixels are stuck."""
        return "" if self.map is None else counted(int(np.isfinite(self.map.values).sum()), "pixel")

    def prepare(self, context: Context, n_frames: int) -> FloatArray:  # noqa: ARG002
        """The values (pixel,) of stuck pixels, mm; NaN where the pixel works."""
        if self.map is not None:
            return self.map.values.ravel().astype(np.float64)
        drawn = context.recording_rng(self).random(context.sensor.rows * context.sensor.cols)
        return np.where(drawn < self.share, self.value_mm, np.nan)

    def truth(self, prepared: Any) -> tuple[EffectTruth, ...]:  # noqa: ANN401
        """The map."""
        values = prepared.astype(np.float32)
        name = "value of stuck pixels"
        return (EffectTruth(name=self.kind, dims=("row", "col"), values=values, unit="mm", long_name=name),)

    def sample(self, samples: FrameSamples, context: Context) -> None:
        """Replace the samples of stuck pixels."""
        stuck = ~np.isnan(context.prepared)
        samples.measured_mm = np.where(stuck, context.prepared, samples.measured_mm)
        samples.stuck = samples.stuck | stuck

    def predict(self, prediction: "Prediction", context: Context) -> None:
        """One value."""
        prediction.stuck_mm = np.where(np.isnan(context.prepared), prediction.stuck_mm, context.prepared)
