"""Surfaces of every pixel of a scene: the truth of a recording, from which samples are drawn."""

from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import ByteArray, Float32Array, FloatArray

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
    width : (row, col, layer) float64 or None
        Factor on sigma(r) of each surface's samples, of a measured scene; None: sigma is the camera's.
    lost : (row, col) float64 or None
        Share of the samples of each pixel that are lost, of a measured scene; None: none is.
    """

    n_modes: ByteArray
    range_true: Float32Array
    weight_true: Float32Array
    weight_no_return: Float32Array
    surface: NDArray[np.int16]
    amplitude: Float32Array
    width: FloatArray | None = None
    lost: FloatArray | None = None

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
            width=None if self.width is None else pad(self.width, 1.0),
        )
