"""From light that stops and light that passes to log-odds, and from voxels to a 2-D map.

In the paper's forward model a sample stops at surface i with the unknown share p(c_i). Seen from a cell: of the light
that reaches it, an unknown share s stops there. A cell is free if s is at most `min_share`, which stray layers may
reach, and occupied if it is more. With k samples stopped and f passed, s uniform under either hypothesis and even odds
before,

    log-odds = log (1 - I) / (1 - min_share) - log I / min_share,    I = I_min_share(k + 1, f + 1)

with the regularised incomplete beta function I. Light that stops in front of a cell carries no information about it.

A lost sample may have stopped anywhere along its beam. So a cell is free only in proportion to the light that came
back: of l lost samples, the share l / (k + f + l) of the light through the cell leaves it at even odds. An obstacle is
no less an obstacle for lost light.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betainc

from tofmix.arrays import ByteArray, Float32Array, FloatArray
from tofmix.mapping.beams import Beams
from tofmix.mapping.grid import Pose, VoxelGrid, cell_outlines, image_cone, image_nodes
from tofmix.mapping.kernel import SeenLight, count_cells, count_levels
from tofmix.optics.equiangular import Equiangular

OCCUPIED_THRESH = 0.65
"""A cell more probably occupied than this is; the value that ROS's map_server takes."""

FREE_THRESH = 0.196
"""A cell less probably occupied than this is free; the value that ROS's map_server takes."""

MAX_LOG_ODDS = math.log(0.999 / 0.001)
"""Largest certainty of a cell, 0.999: no model is better."""


class State(IntEnum):
    """State of a cell.

    Compare arrays with ``int(member)``: NumPy takes a member for a number of 64 bits, and casts the whole array.
    """

    FREE = 0
    UNKNOWN = 1
    OCCUPIED = 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightCounts:
    """Light counted in samples, in each cell of a grid.

    stopped, passed (x, y, z) float64: samples that stopped in the cell, and that passed through it; probability (x, y,
    z) float64: the largest probability of a surface that stopped samples there: that it exists and lies within a cell's
    width; 0 without any; lost (x, y, z) float64: samples of the beams through it that were lost, anywhere.
    """

    stopped: FloatArray
    passed: FloatArray
    probability: FloatArray
    lost: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VoxelMap:
    """A 3-D occupancy grid: log_odds (x, y, z) float32 of being occupied, 0 where nothing is known."""

    grid: VoxelGrid
    log_odds: Float32Array

    def probability(self) -> Float32Array:
        """Probability (x, y, z) float32 of being occupied, 0.5 where nothing is known."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.log_odds)), dtype=np.float32)

    def states(self) -> ByteArray:
        """`State` of each voxel (x, y, z)."""
        return _states(self.log_odds)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FloorMap:
    """A 2-D occupancy grid.

    cells (x, y) uint8: a `State` each; cell_mm their edge; origin_mm (x, y), the corner of least x and y.
    """

    cells: ByteArray
    cell_mm: float
    origin_mm: tuple[float, float]

    def centres_mm(self, axis: int) -> FloatArray:
        """Centres of the cells along x (0) or y (1), mm."""
        number = np.arange(self.cells.shape[axis], dtype=np.float64)
        return self.origin_mm[axis] + (number + 0.5) * self.cell_mm


def count_light(
    beams: Beams, pose: Pose, grid: VoxelGrid, *, workers: int = 1, progress: Callable[[int], object] | None = None
) -> LightCounts:
    """Count the samples that stop in each cell, and those that pass through it.

    Parameters
    ----------
    beams : Beams
        The pixels of the camera.
    pose : Pose
        Where it stood.
    grid : Grid
        The cells. The cell of the camera stays unknown.
    workers : int
        Threads, at least 1. It changes no value.
    progress : callable, optional
        Called with the number of cells done since the last call.

    Returns
    -------
    Light
        Float64, in samples.
    """
    out = np.zeros((grid.shape[2], grid.shape[0], grid.shape[1], 4))
    count = _level_counter(beams, pose, grid)

    def level(k: int) -> None:
        count(k, out[k])
        if progress is not None:
            progress(grid.shape[0] * grid.shape[1])

    level(0)  # compiles or loads the kernel before there are threads
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(level, range(1, grid.shape[2])))
    stopped, passed, probability, lost = np.moveaxis(out, 0, 2).transpose(3, 0, 1, 2)
    return LightCounts(stopped=stopped, passed=passed, probability=probability, lost=lost)


def _level_counter(beams: Beams, pose: Pose, grid: VoxelGrid) -> Callable[[int, FloatArray], None]:
    """Function that counts the light of one level, from its number into zeros (x, y, 4)."""
    low = [grid.centres_mm(axis) - grid.cell_mm / 2 - pose.position()[axis] for axis in range(3)]
    rotation, cell, optics = pose.rotation(), grid.cell_mm, beams.optics
    seen = SeenLight(
        near=beams.near_mm,
        far=beams.far_mm,
        clear=beams.clear_to_mm,
        samples=beams.samples,
        probability=beams.probability_within(cell),
        no_return=beams.samples_no_return,
        lost=beams.samples_lost,
        free_to=beams.free_to_mm,
    )

    if isinstance(optics, Equiangular):
        width, height = beams.pixel_size_rad

        def count_angles(k: int, out: FloatArray) -> None:
            level = low[2][k : k + 1]
            count_levels(level, low[0], low[1], cell, beams.reach_mm, rotation, width, height, seen, out[np.newaxis])

        return count_angles
    nodes = image_nodes(optics, beams.shape)
    cone = image_cone(nodes)

    def count_image(k: int, out: FloatArray) -> None:
        for i, x in enumerate(low[0]):
            lows = np.column_stack([np.full_like(low[1], x), low[1], np.full_like(low[1], low[2][k])])
            outlines = cell_outlines(optics, beams.shape, lows, cell, rotation, cone)
            count_cells(lows, outlines, nodes, cell, beams.reach_mm, rotation, seen, out[i])

    return count_image


def log_odds(
    stopped: ArrayLike, passed: ArrayLike, probability: ArrayLike, lost: ArrayLike = 0.0, *, min_share: float = 0.05
) -> FloatArray:
    """Log-odds that cells are occupied, given the light counted in them.

    Parameters
    ----------
    stopped, passed : array_like
        Samples, of one shape, at least 0.
    probability : array_like
        How surely the surest surface that stopped any exists and is there: no cell is more surely occupied than that.
    lost : array_like
        Samples of the beams through the cells that were lost, at least 0.
    min_share : float
        Share of the light through a cell that an obstacle stops at least, in (0, 1).

    Returns
    -------
    float64 array
        Within +-6.9; 0 where no light came.

    Raises
    ------
    ValueError
        If `min_share` is not between 0 and 1.

    References
    ----------
    Pathak, Birk and Poppinga, IROS 2008, section II: p(c_i | m_i = 1) is not known beforehand. With the share
    unknown and uniform, the number of stopped samples is beta-binomial.
    """
    if not 0 < min_share < 1:
        raise ValueError(f"min_share: {min_share:g} is not between 0 and 1")
    k, f = np.asarray(stopped, dtype=np.float64) + 1.0, np.asarray(passed, dtype=np.float64) + 1.0
    tiny = 1e-300  # keeps the logarithm of a vanished tail finite; it is clipped at MAX_LOG_ODDS anyway
    occupied = np.log(np.maximum(betainc(f, k, 1.0 - min_share), tiny) / (1.0 - min_share))
    free = np.log(np.maximum(betainc(k, f, min_share), tiny) / min_share)
    sure = np.minimum(np.asarray(probability, dtype=np.float64), 1.0 - 1e-9)
    with np.errstate(divide="ignore"):
        most = np.maximum(np.log(sure / (1.0 - sure)), 0.0)
    odds = np.clip(occupied - free, -MAX_LOG_ODDS, MAX_LOG_ODDS)
    odds = np.minimum(odds, np.where(np.asarray(stopped) > 0, most, MAX_LOG_ODDS))
    return _with_lost_light(odds, k + f - 2.0, np.asarray(lost, dtype=np.float64))


def _with_lost_light(odds: FloatArray, known: FloatArray, lost: FloatArray) -> FloatArray:
    """Log-odds of cells that are free only in proportion to the light that came back; the same bits without loss."""
    with np.errstate(invalid="ignore"):  # no light at all: odds 0, which stay
        back = known / (known + lost)
    occupied = back / (1.0 + np.exp(-odds)) + 0.5 * (1.0 - back)
    return np.asarray(np.where((odds < 0) & (lost > 0), np.log(occupied / (1.0 - occupied)), odds))


def map_beams(
    beams: Beams,
    pose: Pose,
    grid: VoxelGrid,
    *,
    min_share: float = 0.05,
    workers: int = 1,
    progress: Callable[[int], object] | None = None,
) -> VoxelMap:
    """Make the 3-D map from one pose of one camera; parameters as for `count_light` and `log_odds`."""
    light = count_light(beams, pose, grid, workers=workers, progress=progress)
    seen = (light.stopped > 0) | (light.passed > 0)
    odds = np.zeros(grid.shape, dtype=np.float32)
    odds[seen] = log_odds(
        light.stopped[seen], light.passed[seen], light.probability[seen], light.lost[seen], min_share=min_share
    )
    return VoxelMap(grid=grid, log_odds=odds)


def project(voxels: VoxelMap, height_mm: tuple[float, float]) -> FloorMap:
    """Make a 2-D map of a band of heights: the obstacles of a robot of that height.

    A cell is occupied if any voxel of the band is; else free if any is; else unknown.

    Parameters
    ----------
    voxels : VoxelMap
        The 3-D map.
    height_mm : (float, float)
        Lowest and highest height above the camera, mm, rounded outward to whole cells.

    Raises
    ------
    ValueError
        If the band is empty or not all within the grid.
    """
    band = voxels.states()[:, :, voxels.grid.levels(height_mm)]
    occupied, free = (band == int(State.OCCUPIED)).any(axis=2), (band == int(State.FREE)).any(axis=2)
    cells = np.where(occupied, State.OCCUPIED, np.where(free, State.FREE, State.UNKNOWN))
    x, y, _ = voxels.grid.origin_mm
    return FloorMap(cells=cells.astype(np.uint8), cell_mm=voxels.grid.cell_mm, origin_mm=(float(x), float(y)))


def _states(log_odds_: Float32Array) -> ByteArray:
    states = np.full(log_odds_.shape, State.UNKNOWN, dtype=np.uint8)
    states[log_odds_ > math.log(OCCUPIED_THRESH / (1.0 - OCCUPIED_THRESH))] = State.OCCUPIED
    states[log_odds_ < math.log(FREE_THRESH / (1.0 - FREE_THRESH))] = State.FREE
    return states
