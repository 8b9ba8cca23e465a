"""The pixels around an edge: their places in its pixel's plane, and the shares of its surface there. Compiled."""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.compiled.jit import borrowing
from tofmix.compiled.plane import dot
from tofmix.surfaces.edge_shape import (
    ANGLE,
    BACK,
    FLOOR,
    HIDES,
    HIDES_AT,
    HIDES_COL,
    HIDES_ROW,
    OFFSET,
    SAMPLES,
    SHARE,
    X_ROW,
    Y_ROW,
    X,
    Y,
)
from tofmix.surfaces.shapes import Shapes, inverse_of


@borrowing
def share_of(
    label: int,
    row: int,
    col: int,
    count: NDArray[np.int32],
    labels: NDArray[np.int32],
    inverses: FloatArray,
    up_to: FloatArray,
    planes: Shapes,
    directions: FloatArray,
) -> float:
    """Share (0 to 1) that a surface and all nearer ones have in a pixel; -1 if unknown.

    In a pixel without the surface the share is 0 if all its surfaces are farther than the surface would be there;
    nearer surfaces hide it.
    """
    entries = count[row, col]
    if entries == 0:
        return -1.0
    for k in range(entries):
        if labels[row, col, k] == label:
            return float(up_to[row, col, k])
    # Entries are near to far: if the nearest is farther than the surface, all are.
    return 0.0 if inverses[row, col, 0] < inverse_of(planes, label, row, col, directions) else -1.0


@borrowing
def collect(
    label: int,
    row: int,
    col: int,
    reach: int,
    count: NDArray[np.int32],
    labels: NDArray[np.int32],
    inverses: FloatArray,
    up_to: FloatArray,
    samples: FloatArray,
    floor: FloatArray,
    planes: Shapes,
    directions: FloatArray,
    rays: FloatArray,
    first_cut: NDArray[np.int32],
    next_cut: NDArray[np.int32],
    nearer: FloatArray,
    frame: FloatArray,
    pixels: FloatArray,
) -> int:
    """Fill `pixels` with those around (row, col) with a known share of a surface; return their number.

    The pixel itself comes first. `rays` is (row, col, 3, 3): the ray of the centre, and its change down and across;
    `frame` (3, 3) is filled with the rows that give x, y and 1 of a ray in the pixel's own plane.
    """
    to_plane(rays[row, col], frame)
    rows, cols = count.shape
    found = 0
    for step in range((2 * reach + 1) * (2 * reach + 1) + 1):
        r, c = row, col
        if step > 0:
            r = row - reach + (step - 1) // (2 * reach + 1)
            c = col - reach + (step - 1) % (2 * reach + 1)
            if (r == row and c == col) or r < 0 or c < 0 or r >= rows or c >= cols:
                continue
        share = share_of(label, r, c, count, labels, inverses, up_to, planes, directions)
        if share < 0.0:
            continue
        one = pixels[found]
        ray = rays[r, c]
        depth = dot(frame[2], ray[0])
        if depth <= 0.0:
            continue
        one[X], one[Y] = dot(frame[0], ray[0]) / depth, dot(frame[1], ray[0]) / depth
        for k in range(2):
            change = dot(frame[2], ray[1 + k])
            one[X_ROW + 2 * k] = (dot(frame[0], ray[1 + k]) - one[X] * change) / depth
            one[Y_ROW + 2 * k] = (dot(frame[1], ray[1 + k]) - one[Y] * change) / depth
        one[SHARE], one[SAMPLES], one[FLOOR] = share, samples[r, c], floor[r, c]
        one[HIDES] = 0.0
        if labels[r, c, 0] != label and share > 0.0:
            known = _hide(label, r, c, labels, first_cut, next_cut, nearer, one)
            if not known and step > 0:
                continue
        found += 1
    return found


@borrowing
def _hide(
    label: int,
    row: int,
    col: int,
    labels: NDArray[np.int32],
    first_cut: NDArray[np.int32],
    next_cut: NDArray[np.int32],
    fits: FloatArray,
    pixel: FloatArray,
) -> bool:
    """Set the edge of the surface before a label's in its pixel; return whether it is known."""
    cut, entry = first_cut[row, col], 1
    while cut >= 0 and labels[row, col, entry] != label:
        cut = next_cut[cut]
        entry += 1
    if cut < 0 or fits[cut, BACK] == 0.0:
        return False
    pixel[HIDES] = 1.0
    pixel[HIDES_ROW], pixel[HIDES_COL] = math.cos(fits[cut, ANGLE]), math.sin(fits[cut, ANGLE])
    pixel[HIDES_AT] = -fits[cut, OFFSET]
    return True


@borrowing
def to_plane(ray: FloatArray, frame: FloatArray) -> None:
    """Fill `frame` so that frame @ (centre + x down + y across) = (x, y, 1)."""
    for i in range(3):
        # Rows of the inverse of the matrix with the columns down, across, centre: cross products of the two others.
        p, q = ray[2 if i == 0 else (0 if i == 1 else 1)], ray[0 if i == 0 else (1 if i == 1 else 2)]
        frame[i, 0] = p[1] * q[2] - p[2] * q[1]
        frame[i, 1] = p[2] * q[0] - p[0] * q[2]
        frame[i, 2] = p[0] * q[1] - p[1] * q[0]
    whole = frame[0, 0] * ray[1, 0] + frame[0, 1] * ray[1, 1] + frame[0, 2] * ray[1, 2]
    for i in range(3):
        for j in range(3):
            frame[i, j] /= whole
