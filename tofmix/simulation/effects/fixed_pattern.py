"""A constant bias of each pixel, column and row."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.echoes import Echoes
from tofmix.simulation.effects.base import Context, Effect, EffectTruth, Latent, Level, Target, truth_of_bias
from tofmix.simulation.effects.hidden import HiddenState, PixelBias
from tofmix.simulation.effects.parameter import PixelMap, StudentPrior, number, pixel_map


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedPattern(Effect):
    """Each pixel has a constant bias: the sum of a pixel, a column and a row bias from the seed, or a map.

    Clock lines reach pixels after different delays, column by column, and capacitances differ from pixel to pixel. Some
    mm are reported after the factory's calibration, some cm without. The pattern is drawn from the recording's seed. A
    map is independent of the seed, like the pattern of a real camera.

    References
    ----------
    Kahlmann, Remondino and Ingensand, ISPRS Archives XXXVI-5, 2006: "fixed pattern noise".
    """

    kind: ClassVar[str] = "fixed_pattern"
    level: ClassVar[Level] = Level.RANGE
    signature: ClassVar[str] = "bias pixel by pixel, the same in every frame; stripes for columns and rows"
    typical: ClassVar[str] = "some mm after the factory's calibration, some cm without"
    basis: ClassVar[str] = "reported"
    target: ClassVar[Target] = Target.BIAS
    shows_in: ClassVar[tuple[str, ...]] = ("bias", "pattern")
    latent: ClassVar[Latent] = Latent.PIXEL
    hidden: ClassVar[HiddenState | None] = PixelBias(("pixel_sigma_mm", "column_sigma_mm", "row_sigma_mm"))
    predicts: ClassVar[str] = (
        "exact for the map, or for the pattern that the seed draws; over all patterns a random effect that pixels of"
        " one column or row share"
    )
    separated_from: ClassVar[Mapping[str, str]] = {
        "range_offset": "another scene: the pattern stays with its pixels",
    }

    pixel_sigma_mm: float = number(
        "Spread from pixel to pixel.",
        unit="mm",
        low=0,
        high=1000,
        default=0,
        zero=0,
        typical=(1, 20),
        prior=StudentPrior(scale=10, dof=3, half=True),
    )
    column_sigma_mm: float = number(
        "Spread from column to column.",
        unit="mm",
        low=0,
        high=1000,
        default=0,
        zero=0,
        typical=(0.5, 10),
        prior=StudentPrior(scale=5, dof=3, half=True),
    )
    row_sigma_mm: float = number(
        "Spread from row to row.",
        unit="mm",
        low=0,
        high=1000,
        default=0,
        zero=0,
        typical=(0.5, 10),
        prior=StudentPrior(scale=5, dof=3, half=True),
    )
    map: PixelMap | None = pixel_map(  # noqa: RUF009
        "Bias of each pixel; replaces the drawn biases."
    )

    def check(self, sensor: CompleteCamera, surfaces: tuple[str, ...]) -> None:
        """Refuse a map that has no value somewhere."""
        Effect.check(self, sensor, surfaces)
        if self.map is not None and not np.isfinite(self.map.values).all():
            raise ValueError("map: a value is not finite; every pixel needs one")

    def explain(self) -> str:
        """One sentence."""
        if self.map is not None:
            return f"each pixel has a constant bias of its own, from {self.map.path or 'a map'}"
        return (
            "each pixel has a constant bias of its own, with standard deviations of "
            f"{self.pixel_sigma_mm:g} mm by pixel, {self.column_sigma_mm:g} mm by column and {self.row_sigma_mm:g} mm "
            "by row"
        )

    def size_of_map(self) -> str:
        """Its root mean square; pixels without a return have 0 in it, and do not count."""
        if self.map is None:
            return ""
        known = self.map.values[self.map.values != 0].astype(np.float64)
        return f"{np.sqrt((known**2).mean()):.3g} mm rms" if known.size else ""

    def prepare(self, context: Context, n_frames: int) -> FloatArray:  # noqa: ARG002
        """The biases (pixel,), mm."""
        if self.map is not None:
            return self.map.values.ravel().astype(np.float64)
        rng, rows, cols = context.recording_rng(self), context.sensor.rows, context.sensor.cols
        bias = rng.standard_normal((rows, cols)) * self.pixel_sigma_mm
        bias += rng.standard_normal(cols) * self.column_sigma_mm
        bias += rng.standard_normal((rows, 1)) * self.row_sigma_mm
        return bias.ravel()

    def truth(self, prepared: Any) -> tuple[EffectTruth, ...]:  # noqa: ANN401
        """The map."""
        return truth_of_bias(self.kind, prepared)

    def act(self, echoes: Echoes, context: Context) -> None:
        """Add each pixel's bias."""
        echoes.add_bias(context.prepared)
