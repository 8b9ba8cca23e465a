"""Kernels that cast the beams of one image row, of equal angles.

They validate nothing; call `tofmix.simulation.casting.cast`.

`tofmix.simulation.casting.cast_cells` has those of other projections, and uses the tests of cells and beams from here.

A cell (a pixel, or one of the 32 x 32 parts of one that an edge crosses) is first judged as a whole: from its centre
and its radius, does one surface, or nothing, fill it? Only undecided cells are divided, down to single beams.

A beam from the sensor meets a rectangle where its unit direction d fulfils five
conditions, each linear in d: one for each edge (d lies on the inner side of the
plane through the sensor and that edge), and one for the range. With N the
plane's unit normal away from the sensor and h its distance, the range along the
beam is r = h / (N . d) and the cosine of incidence N . d.

Being linear with unit vectors, a condition that holds at a cell's centre by more than the cell's radius holds in all of
it. So `tofmix.simulation.casting.cast` finds every pixel with an edge, even of a thin object.
"""

import math
from typing import NamedTuple

import numpy as np

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface


class SceneArrays(NamedTuple):
    """S surfaces for the kernel.

    Parameters
    ----------
    normal : (S, 3) float64
        Unit normals, away from the sensor.
    distance : (S,) float64
        Distance of the plane from the sensor, mm.
    edges : (S, 4, 3) float64
        Unit normals of the planes through the sensor and each edge; the rectangle is where all ``e . d >= 0``.
    min_cosine : (S,) float64
        The range is at most the sensor's where ``N . d`` is at least this.
    """

    normal: FloatArray
    distance: FloatArray
    edges: FloatArray
    min_cosine: FloatArray


def scene_arrays(model: Model) -> SceneArrays:
    """The model's surfaces as the kernel's arrays, in the model's order."""
    count = len(model.surfaces)
    scene = SceneArrays(np.zeros((count, 3)), np.zeros(count), np.zeros((count, 4, 3)), np.zeros(count))
    for k, surface in enumerate(model.surfaces):
        _fill(scene, k, surface, model.sensor.range_max_mm)
    return scene


def _fill(scene: SceneArrays, k: int, surface: Surface, range_max_mm: float) -> None:
    """Half-spaces of one surface.

    A beam's point is p = d h / (N . d). ``|U . (p - c)| <= w / 2``, U the axis of the width, times N . d > 0, is
    ``((w / 2 + U . c) N - h U) . d >= 0`` and the same with -U; likewise for the height.
    """
    axes = surface.rotation()
    center = np.array(surface.center_mm)
    normal = axes[:, 2] if axes[:, 2] @ center >= 0 else -axes[:, 2]
    distance = float(normal @ center)
    edge_on_mm = 1.0e-6  # a plane that passes this near to the sensor is seen edge-on: it covers no area
    if distance < edge_on_mm:
        scene.distance[k] = 1.0
        scene.min_cosine[k] = 2.0  # a cosine that no beam has
        return
    scene.normal[k], scene.distance[k] = normal, distance
    scene.min_cosine[k] = distance / range_max_mm
    for side in range(4):
        axis = axes[:, side // 2] * (1 if side % 2 else -1)
        edge = (surface.size_mm[side // 2] / 2 + axis @ center) * normal - distance * axis
        scene.edges[k, side] = edge / np.linalg.norm(edge)


NOTHING = -1  # no surface in any beam of the cell
MIXED = -2  # an edge, a crease or the range limit may cross the cell
SMOOTH_BEAMS = 8  # beams a side of a pixel that one surface fills
SUBCELLS = 32  # cells a side of a pixel that an edge crosses

LATTICE = 64
"""Beams in such a cell: a rank-1 lattice (i, 19 i mod 64) / 64.

Its projections on both axes are evenly spaced, so that an edge along the grid is found to 1 / 64 of a cell. 19 gives
nearly the longest shortest distance between points of any generator, and serves oblique edges better than the longest.
"""

LATTICE_STEP = 19  # generator: row of the lattice's point in the next column

SHIFT_ACROSS = 0.7548776662466927
"""Shift of the lattice from cell to cell, by the golden ratio's plane sequence (R2): 1 / g with g^3 = g + 1.

Without it an oblique edge would meet the same points in the same way in every cell along it, and their errors would
add up.
"""

SHIFT_DOWN = SHIFT_ACROSS**2
TIE = 1.0e-9  # relative difference of ranges below which two surfaces are one plane: the first in the model is seen


@jit
def judge(
    x: float, y: float, z: float, radius: float, scene: SceneArrays, candidates: IntArray, count: int, kept: IntArray
) -> tuple[int, int]:
    """Content of the cell around direction (x, y, z): a surface, NOTHING or MIXED; and its number of possible surfaces.

    Those that may be seen are written to `kept`, in the order of `candidates`.
    """
    n_kept = 0
    cover = -1
    cover_inverse = 0.0
    for k in range(count):
        s = candidates[k]
        cosine = scene.normal[s, 0] * x + scene.normal[s, 1] * y + scene.normal[s, 2] * z
        inside = cosine - scene.min_cosine[s]
        for e in range(4):
            edge = scene.edges[s, e]
            inside = min(inside, edge[0] * x + edge[1] * y + edge[2] * z)
        if inside < -radius:
            continue
        kept[n_kept] = s
        n_kept += 1
        if inside > radius and cosine / scene.distance[s] > cover_inverse * (1.0 + TIE):
            cover = s
            cover_inverse = cosine / scene.distance[s]
    if n_kept == 0:
        return NOTHING, 0
    if cover < 0:
        return MIXED, n_kept
    visible = 0
    for k in range(n_kept):
        if kept[k] == cover or not _hides(x, y, z, radius, scene, cover, kept[k]):
            kept[visible] = kept[k]
            visible += 1
    return (cover if visible == 1 else MIXED), visible


@jit
def _hides(x: float, y: float, z: float, radius: float, scene: SceneArrays, front: int, back: int) -> bool:
    """Whether `front`, which fills the cell, is nearer than `back` in all of it. 1 / r = N . d / h is linear in d."""
    gap = 0.0
    spread = 0.0
    scale = 1.0 / scene.distance[front]
    for axis in range(3):
        slope = scene.normal[front, axis] * scale - scene.normal[back, axis] / scene.distance[back]
        gap += slope * (x if axis == 0 else y if axis == 1 else z)
        spread += slope * slope
    spread = math.sqrt(spread)
    if spread <= TIE * scale:
        return front < back
    return gap > spread * radius


@jit
def nearest(x: float, y: float, z: float, scene: SceneArrays, candidates: IntArray, count: int) -> int:
    """The surface that a beam meets first, or NOTHING."""
    best = NOTHING
    best_inverse = 0.0
    for k in range(count):
        s = candidates[k]
        cosine = scene.normal[s, 0] * x + scene.normal[s, 1] * y + scene.normal[s, 2] * z
        inverse = cosine / scene.distance[s]
        if cosine < scene.min_cosine[s] or inverse <= best_inverse * (1.0 + TIE):
            continue
        inside = 0.0
        for e in range(4):
            edge = scene.edges[s, e]
            inside = min(inside, edge[0] * x + edge[1] * y + edge[2] * z)
        if inside >= 0.0:
            best = s
            best_inverse = inverse
    return best


@jit
def add(x: float, y: float, z: float, weight: float, scene: SceneArrays, surface: int, sums: FloatArray) -> None:
    """Add one beam that meets `surface` to that surface's sums of share, range and cosine."""
    cosine = scene.normal[surface, 0] * x + scene.normal[surface, 1] * y + scene.normal[surface, 2] * z
    sums[surface, 0] += weight
    sums[surface, 1] += weight * scene.distance[surface] / cosine
    sums[surface, 2] += weight * cosine


@jit
def _cast_smooth(
    azimuth: float, elevation: float, width: float, height: float, scene: SceneArrays, surface: int, sums: FloatArray
) -> None:
    """A pixel that one surface fills: 8 x 8 beams for its mean range."""
    across = np.empty((SMOOTH_BEAMS, 2))
    for i in range(SMOOTH_BEAMS):
        az = azimuth + ((i + 0.5) / SMOOTH_BEAMS - 0.5) * width
        across[i, 0] = math.sin(az)
        across[i, 1] = math.cos(az)
    for j in range(SMOOTH_BEAMS):
        el = elevation + ((j + 0.5) / SMOOTH_BEAMS - 0.5) * height
        y = math.sin(el)
        level = math.cos(el)
        for i in range(SMOOTH_BEAMS):
            add(across[i, 0] * level, y, across[i, 1] * level, 1.0 / SMOOTH_BEAMS**2, scene, surface, sums)


@jit
def _cast_lattice(
    left: float,
    top: float,
    width: float,
    height: float,
    shift: int,
    scene: SceneArrays,
    candidates: IntArray,
    count: int,
    sums: FloatArray,
) -> None:
    """A cell of a pixel that an edge crosses: a shifted lattice of 64 beams."""
    for i in range(LATTICE):
        across = ((i + 0.5) / LATTICE + shift * SHIFT_ACROSS) % 1.0
        down = ((i * LATTICE_STEP % LATTICE + 0.5) / LATTICE + shift * SHIFT_DOWN) % 1.0
        az = left + across * width
        el = top + down * height
        x = math.sin(az) * math.cos(el)
        y = math.sin(el)
        z = math.cos(az) * math.cos(el)
        surface = nearest(x, y, z, scene, candidates, count)
        if surface >= 0:
            add(x, y, z, 1.0 / (SUBCELLS**2 * LATTICE), scene, surface, sums)


@jit
def _cast_mixed(
    azimuth: float,
    elevation: float,
    width: float,
    height: float,
    scene: SceneArrays,
    candidates: IntArray,
    count: int,
    kept: IntArray,
    sums: FloatArray,
) -> None:
    """A pixel that an edge crosses: 32 x 32 cells, one beam in each that is whole, 64 in each that is not."""
    cell_width = width / SUBCELLS
    cell_height = height / SUBCELLS
    radius = 0.5 * math.hypot(cell_width, cell_height)
    across = np.empty((SUBCELLS, 2))
    for i in range(SUBCELLS):
        az = azimuth - width / 2 + i * cell_width + cell_width / 2
        across[i, 0] = math.sin(az)
        across[i, 1] = math.cos(az)
    for j in range(SUBCELLS):
        top = elevation - height / 2 + j * cell_height
        el = top + cell_height / 2
        y = math.sin(el)
        level = math.cos(el)
        for i in range(SUBCELLS):
            left = azimuth - width / 2 + i * cell_width
            x = across[i, 0] * level
            z = across[i, 1] * level
            found, n_kept = judge(x, y, z, radius, scene, candidates, count, kept)
            if found >= 0:
                add(x, y, z, 1.0 / SUBCELLS**2, scene, found, sums)
            elif found == MIXED:
                shift = j * SUBCELLS + i
                _cast_lattice(left, top, cell_width, cell_height, shift, scene, kept, n_kept, sums)


@jit
def reached_row(
    elevation: float,
    azimuths: FloatArray,
    width: float,
    height: float,
    scene: SceneArrays,
    moving: BoolArray,
    reached: BoolArray,
) -> None:
    """Find the pixels of one image row in which a moving surface may be seen.

    Parameters
    ----------
    elevation, azimuths, width, height, scene
        As for `cast_row`.
    moving : (S,) bool
        Which surfaces move.
    reached : (col,) bool
        Receives whether one of them may be seen.
    """
    count = scene.distance.shape[0]
    everything = np.arange(count)
    seen = np.empty(count, dtype=np.int64)
    radius = 0.5 * math.hypot(width, height)
    y = math.sin(elevation)
    level = math.cos(elevation)
    for col in range(azimuths.shape[0]):
        x = math.sin(azimuths[col]) * level
        z = math.cos(azimuths[col]) * level
        _, n_seen = judge(x, y, z, radius, scene, everything, count, seen)
        reached[col] = False
        for k in range(n_seen):
            reached[col] |= moving[seen[k]]


@jit
def cast_row(
    elevation: float,
    azimuths: FloatArray,
    width: float,
    height: float,
    scene: SceneArrays,
    wanted: BoolArray,
    sums: FloatArray,
) -> None:
    """Cast one image row.

    Parameters
    ----------
    elevation : float
        Elevation of the row's centre, rad.
    azimuths : (col,) float64
        Azimuths of the pixels' centres, rad.
    width, height : float
        A pixel's extent in azimuth and elevation, rad.
    scene : SceneArrays
        S surfaces.
    wanted : (col,) bool
        Pixels to cast.
    sums : (col, S, 3) float64
        Zeros; receives the share of each surface, and the sums of share times range (mm) and times cosine of
        incidence.
    """
    count = scene.distance.shape[0]
    everything = np.arange(count)
    seen = np.empty(count, dtype=np.int64)
    kept = np.empty(count, dtype=np.int64)
    # The distance on the sphere is at most hypot of the differences of azimuth and elevation, and the chord is less.
    radius = 0.5 * math.hypot(width, height)
    el_sin = math.sin(elevation)
    el_cos = math.cos(elevation)
    for col in range(azimuths.shape[0]):
        if not wanted[col]:
            continue
        az = azimuths[col]
        x = math.sin(az) * el_cos
        z = math.cos(az) * el_cos
        found, n_seen = judge(x, el_sin, z, radius, scene, everything, count, seen)
        if found >= 0:
            _cast_smooth(az, elevation, width, height, scene, found, sums[col])
        elif found == MIXED:
            _cast_mixed(az, elevation, width, height, scene, seen, n_seen, kept, sums[col])
