"""The kernel of the map: how many samples stop in each cell, and how many pass through it.

It validates nothing; call `tofmix.mapping.occupancy.count_light`. Here pixels have equal angles;
`_look_at_image_cell` is for other projections.

It goes cell by cell, not beam by beam: a near cell is covered by many pixels, a far one by part of one, and each
pixel's samples are divided among the cells of a range by area. So a sample counts once at each range, however fine or
coarse the cells, and the result does not depend on any order.

For images of any projection the rays are those of the image's nodes.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import jit
from tofmix.optics.cells import fill_patch, patch_direction


class SeenLight(NamedTuple):
    """The samples of all pixels, as `tofmix.mapping.beams.Beams` has them, for kernels."""

    near: FloatArray  # (row, col, layer) float64, as are the next four
    far: FloatArray
    clear: FloatArray  # `Beams.clear_to_mm`
    samples: FloatArray
    probability: FloatArray  # `Beams.probability_within` a cell
    no_return: FloatArray  # (row, col) float64
    lost: FloatArray  # (row, col) float64
    free_to: float  # mm


@jit
def meets(direction: FloatArray, low: FloatArray, high: FloatArray, span: FloatArray) -> bool:
    """Whether a ray from the origin meets the box; `span` receives the ranges where it enters and leaves."""
    enter = 0.0
    leave = math.inf
    for axis in range(3):
        d = direction[axis]
        if d == 0.0:
            if low[axis] > 0.0 or high[axis] <= 0.0:
                return False
            continue
        a = low[axis] / d
        b = high[axis] / d
        enter = max(enter, min(a, b))
        leave = min(leave, max(a, b))
    span[0] = enter
    span[1] = leave
    return leave > enter


@jit
def look(
    row: int,
    col: int,
    part: float,
    span: FloatArray,
    seen: SeenLight,
    light: FloatArray,
) -> None:
    """Add a part of one pixel's samples to a cell's `light`: stopped, passed, surest stop, and lost anywhere."""
    for layer in range(seen.near.shape[2]):
        if seen.clear[row, col, layer] > span[1]:
            light[1] += part * seen.samples[row, col, layer]
        elif seen.near[row, col, layer] <= span[1] and seen.far[row, col, layer] >= span[0]:
            stopped = part * seen.samples[row, col, layer]
            light[0] += stopped
            if stopped > 0.0:
                light[2] = max(light[2], seen.probability[row, col, layer])
    if span[1] <= seen.free_to:
        light[1] += part * seen.no_return[row, col]
    light[3] += part * seen.lost[row, col]


@jit
def _outline(low: FloatArray, high: FloatArray, rotation: FloatArray, angles: FloatArray) -> bool:
    """Least and greatest azimuth, then elevation, of a box, into `angles`; false where the camera is in or at it."""
    x = y = z = 0.0
    size = 0.0
    for axis in range(3):
        middle = 0.5 * (low[axis] + high[axis])
        x += rotation[axis, 0] * middle
        y += rotation[axis, 1] * middle
        z += rotation[axis, 2] * middle
        size += (high[axis] - low[axis]) ** 2
    if x * x + z * z <= 0.25 * size:
        return False
    centre = math.atan2(x, z)
    angles[0] = angles[2] = math.inf
    angles[1] = angles[3] = -math.inf
    for corner in range(8):
        x = y = z = 0.0
        for axis in range(3):
            value = high[axis] if (corner >> axis) & 1 else low[axis]
            x += rotation[axis, 0] * value
            y += rotation[axis, 1] * value
            z += rotation[axis, 2] * value
        turn = math.atan2(x, z) - centre
        azimuth = centre + turn - 2.0 * math.pi * round(turn / (2.0 * math.pi))
        elevation = math.atan2(y, math.hypot(x, z))
        angles[0] = min(angles[0], azimuth)
        angles[1] = max(angles[1], azimuth)
        angles[2] = min(angles[2], elevation)
        angles[3] = max(angles[3], elevation)
    return True


@jit
def sampled(start: float, end: float, n: int) -> tuple[int, int, int]:
    """Of `n` pixels in a row or column, those [first, stop) that an interval meets, and the rays in each of them."""
    first = max(math.floor(start), 0)
    stop = min(math.ceil(end), n)
    # Least rays a side with which a cell is sampled: a small one's outline is then met to about a sixteenth.
    min_rays = 4
    return first, stop, max(1, math.ceil(min_rays / (stop - first))) if first < stop else 0


@jit
def _look_at_cell(
    angles: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rotation: FloatArray,
    width: float,
    height: float,
    seen: SeenLight,
    work: FloatArray,
    light: FloatArray,
) -> None:
    """Sum the light of all pixels that see the cell, weighted by the area of the pixel in the cell."""
    rows, cols = seen.no_return.shape
    left = angles[0] / width + 0.5 * cols
    right = angles[1] / width + 0.5 * cols
    top = angles[2] / height + 0.5 * rows
    bottom = angles[3] / height + 0.5 * rows
    first_col, last_col, across = sampled(left, right, cols)
    first_row, last_row, down = sampled(top, bottom, rows)
    direction = work[:3]
    span = work[3:]
    for row in range(first_row, last_row):
        y0 = max(top, float(row))
        dy = (min(bottom, row + 1.0) - y0) / down
        for col in range(first_col, last_col):
            x0 = max(left, float(col))
            dx = (min(right, col + 1.0) - x0) / across
            for j in range(down):
                el = (y0 + (j + 0.5) * dy - 0.5 * rows) * height
                for i in range(across):
                    az = (x0 + (i + 0.5) * dx - 0.5 * cols) * width
                    for axis in range(3):
                        direction[axis] = (
                            rotation[axis, 0] * math.sin(az) * math.cos(el)
                            + rotation[axis, 1] * math.sin(el)
                            + rotation[axis, 2] * math.cos(az) * math.cos(el)
                        )
                    if meets(direction, low, high, span):
                        look(row, col, dx * dy, span, seen, light)


@jit
def count_levels(
    levels: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    cell: float,
    reach: float,
    rotation: FloatArray,
    width: float,
    height: float,
    seen: SeenLight,
    out: FloatArray,
) -> None:
    """Count the light in some levels of a grid.

    Parameters
    ----------
    levels, xs, ys : (z,), (x,), (y,) float64
        Least z, x and y of the cells relative to the camera, mm, along the map's axes.
    cell, reach : float
        Edge of a cell; the farthest range with information from the beams; mm.
    rotation : (3, 3) float64
        Its columns are the sensor's axes in the map's frame.
    width, height : float
        A pixel's extent in azimuth and elevation, rad.
    seen : SeenLight
        The samples of all pixels.
    out : (z, x, y, 4) float64
        Zeros; receives samples that stopped, samples that passed, the probability of the surest stop, and lost samples.
    """
    low = np.empty(3)
    high = np.empty(3)
    angles = np.empty(4)
    work = np.empty(5)
    for k in range(levels.shape[0]):
        low[2] = levels[k]
        high[2] = low[2] + cell
        for i in range(xs.shape[0]):
            low[0] = xs[i]
            high[0] = low[0] + cell
            for j in range(ys.shape[0]):
                low[1] = ys[j]
                high[1] = low[1] + cell
                nearest = 0.0
                for axis in range(3):
                    nearest += max(low[axis], -high[axis], 0.0) ** 2
                if nearest <= reach * reach and _outline(low, high, rotation, angles):
                    _look_at_cell(angles, low, high, rotation, width, height, seen, work, out[k, i, j])


@jit
def _look_at_image_cell(
    outline: FloatArray,
    nodes: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rotation: FloatArray,
    seen: SeenLight,
    patch: FloatArray,
    work: FloatArray,
    light: FloatArray,
) -> None:
    """Sum the light of all pixels that see the cell, weighted by the part of the pixel's image area in the cell."""
    rows, cols = seen.no_return.shape
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
                        look(row, col, dx * dy, span, seen, light)


@jit
def count_cells(
    lows: FloatArray,
    outlines: FloatArray,
    nodes: FloatArray,
    cell: float,
    reach: float,
    rotation: FloatArray,
    seen: SeenLight,
    out: FloatArray,
) -> None:
    """Count the light in some cells of a grid.

    Parameters
    ----------
    lows : (n, 3) float64
        Least x, y and z of the cells relative to the camera, mm, along the map's axes.
    outlines : (n, 4) float64
        From `tofmix.mapping.grid.cell_outlines`.
    nodes : (2 rows + 1, 2 cols + 1, 3) float64
        From `tofmix.mapping.grid.image_nodes`.
    cell, reach, rotation, seen
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
            _look_at_image_cell(outlines[k], nodes, lows[k], high, rotation, seen, patch, work, out[k])
