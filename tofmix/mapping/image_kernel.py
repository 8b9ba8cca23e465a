"""The kernel of the map for images of any projection: `tofmix.mapping.kernel` with rays from the image's nodes.

It validates nothing; call `tofmix.mapping.occupancy.count_light`.
"""

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.mapping.kernel import look, meets, sampled
from tofmix.optics.cells import fill_patch, patch_direction


@jit
def _look_at_cell(
    outline: FloatArray,
    nodes: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rotation: FloatArray,
    near: FloatArray,
    far: FloatArray,
    clear: FloatArray,
    samples: FloatArray,
    probability: FloatArray,
    no_return: FloatArray,
    lost: FloatArray,
    free_to: float,
    patch: FloatArray,
    work: FloatArray,
    light: FloatArray,
) -> None:
    """Sum the light of all pixels that see the cell, weighted by the part of the pixel's image area in the cell."""
    rows, cols = no_return.shape
    left = outline[0]
    right = outline[1]
    top = outline[2]
    bottom = outline[3]
    first_col, last_col, across = sampled(left, right, cols)
    first_row, last_row, down = sampled(top, bottom, rows)
    direction = work[:3]
    span = work[3:5]
    ray = work[5:]
    for row in range(first_row, last_row):
        y0 = max(top, float(row))
        dy = (min(bottom, row + 1.0) - y0) / down
        for col in range(first_col, last_col):
            x0 = max(left, float(col))
            dx = (min(right, col + 1.0) - x0) / across
            fill_patch(nodes[2 * row : 2 * row + 3], 2 * col, patch)
            for j in range(down):
                v = y0 + (j + 0.5) * dy - row
                for i in range(across):
                    patch_direction(patch, x0 + (i + 0.5) * dx - col, v, ray)
                    for axis in range(3):
                        direction[axis] = (
                            rotation[axis, 0] * ray[0] + rotation[axis, 1] * ray[1] + rotation[axis, 2] * ray[2]
                        )
                    if meets(direction, low, high, span):
                        look(
                            row,
                            col,
                            dx * dy,
                            span,
                            near,
                            far,
                            clear,
                            samples,
                            probability,
                            no_return,
                            lost,
                            free_to,
                            light,
                        )


@jit
def count_cells(
    lows: FloatArray,
    outlines: FloatArray,
    nodes: FloatArray,
    cell: float,
    reach: float,
    rotation: FloatArray,
    near: FloatArray,
    far: FloatArray,
    clear: FloatArray,
    samples: FloatArray,
    probability: FloatArray,
    no_return: FloatArray,
    lost: FloatArray,
    free_to: float,
    out: FloatArray,
) -> None:
    """Count the light in some cells of a grid.

    Parameters
    ----------
    lows : (n, 3) float64
        Least x, y and z of the cells relative to the camera, mm, along the map's axes.
    outlines : (n, 4) float64
        From `tofmix.mapping.outline.cell_outlines`.
    nodes : (2 rows + 1, 2 cols + 1, 3) float64
        From `tofmix.mapping.outline.image_nodes`.
    cell, reach, rotation, near, far, clear, samples, probability, no_return, lost, free_to
        As for `tofmix.mapping.kernel.count_levels`.
    out : (n, 4) float64
        Zeros; receives samples that stopped, samples that passed, the probability of the surest stop, and lost samples.
    """
    high = np.empty(3)
    patch = np.empty((3, 3, 3))
    work = np.empty(8)
    for k in range(lows.shape[0]):
        nearest = 0.0
        for axis in range(3):
            high[axis] = lows[k, axis] + cell
            nearest += max(lows[k, axis], -high[axis], 0.0) ** 2
        if nearest <= reach * reach and outlines[k, 0] < outlines[k, 1]:
            _look_at_cell(
                outlines[k],
                nodes,
                lows[k],
                high,
                rotation,
                near,
                far,
                clear,
                samples,
                probability,
                no_return,
                lost,
                free_to,
                patch,
                work,
                out[k],
            )
