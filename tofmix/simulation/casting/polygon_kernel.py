"""Kernels that cut a pixel's cell along the edges of surfaces: shares and mean ranges as areas, without beams.

They validate nothing; call `tofmix.simulation.casting.polygon_cast`. Places (u, v) run
across and down a cell, from 0 to 1. A condition of `tofmix.simulation.casting.cast_kernel` is a
polynomial of second degree in u and in v there, and the part of a cell that fulfils it is
cut with straight lines between its places on the sides of the polygon.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray, IntArray
from tofmix.compiled.jit import borrowing, jit
from tofmix.optics.cells import patch_ray
from tofmix.simulation.casting.cast_kernel import MIXED, TIE, SceneArrays, judge

MOST_IN_FRONT = 6
"""Surfaces that may hide parts of one surface in one part of a cell; the subsets of more are too many."""

_CONDITIONS = 5  # of a surface: four edges and the range
_CORNERS = 2 * (4 + (_CONDITIONS + 1) * (MOST_IN_FRONT + 1))  # a cut adds one; two where an edge is bent
_STEP = 0.25  # of a cell, for slopes of the cosine


class Scratch(NamedTuple):
    """Scratch memory of one cell.

    Parameters
    ----------
    conditions, n_conditions : (S, 5, 3, 3), (S,)
        Of each surface that may be seen, those that cut the cell.
    nearer, n_nearer, hiders : (6, 3, 3), (6,), (6,)
        Of each surface that hides a part of one: the condition that it is nearer, if there is one, and which it is.
    polygons : (3, corner, 2)
        The one at hand, the one that is made of it, and what one surface has without the others.
    moments : (6,)
        Of what it has with them.
    half_space : (4,)
        A condition.
    nearer_here : (3, 3)
        Its polynomial.
    """

    conditions: FloatArray
    n_conditions: IntArray
    nearer: FloatArray
    n_nearer: IntArray
    hiders: IntArray
    polygons: FloatArray
    moments: FloatArray
    half_space: FloatArray
    nearer_here: FloatArray


@borrowing
def _value(q: FloatArray, u: float, v: float) -> float:
    """A polynomial (3, 3), [j, i] of v^j u^i, at a place."""
    return float(
        q[0, 0]
        + u * (q[0, 1] + u * q[0, 2])
        + v * (q[1, 0] + u * (q[1, 1] + u * q[1, 2]) + v * (q[2, 0] + u * (q[2, 1] + u * q[2, 2])))
    )


@borrowing
def _crossing(q: FloatArray, a: FloatArray, b: FloatArray, at_a: float, at_b: float) -> float:
    """Where between two places, as a part of the way, a polynomial is 0: two steps of the regula falsi."""
    t = at_a / (at_a - at_b)
    at_t = _value(q, a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]))
    if (at_t >= 0.0) == (at_a >= 0.0):
        return float(t + (1.0 - t) * at_t / (at_t - at_b))
    return float(t * at_a / (at_a - at_t))


@borrowing
def _cut(q: FloatArray, polygon: FloatArray, count: int, out: FloatArray) -> int:
    """Cut a convex polygon (count, 2) where a polynomial is below 0; how many corners are left, written to `out`."""
    left = 0
    before = count - 1
    if count == 0:
        return 0
    at_before = _value(q, polygon[before, 0], polygon[before, 1])
    for k in range(count):
        at_k = _value(q, polygon[k, 0], polygon[k, 1])
        if (at_k >= 0.0) != (at_before >= 0.0):
            t = _crossing(q, polygon[before], polygon[k], at_before, at_k)
            for axis in range(2):
                out[left, axis] = polygon[before, axis] + t * (polygon[k, axis] - polygon[before, axis])
            left += 1
        if at_k >= 0.0:
            out[left, 0] = polygon[k, 0]
            out[left, 1] = polygon[k, 1]
            left += 1
        before = k
        at_before = at_k
    return left


@borrowing
def _cut_all(conditions: FloatArray, count: int, polygons: FloatArray, corners: int) -> int:
    """Cut the polygon in ``polygons[0]`` by conditions (count, 3, 3); it stays there."""
    for k in range(count):
        if corners == 0:
            return 0
        corners = _cut(conditions[k], polygons[0], corners, polygons[1])
        for c in range(corners):
            polygons[0, c, 0] = polygons[1, c, 0]
            polygons[0, c, 1] = polygons[1, c, 1]
    return corners


@borrowing
def _add_moments(polygon: FloatArray, count: int, sign: float, moments: FloatArray) -> None:
    """Add area, first and second moments (u, v, uu, uv, vv) of a polygon about the cell's centre."""
    before = count - 1
    for k in range(count):
        x0, y0 = polygon[before, 0] - 0.5, polygon[before, 1] - 0.5
        x1, y1 = polygon[k, 0] - 0.5, polygon[k, 1] - 0.5
        turn = sign * (x0 * y1 - x1 * y0)
        moments[0] += turn / 2.0
        moments[1] += turn * (x0 + x1) / 6.0
        moments[2] += turn * (y0 + y1) / 6.0
        moments[3] += turn * (x0 * x0 + x0 * x1 + x1 * x1) / 12.0
        moments[4] += turn * (x0 * y1 + 2.0 * x0 * y0 + 2.0 * x1 * y1 + x1 * y0) / 24.0
        moments[5] += turn * (y0 * y0 + y0 * y1 + y1 * y1) / 12.0
        before = k


@borrowing
def _fill_condition(
    patch: FloatArray, condition: FloatArray, centre: FloatArray, radius: float, out: FloatArray
) -> int:
    """The polynomial of a condition (4,) into `out`; how many it is: none where the whole cell fulfils it."""
    size = math.sqrt(condition[0] ** 2 + condition[1] ** 2 + condition[2] ** 2)
    here = condition[0] * centre[0] + condition[1] * centre[1] + condition[2] * centre[2] + condition[3]
    if here > size * radius:
        return 0
    for j in range(3):
        for i in range(3):
            total = 0.0
            for axis in range(4):
                total += condition[axis] * patch[j, i, axis]
            out[j, i] = total
    return 1


@borrowing
def _cosine(patch: FloatArray, scene: SceneArrays, surface: int, u: float, v: float) -> float:
    """N . d of the unit direction at a place."""
    dot = 0.0
    square = 0.0
    for axis in range(3):
        p = patch_ray(patch, u, v, axis)
        dot += scene.normal[surface, axis] * p
        square += p * p
    return float(dot / math.sqrt(square))


@borrowing
def _add_part(
    patch: FloatArray, weight: FloatArray, scene: SceneArrays, surface: int, moments: FloatArray, sums: FloatArray
) -> None:
    """Add a surface's part of a cell: its share, and share times mean range and mean cosine, to second order."""
    share = (
        weight[0] * moments[0]
        + weight[1] * moments[1]
        + weight[2] * moments[2]
        + (weight[3] * moments[3] + weight[4] * moments[4] + weight[5] * moments[5])
    )
    if not (moments[0] > 0.0 and share > 0.0):
        return
    slope_u, slope_v = weight[1] / weight[0], weight[2] / weight[0]
    mass = moments[0] + slope_u * moments[1] + slope_v * moments[2]
    x = (moments[1] + slope_u * moments[3] + slope_v * moments[4]) / mass
    y = (moments[2] + slope_u * moments[4] + slope_v * moments[5]) / mass
    xx = moments[3] / moments[0] - (moments[1] / moments[0]) ** 2
    xy = moments[4] / moments[0] - moments[1] * moments[2] / moments[0] ** 2
    yy = moments[5] / moments[0] - (moments[2] / moments[0]) ** 2
    u, v = x + 0.5, y + 0.5
    here = _cosine(patch, scene, surface, u, v)
    right, left = (_cosine(patch, scene, surface, u + _STEP, v), _cosine(patch, scene, surface, u - _STEP, v))
    below, above = (_cosine(patch, scene, surface, u, v + _STEP), _cosine(patch, scene, surface, u, v - _STEP))
    corner = _cosine(patch, scene, surface, u + _STEP, v + _STEP)
    by_u, by_v = (right - left) / (2 * _STEP), (below - above) / (2 * _STEP)
    by_uu, by_vv = (right + left - 2 * here) / _STEP**2, (below + above - 2 * here) / _STEP**2
    by_uv = (corner - right - below + here) / _STEP**2
    mean = here + 0.5 * (by_uu * xx + by_vv * yy) + by_uv * xy
    spread = by_u * by_u * xx + 2.0 * by_u * by_v * xy + by_v * by_v * yy
    inverse = (1.0 - (mean - here) / here + spread / (here * here)) / here
    sums[surface, 0] += share
    sums[surface, 1] += share * scene.distance[surface] * inverse
    sums[surface, 2] += share * mean


@borrowing
def _hiding(
    patch: FloatArray, scene: SceneArrays, front: int, back: int, centre: FloatArray, radius: float, scratch: Scratch
) -> int:
    """The condition that `front` is nearer than `back`: how many it is; -1 where that holds nowhere in the cell."""
    size = 0.0
    for axis in range(3):
        slope = scene.normal[front, axis] / scene.distance[front] - scene.normal[back, axis] / scene.distance[back]
        scratch.half_space[axis] = slope
        size += slope * slope
    scratch.half_space[3] = 0.0
    if math.sqrt(size) <= TIE / scene.distance[front]:
        return 0 if front < back else -1
    return _fill_condition(patch, scratch.half_space, centre, radius, scratch.nearer_here)


@borrowing
def _find_conditions(
    patch: FloatArray,
    scene: SceneArrays,
    centre: FloatArray,
    radius: float,
    seen: IntArray,
    n_seen: int,
    scratch: Scratch,
) -> bool:
    """Fill the boundaries of each possible surface in the cell; return whether the largest range is one."""
    round_one = False
    for k in range(n_seen):
        s = seen[k]
        n = 0
        for c in range(_CONDITIONS):
            edge = c < _CONDITIONS - 1
            for axis in range(3):
                scratch.half_space[axis] = scene.edges[s, c, axis] if edge else scene.normal[s, axis]
            scratch.half_space[3] = 0.0 if edge else -scene.min_cosine[s]
            cuts = _fill_condition(patch, scratch.half_space, centre, radius, scratch.conditions[k, n])
            n += cuts
            round_one |= cuts == 1 and not edge
        scratch.n_conditions[k] = n
    return round_one


@borrowing
def _copy(polygons: FloatArray, source: int, target: int, corners: int) -> None:
    for c in range(corners):
        polygons[target, c, 0] = polygons[source, c, 0]
        polygons[target, c, 1] = polygons[source, c, 1]


@borrowing
def _find_hiders(
    patch: FloatArray,
    scene: SceneArrays,
    centre: FloatArray,
    radius: float,
    seen: IntArray,
    n_seen: int,
    k: int,
    corners: int,
    scratch: Scratch,
) -> int:
    """Which surfaces hide a part of the polygon of the k-th; how many, -1 for too many."""
    n_hiders = 0
    for other in range(n_seen):
        n = -1 if other == k else _hiding(patch, scene, seen[other], seen[k], centre, radius, scratch)
        if n < 0:
            continue
        _copy(scratch.polygons, 2, 0, corners)
        left = _cut_all(scratch.conditions[other], scratch.n_conditions[other], scratch.polygons, corners)
        if n == 1 and left > 0:
            left = _cut(scratch.nearer_here, scratch.polygons[0], left, scratch.polygons[1])
        if left == 0:
            continue
        if n_hiders == MOST_IN_FRONT:
            return -1
        for j in range(3):
            for i in range(3):
                scratch.nearer[n_hiders, j, i] = scratch.nearer_here[j, i]
        scratch.n_nearer[n_hiders] = n
        scratch.hiders[n_hiders] = other
        n_hiders += 1
    return n_hiders


@borrowing
def _cast_part(
    patch: FloatArray,
    scene: SceneArrays,
    centre: FloatArray,
    radius: float,
    seen: IntArray,
    n_seen: int,
    k: int,
    corners: int,
    scratch: Scratch,
) -> int:
    """Add the moments of the visible part of the k-th surface in a polygon.

    By inclusion and exclusion over the subsets of those that hide. Returns 1 where they are too many, else 0.
    """
    corners = _cut_all(scratch.conditions[k], scratch.n_conditions[k], scratch.polygons, corners)
    if corners == 0:
        return 0
    _add_moments(scratch.polygons[0], corners, 1.0, scratch.moments)
    _copy(scratch.polygons, 0, 2, corners)
    n_hiders = _find_hiders(patch, scene, centre, radius, seen, n_seen, k, corners, scratch)
    if n_hiders < 0:
        return 1
    for subset in range(1, 1 << n_hiders):
        _copy(scratch.polygons, 2, 0, corners)
        left = corners
        sign = 1.0
        for h in range(n_hiders):
            if subset >> h & 1:
                sign = -sign
                other = scratch.hiders[h]
                left = _cut_all(scratch.conditions[other], scratch.n_conditions[other], scratch.polygons, left)
                left = _cut_all(scratch.nearer[h : h + 1], scratch.n_nearer[h], scratch.polygons, left)
        if left > 0:
            _add_moments(scratch.polygons[0], left, sign, scratch.moments)
    return 0


@borrowing
def _cast_mixed(
    patch: FloatArray,
    centre: FloatArray,
    radius: float,
    weight: FloatArray,
    parts: int,
    scene: SceneArrays,
    seen: IntArray,
    n_seen: int,
    scratch: Scratch,
    sums: FloatArray,
) -> int:
    """A cell that an edge crosses, part by part. Returns 1 where too many surfaces are before one, else 0."""
    if _find_conditions(patch, scene, centre, radius, seen, n_seen, scratch):
        round_parts = 6  # times as many parts a side, where a circle crosses the cell
        parts *= round_parts
    crowded = 0
    for k in range(n_seen):
        for m in range(6):
            scratch.moments[m] = 0.0
        for part in range(parts * parts):
            left, top = part % parts / parts, part // parts / parts
            for c in range(4):
                scratch.polygons[0, c, 0] = left + (1.0 / parts if c in (1, 2) else 0.0)
                scratch.polygons[0, c, 1] = top + (1.0 / parts if c >= 2 else 0.0)  # noqa: PLR2004  the two below
            crowded |= _cast_part(patch, scene, centre, radius, seen, n_seen, k, 4, scratch)
        _add_part(patch, weight, scene, seen[k], scratch.moments, sums)
    return crowded


@jit
def cast_polygons(
    patches: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    means: FloatArray,
    spreads: FloatArray,
    weights: FloatArray,
    parts: int,
    scene: SceneArrays,
    sums: FloatArray,
) -> int:
    """Cast pixels.

    Parameters
    ----------
    patches : (pixel, 3, 3, 4) float64
        Coefficients of v^j u^i, [j, i, axis], of each cell's ray; the fourth axis is the ray's length.
    centres : (pixel, 3) float64
        Unit directions of the cells' centres.
    radii : (pixel,) float64
        Largest chord from there to a direction in the cell.
    means, spreads : (pixel, 3), (pixel, 3, 3) float64
        Mean and covariance of the unit directions in the cell.
    weights : (pixel, 6) float64
        Weight of a place, of the mean 1: coefficients of 1, u, v, uu, uv, vv about the cell's centre.
    parts : int
        Parts a side into which a cell is cut before.
    scene : SceneArrays
        S surfaces.
    sums : (pixel, S, 3) float64
        Zeros; receives share, share times range (mm) and share times cosine of incidence of each surface.

    Returns
    -------
    int
        Number of pixels that have more than `MOST_IN_FRONT` surfaces before one, and are not cast.
    """
    count = scene.distance.shape[0]
    everything = np.arange(count)
    seen = np.empty(count, dtype=np.int64)
    scratch = Scratch(
        np.empty((count, _CONDITIONS, 3, 3)),
        np.empty(count, dtype=np.int64),
        np.empty((MOST_IN_FRONT, 3, 3)),
        np.empty(MOST_IN_FRONT, dtype=np.int64),
        np.empty(MOST_IN_FRONT, dtype=np.int64),
        np.empty((3, _CORNERS, 2)),
        np.empty(6),
        np.empty(4),
        np.empty((3, 3)),
    )
    crowded = 0
    for p in range(radii.shape[0]):
        x, y, z = centres[p, 0], centres[p, 1], centres[p, 2]
        found, n_seen = judge(x, y, z, radii[p], scene, everything, count, seen)
        if found >= 0:
            cosine = 0.0
            variance = 0.0
            for a in range(3):
                cosine += scene.normal[found, a] * means[p, a]
                for b in range(3):
                    variance += scene.normal[found, a] * spreads[p, a, b] * scene.normal[found, b]
            sums[p, found, 0] = 1.0
            sums[p, found, 1] = scene.distance[found] / cosine * (1.0 + variance / cosine**2)
            sums[p, found, 2] = cosine
        elif found == MIXED:
            crowded += _cast_mixed(
                patches[p], centres[p], radii[p], weights[p], parts, scene, seen, n_seen, scratch, sums[p]
            )
    return crowded
