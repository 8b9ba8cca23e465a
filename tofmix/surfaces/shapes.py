"""Where beams meet the surfaces of a window: planes, and smooth surfaces pixel by pixel."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing


class Shapes(NamedTuple):
    """The surfaces of a window, as kernels take them.

    Parameters
    ----------
    planes : (surface, 3) float64
        m of 1/r = m . d, 1/mm.
    smooth : (surface,) int32
        Place of each surface in `inverse`; -1: a plane.
    inverse : (smooth surface, row, col) float64
        1 / r of each smooth surface, 1/mm: on its own pixels by its fit, elsewhere that of its nearest pixel.
    """

    planes: FloatArray
    smooth: NDArray[np.int32]
    inverse: FloatArray


def flat(planes: FloatArray) -> Shapes:
    """Surfaces that are all planes (surface, 3)."""
    return Shapes(planes, np.full(len(planes), -1, np.int32), np.zeros((0, 1, 1)))


@borrowing
def inverse_of(shapes: Shapes, label: int, row: int, col: int, directions: FloatArray) -> float:
    """1 / r at which the beam of a pixel, of `directions` (row, col, 3), meets a surface; 0 or less: it does not."""
    place = shapes.smooth[label]
    if place >= 0:
        return float(shapes.inverse[place, row, col])
    total = 0.0
    for i in range(3):
        total += shapes.planes[label, i] * directions[row, col, i]
    return total


def inverses_of(
    shapes: Shapes, label: NDArray[np.int32], row: NDArray[np.intp], col: NDArray[np.intp], directions: FloatArray
) -> FloatArray:
    """The same for many surfaces and pixels, arrays (...); any number for a label below 0."""
    if not len(shapes.planes):
        return np.zeros(label.shape)
    values = np.asarray((shapes.planes[label] * directions[row, col]).sum(axis=-1))
    place = shapes.smooth[label]
    bent = place >= 0
    values[bent] = shapes.inverse[place[bent], row[bent], col[bent]]
    return values
