"""The fine range image: each part of a pixel gets its nearest surface. Compiled."""

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.surfaces.found import NO_SURFACE
from tofmix.surfaces.regions import inside
from tofmix.surfaces.smooth_fits import Shapes, inverse_of


@jit
def paint_row(
    row: int,
    factor: int,
    regions: FloatArray,
    first_cut: NDArray[np.int32],
    next_cut: NDArray[np.int32],
    count: NDArray[np.int32],
    labels: NDArray[np.int32],
    inverses: FloatArray,
    planes: Shapes,
    directions: FloatArray,
    fine: FloatArray,
    items: NDArray[np.int32],
    smooth: FloatArray,
    range_fine: NDArray[np.float32],
    surface_fine: NDArray[np.int32],
    most_off: float,
) -> None:
    """Paint one row of pixels, from the nearest surface to the farthest.

    Parameters
    ----------
    row, factor : int
        The image row; parts along each side of a pixel.
    regions, first_cut, next_cut
        Area of each surface, as for `choose_regions`; a pixel's cuts are near to far.
    count, labels, inverses
        Of `Shares`.
    planes : Shapes
        Of the surfaces.
    directions : (row, col, 3) float64
        Unit vectors through the centres of pixels.
    fine : (factor, cols * factor, 3) float64
        Unit vectors through the centres of the row's parts.
    items : (smooth surface, col) int32
        Row of `smooth` of each smooth surface in the pixels of this row; -1: not known.
    smooth : (item, factor * factor) float64
        1 / r of smooth surfaces in the parts of a pixel; 0: the part misses it.
    range_fine, surface_fine : (factor, cols * factor)
        Filled: mm, NaN where there is no return or nothing is known; and the surface.
    most_off : float
        Relative distance of a layer from its surface's plane beyond which its own range is taken.
    """
    for col in range(count.shape[1]):
        entries = count[row, col]
        for part in range(factor * factor):
            i, j = part // factor, part % factor
            v = (j + 0.5) / factor - 0.5
            u = (i + 0.5) / factor - 0.5
            j += col * factor
            range_fine[i, j], surface_fine[i, j] = np.nan, NO_SURFACE
            if entries == 0:
                continue
            entry, cut = 0, first_cut[row, col]
            while cut >= 0 and entry < entries - 1 and not inside(regions[cut], u, v):
                entry += 1
                cut = next_cut[cut]
            label = labels[row, col, entry]
            if label == NO_SURFACE:
                continue
            own = inverses[row, col, entry]
            there, centre = 0.0, inverse_of(planes, label, row, col, directions)
            bent = planes.smooth[label]
            if bent < 0:
                for k in range(3):
                    there += planes.planes[label, k] * fine[i, j, k]
            elif items[bent, col] >= 0:
                there = smooth[items[bent, col], part]
            if there <= 0.0 or abs(centre - own) > most_off * own:
                there = own
            range_fine[i, j], surface_fine[i, j] = 1.0 / there, label


@jit
def share_out(
    factor: int, silent: NDArray[np.bool_], range_fine: NDArray[np.float32], surface_fine: NDArray[np.int32]
) -> None:
    """Divide unknown pixels with samples among the surfaces of their known neighbours.

    Each part gets the surface of the nearest part across the pixel's border, if that pixel is known. A pixel's surfaces
    are those of its neighbours; the edge between them is not known.

    Parameters
    ----------
    factor : int
        Parts along each side of a pixel.
    silent : (row, col) bool
        The pixels; parts that are painted already stay.
    range_fine, surface_fine : (row * factor, col * factor)
        Changed.
    """
    rows, cols = silent.shape
    for row in range(rows):
        for col in range(cols):
            if not silent[row, col]:
                continue
            top, left = row * factor, col * factor
            for i in range(factor):
                for j in range(factor):
                    if surface_fine[top + i, left + j] != NO_SURFACE:
                        continue
                    nearest, r, c = factor + 1, -1, -1
                    if row > 0 and not silent[row - 1, col] and i + 1 < nearest:
                        nearest, r, c = i + 1, top - 1, left + j
                    if row + 1 < rows and not silent[row + 1, col] and factor - i < nearest:
                        nearest, r, c = factor - i, top + factor, left + j
                    if col > 0 and not silent[row, col - 1] and j + 1 < nearest:
                        nearest, r, c = j + 1, top + i, left - 1
                    if col + 1 < cols and not silent[row, col + 1] and factor - j < nearest:
                        nearest, r, c = factor - j, top + i, left + factor
                    if r >= 0:
                        range_fine[top + i, left + j] = range_fine[r, c]
                        surface_fine[top + i, left + j] = surface_fine[r, c]
