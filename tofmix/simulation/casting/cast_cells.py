"""Kernels that cast the beams of one image row of any projection.

They validate nothing; call `tofmix.simulation.casting.cast`.

They work as those of `tofmix.simulation.casting.cast_kernel`: a cell that one surface fills gets a few beams, and a
cell with an edge is divided. A pixel's cell is a patch through nine rays, and each beam counts by the solid angle
around it.
"""

import math

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.optics.cells import fill_patch, patch_direction, patch_solid_angle
from tofmix.simulation.casting.cast_kernel import (
    LATTICE,
    LATTICE_STEP,
    MIXED,
    SHIFT_ACROSS,
    SHIFT_DOWN,
    SMOOTH_BEAMS,
    SUBCELLS,
    SceneArrays,
    add,
    judge,
    nearest,
)

BULGE = 1.01
"""A part of a cell reaches at most this much farther from its centre than its corners: 1 / 32 of the pixel's bend."""


@jit
def _chord(a: FloatArray, b: FloatArray) -> float:
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@jit
def _cell_radius(patch: FloatArray, centre: FloatArray, work: FloatArray) -> float:
    """Largest chord from the centre's direction to any in the cell.

    Between corners a side may bend outward: by no more than its middle is off the chord of its ends.
    """
    radius = 0.0
    bend = 0.0
    for side in range(4):
        for end in range(2):
            at = end if side % 2 == 0 else 1 - end
            u = float(at) if side < 2 else float(side - 2)  # noqa: PLR2004  two sides across, two down
            v = float(side) if side < 2 else float(at)  # noqa: PLR2004
            patch_direction(patch, u, v, work[end])
            radius = max(radius, _chord(work[end], centre))
        u = 0.5 if side < 2 else float(side - 2)  # noqa: PLR2004
        v = float(side) if side < 2 else 0.5  # noqa: PLR2004
        patch_direction(patch, u, v, work[2])
        radius = max(radius, _chord(work[2], centre))
        for axis in range(3):
            work[0, axis] = 0.5 * (work[0, axis] + work[1, axis])
        bend = max(bend, _chord(work[0], work[2]))
    return radius + bend


@jit
def _cast_smooth(patch: FloatArray, scene: SceneArrays, surface: int, work: FloatArray, sums: FloatArray) -> float:
    """A cell that one surface fills: 8 x 8 beams for its mean range. Returns the sum of their weights."""
    total = 0.0
    beam = work[0]
    for j in range(SMOOTH_BEAMS):
        for i in range(SMOOTH_BEAMS):
            weight = patch_solid_angle(patch, (i + 0.5) / SMOOTH_BEAMS, (j + 0.5) / SMOOTH_BEAMS, beam)
            add(beam[0], beam[1], beam[2], weight, scene, surface, sums)
            total += weight
    return total


@jit
def _cast_lattice(
    patch: FloatArray,
    i: int,
    j: int,
    weight: float,
    scene: SceneArrays,
    candidates: IntArray,
    count: int,
    beam: FloatArray,
    sums: FloatArray,
) -> None:
    """A part of a cell that an edge crosses: a shifted lattice of 64 beams, which share its solid angle."""
    shift = j * SUBCELLS + i
    for k in range(LATTICE):
        across = ((k + 0.5) / LATTICE + shift * SHIFT_ACROSS) % 1.0
        down = ((k * LATTICE_STEP % LATTICE + 0.5) / LATTICE + shift * SHIFT_DOWN) % 1.0
        patch_direction(patch, (i + across) / SUBCELLS, (j + down) / SUBCELLS, beam)
        surface = nearest(beam[0], beam[1], beam[2], scene, candidates, count)
        if surface >= 0:
            add(beam[0], beam[1], beam[2], weight / LATTICE, scene, surface, sums)


@jit
def _cast_mixed(
    patch: FloatArray,
    scene: SceneArrays,
    candidates: IntArray,
    count: int,
    kept: IntArray,
    corners: FloatArray,
    work: FloatArray,
    sums: FloatArray,
) -> float:
    """A cell that an edge crosses: 32 x 32 parts, one beam in each that is whole, 64 in each that is not.

    Returns the sum of the weights of all beams, those that meet nothing included.
    """
    for j in range(SUBCELLS + 1):
        for i in range(SUBCELLS + 1):
            patch_direction(patch, i / SUBCELLS, j / SUBCELLS, corners[j, i])
    total = 0.0
    centre = work[0]
    for j in range(SUBCELLS):
        for i in range(SUBCELLS):
            weight = patch_solid_angle(patch, (i + 0.5) / SUBCELLS, (j + 0.5) / SUBCELLS, centre)
            total += weight
            radius = 0.0
            for corner in range(4):
                radius = max(radius, _chord(corners[j + corner // 2, i + corner % 2], centre))
            found, n_kept = judge(centre[0], centre[1], centre[2], radius * BULGE, scene, candidates, count, kept)
            if found >= 0:
                add(centre[0], centre[1], centre[2], weight, scene, found, sums)
            elif found == MIXED:
                _cast_lattice(patch, i, j, weight, scene, kept, n_kept, work[1], sums)
    return total


@jit
def reached_cells(nodes: FloatArray, scene: SceneArrays, moving: BoolArray, reached: BoolArray) -> None:
    """Find the pixels of one image row in which a moving surface may be seen.

    Parameters
    ----------
    nodes, scene
        As for `cast_cells`.
    moving : (S,) bool
        Which surfaces move.
    reached : (col,) bool
        Receives whether one of them may be seen.
    """
    count = scene.distance.shape[0]
    everything = np.arange(count)
    seen = np.empty(count, dtype=np.int64)
    patch = np.empty((3, 3, 3))
    centre = np.empty(3)
    work = np.empty((3, 3))
    for col in range(reached.shape[0]):
        fill_patch(nodes, 2 * col, patch)
        patch_direction(patch, 0.5, 0.5, centre)
        radius = _cell_radius(patch, centre, work)
        _, n_seen = judge(centre[0], centre[1], centre[2], radius, scene, everything, count, seen)
        reached[col] = False
        for k in range(n_seen):
            reached[col] |= moving[seen[k]]


@jit
def cast_cells(nodes: FloatArray, scene: SceneArrays, wanted: BoolArray, sums: FloatArray) -> None:
    """Cast one image row.

    Parameters
    ----------
    nodes : (3, 2 cols + 1, 3) float64
        Rays of the row's cells, from `tofmix.optics.projection.cell_nodes`.
    scene : SceneArrays
        S surfaces.
    wanted : (col,) bool
        Pixels to cast.
    sums : (col, S, 3) float64
        Zeros; receives the share of each surface, and the sums of share times range (mm) and times cosine of
        incidence. Shares are those of the cell's solid angle.
    """
    count = scene.distance.shape[0]
    everything = np.arange(count)
    seen = np.empty(count, dtype=np.int64)
    kept = np.empty(count, dtype=np.int64)
    patch = np.empty((3, 3, 3))
    centre = np.empty(3)
    work = np.empty((3, 3))
    corners = np.empty((SUBCELLS + 1, SUBCELLS + 1, 3))
    for col in range(wanted.shape[0]):
        if not wanted[col]:
            continue
        fill_patch(nodes, 2 * col, patch)
        patch_direction(patch, 0.5, 0.5, centre)
        radius = _cell_radius(patch, centre, work)
        found, n_seen = judge(centre[0], centre[1], centre[2], radius, scene, everything, count, seen)
        total = 0.0
        if found >= 0:
            total = _cast_smooth(patch, scene, found, work, sums[col])
        elif found == MIXED:
            total = _cast_mixed(patch, scene, seen, n_seen, kept, corners, work, sums[col])
        if total > 0.0:
            for s in range(count):
                for k in range(3):
                    sums[col, s, k] /= total
