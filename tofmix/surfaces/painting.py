"""The fine range image: each part of a pixel gets its nearest surface. Compiled.

Before, edges continue into neighbouring pixels of one surface, or without known shares (`continue_edges`). A surface
with a small share is not found in its pixel, and an undecided pixel has no known shares. The neighbouring edges
determine both.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.compiled.jit import jit
from tofmix.surfaces.edge_shape import AGREES, AHEAD, BACK, BAR, KIND, covered
from tofmix.surfaces.found import NO_SURFACE
from tofmix.surfaces.regions import FIRST, ONE, REGION_COLUMNS, SHAPE, continue_edge, inside, set_edge
from tofmix.surfaces.settings import EdgeSettings
from tofmix.surfaces.shares import Cuts, Shares
from tofmix.surfaces.smooth_fits import SurfaceView, inverse_of, inverses_of


class Painted(NamedTuple):
    """The surfaces to paint: entries of each pixel, near to far, and the area of each."""

    entries: NDArray[np.int32]
    label: NDArray[np.int32]
    inverse: FloatArray
    cuts: Cuts
    regions: FloatArray


def continue_edges(
    shares: Shares,
    cuts: Cuts,
    fits: FloatArray,
    lines: FloatArray,
    regions: FloatArray,
    view: SurfaceView,
    silent: BoolArray,
    settings: EdgeSettings,
) -> Painted:
    """Continue edges into neighbouring pixels of one surface, or without known shares.

    Parameters
    ----------
    shares, cuts, fits, lines, regions
        The results so far.
    view : SurfaceView
        Of the window.
    silent : (row, col) bool
        Pixels with samples but without known shares.

    Returns
    -------
    Painted
        With a further entry and cut where an edge continues.
    """
    found, more = _continue(shares, cuts, fits, lines, view, silent, settings)
    row, col, near, far = found.T
    count, first = shares.entries.copy(), cuts.first.copy()
    label = np.concatenate([shares.label, np.full((*count.shape, 1), NO_SURFACE, np.int32)], axis=2)
    inverse = np.concatenate([shares.inverse, np.zeros((*count.shape, 1))], axis=2)
    for k, surface in enumerate((near, far)):
        known = inverses_of(view.planes, surface, row, col, view.directions)
        label[row, col, k] = surface
        inverse[row, col, k] = np.where(surface == NO_SURFACE, 0.0, known)
    count[row, col] = 2
    first[row, col] = np.arange(len(cuts.row), len(cuts.row) + len(row))
    both = Cuts(
        row=np.concatenate([cuts.row, row]),
        col=np.concatenate([cuts.col, col]),
        near=np.concatenate([cuts.near, near]),
        far=np.concatenate([cuts.far, far]),
        first=first,
        following=np.concatenate([cuts.following, np.full(len(row), -1, np.int32)]),
        entry=np.concatenate([cuts.entry, np.zeros(len(row), np.int32)]),
        margin=np.concatenate([cuts.margin, np.zeros(len(row))]),
    )
    return Painted(count, label, inverse, both, np.concatenate([regions, more]))


@jit
def _continue(
    shares: Shares,
    cuts: Cuts,
    fits: FloatArray,
    lines: FloatArray,
    view: SurfaceView,
    silent: BoolArray,
    settings: EdgeSettings,
) -> tuple[NDArray[np.int32], FloatArray]:
    """Edges that go on: (row, col, near, far), (edge, 4) int32, and their regions."""
    count = shares.entries
    rows, cols = count.shape
    found = np.empty((rows * cols, 4), np.int32)
    regions = np.zeros((rows * cols, REGION_COLUMNS))
    here = np.empty(3)
    total = 0
    for row in range(rows):
        for col in range(cols):
            if count[row, col] > 1 or (count[row, col] == 0 and not silent[row, col]):
                continue
            longest, hidden = 0.0, NO_SURFACE
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    cut = cuts.first[r, c]
                    while cut >= 0:
                        run = fits[cut, BACK] + fits[cut, AHEAD]
                        if fits[cut, AGREES] > 0.0 and run > longest:
                            for side in range(2 if fits[cut, KIND] == BAR else 1):
                                continue_edge(fits[cut], lines[cut, side], view.rays[row, col], row - r, col - c, here)
                                area = covered(here[0], here[1], here[2])
                                if area < settings.graze_area or area > 1.0 - settings.graze_area:
                                    continue
                                behind = cuts.far[cut]
                                if count[row, col] == 1:
                                    sees = shares.label[row, col, 0]
                                    plane = inverse_of(view.planes, cuts.near[cut], row, col, view.directions)
                                    if sees != cuts.near[cut]:
                                        behind = sees
                                        if shares.inverse[row, col, 0] > plane:
                                            continue  # nearer than the edge's surface, which it hides
                                    miss = (1.0 if sees == cuts.near[cut] else 0.0) - area
                                    effective = shares.samples[row, col]
                                    variance = (area * (1.0 - area) + 0.25 / effective) / effective + shares.floor[
                                        row, col
                                    ]
                                    if miss * miss > settings.graze_sigmas * settings.graze_sigmas * variance:
                                        continue
                                longest, hidden = run, behind
                                found[total, 0], found[total, 1] = row, col
                                found[total, 2], found[total, 3] = cuts.near[cut], hidden
                                regions[total, SHAPE] = ONE
                                set_edge(
                                    regions[total], FIRST, here, fits[cut], row - cuts.row[cut], col - cuts.col[cut]
                                )
                        cut = cuts.following[cut]
            if longest > 0.0:
                total += 1
    return found[:total].copy(), regions[:total].copy()


@jit
def paint_row(
    row: int,
    factor: int,
    painted: Painted,
    view: SurfaceView,
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
    painted, view
        Of the window.
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
    for col in range(painted.entries.shape[1]):
        entries = painted.entries[row, col]
        for part in range(factor * factor):
            i, j = part // factor, part % factor
            v = (j + 0.5) / factor - 0.5
            u = (i + 0.5) / factor - 0.5
            j += col * factor
            range_fine[i, j], surface_fine[i, j] = np.nan, NO_SURFACE
            if entries == 0:
                continue
            entry, cut = 0, painted.cuts.first[row, col]
            while cut >= 0 and entry < entries - 1 and not inside(painted.regions[cut], u, v):
                entry += 1
                cut = painted.cuts.following[cut]
            label = painted.label[row, col, entry]
            if label == NO_SURFACE:
                continue
            own = painted.inverse[row, col, entry]
            there, centre = 0.0, inverse_of(view.planes, label, row, col, view.directions)
            bent = view.planes.smooth[label]
            if bent < 0:
                for k in range(3):
                    there += view.planes.planes[label, k] * fine[i, j, k]
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
