"""What every pixel of a scene sees: the truth that a recording carries and that samples are drawn from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import ByteArray, Float32Array


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
