"""The shares of surfaces in a pixel where the model has the surfaces a little off.

A surface that is moved along its normal has its edges elsewhere in the image. So pixels that several surfaces share
have other shares, and some see through a gap between two surfaces that touch in the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.simulation.casting.polygon_cast import PolygonCaster
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """The scene of one recording, to be cast with its surfaces moved. Use `Edges.of`.

    Parameters
    ----------
    model : Model
        The model.
    surface : (component, n) int64
        The surface of each component; -1 for none, as of what meets no surface.
    """

    model: Model
    surface: IntArray
    _pixels: IntArray
    _caster: PolygonCaster
    _given: FloatArray  # (component, n), shares
    _normal_per_range: FloatArray  # (surface,), shift along its normal for 1 mm of range in the median pixel

    @classmethod
    def of(cls, model: Model, pixels: IntArray, alone: Sequence[BoolArray]) -> "Edges":
        """Cast the model as it is.

        Parameters
        ----------
        model : Model
            Of rectangles.
        pixels : (n,) int64
            The pixels that surfaces share.
        alone : sequence of (pixel,) bool
            The pixels that see each surface alone.
        """
        caster = PolygonCaster(model.sensor)
        seen = caster.cast(_bare(model, model.surfaces))
        layers = seen.surface.shape[2]
        surface = np.concatenate([seen.surface.reshape(-1, layers)[pixels].T, np.full((1, pixels.size), -1)])
        slopes = [_slope(seen, s, alone[number], number) for number, s in enumerate(model.surfaces)]
        return cls(model, surface.astype(np.int64), pixels, caster, _shares(seen, pixels, surface), np.array(slopes))

    def change(self, shift_mm: FloatArray) -> FloatArray:
        """Changes of the shares (component, n) where the ranges of each surface (surface,) change by so much, mm."""
        normal_mm = shift_mm * self._normal_per_range
        if not normal_mm.any():
            return np.zeros(self._given.shape)
        moved = tuple(s.shifted(float(d)) for s, d in zip(self.model.surfaces, normal_mm, strict=True))
        return _shares(self._caster.cast(_bare(self.model, moved)), self._pixels, self.surface) - self._given


def _bare(model: Model, surfaces: tuple[Surface, ...]) -> Model:
    return Model(sensor=model.sensor, surfaces=surfaces)


def _shares(seen: Truth, pixels: IntArray, surface: IntArray) -> FloatArray:
    """Shares (component, n) of the surfaces of some components; the last component is that without a return."""
    layers = seen.surface.shape[2]
    own = seen.surface.reshape(-1, layers)[pixels]
    share = np.nan_to_num(seen.weight_true.reshape(-1, layers)[pixels].astype(np.float64))
    out = np.zeros(surface.shape)
    for layer in range(layers):
        out += np.where((surface == own[:, layer]) & (surface >= 0), share[:, layer], 0.0)
    out[-1] = seen.weight_no_return.ravel()[pixels]
    return out


def _slope(seen: Truth, surface: Surface, alone: BoolArray, number: int) -> float:
    """Shift along a surface's normal, mm, for 1 mm of range in the median pixel that sees it alone; 0 for none."""
    ranges = seen.range_true[..., 0].ravel()[alone & (seen.surface[..., 0].ravel() == number)]
    return surface.plane_distance_mm / float(np.median(ranges)) if ranges.size else 0.0
