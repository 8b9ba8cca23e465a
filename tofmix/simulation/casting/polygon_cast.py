"""Cast one camera's pixels many times, quickly, and as smooth functions of the poses of the surfaces.

Use it where a scene is fitted: shares are areas, which change evenly with a surface's place; those of
`tofmix.simulation.casting.cast` are counts of beams. Both are right to 0.001. Recordings are simulated by the other.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import Projection, cell_nodes, pixel_extent_rad
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.casting.cast import SeenSurfaces, cast_scene, sift, truth_of
from tofmix.simulation.casting.cast_cells import BULGE
from tofmix.simulation.casting.cast_kernel import scene_arrays
from tofmix.simulation.casting.polygon_kernel import cast_polygons
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model


class _Cells(NamedTuple):
    """The cells of a camera's pixels, as `cast_polygons` takes them."""

    patches: FloatArray
    centres: FloatArray
    radii: FloatArray
    means: FloatArray
    spreads: FloatArray
    weights: FloatArray
    parts: int


class PolygonCaster:
    """Casts scenes before one camera.

    Parameters
    ----------
    sensor : CompleteCamera
        The camera.
    """

    def __init__(self, sensor: CompleteCamera) -> None:
        # Extent of a pixel beyond which second moments describe its directions too roughly: its beams are cast one by
        # one.
        coarse_rad = 0.05
        self._coarse = float(pixel_extent_rad(sensor.optics, sensor.shape).max()) > coarse_rad
        self._cells = _cells(sensor.optics, sensor.shape)  # type: ignore[arg-type]  # a frozen dataclass

    def cast(self, model: Model) -> Truth:
        """The surfaces in each pixel, for a model of this camera without moving effects; see `cast_scene`."""
        if self._coarse or model.scene is not None:
            return cast_scene(model)
        scene, count = scene_arrays(model), max(1, len(model.surfaces))
        at_once = 4_000_000  # numbers that a cast holds
        step, cells, found = max(1, at_once // (3 * count)), self._cells, []
        for start in range(0, len(cells.radii), step):
            own = slice(start, start + step)
            sums = np.zeros((len(cells.radii[own]), len(model.surfaces), 3))
            crowded = cast_polygons(
                cells.patches[own],
                cells.centres[own],
                cells.radii[own],
                cells.means[own],
                cells.spreads[own],
                cells.weights[own],
                cells.parts,
                scene,
                sums,
            )
            if crowded:
                return cast_scene(model)
            found.append(sift(sums, start))
        return truth_of(model, SeenSurfaces(*(np.concatenate(values) for values in zip(*found, strict=True))))


class MovingPolygons:
    """Casts a scene in which some surfaces move, time after time, as `PolygonCaster` does.

    Parameters
    ----------
    model : Model
        The model.
    """

    def __init__(self, model: Model) -> None:
        self._model, self._caster = model, PolygonCaster(model.sensor)

    def cast(self, time_s: float) -> Truth:
        """Surfaces of each pixel at a time, with as many layers as they need."""
        return self._caster.cast(replace(self._model, surfaces=self._model.placed(time_s), effects=()))


@lru_cache(maxsize=2)
def _cells(optics: Projection, shape: tuple[int, int]) -> _Cells:
    nodes = np.stack([cell_nodes(optics, row, shape) for row in range(shape[0])])  # (row, 3, 2 cols + 1, 3)
    nine = np.stack([nodes[:, :, k : k + 2 * shape[1] : 2][:, :, : shape[1]] for k in range(3)], axis=3)
    nine = np.moveaxis(nine, 2, 1).reshape(-1, 3, 3, 3)  # (pixel, v, u, axis)
    length = np.linalg.norm(nine, axis=-1, keepdims=True)
    patches, directions = _coefficients(np.concatenate([nine, length], axis=-1)), nine / length
    centres = np.ascontiguousarray(directions[:, 1, 1])
    chord = np.linalg.norm(directions - centres[:, None, None], axis=-1).reshape(len(centres), 9)
    even = isinstance(optics, Equiangular)
    # A part of a cell up to which an edge that is bent by the projection passes for straight: to 0.0005 of its area.
    straight_rad = 0.013
    return _Cells(
        patches,
        centres,
        BULGE * chord.max(axis=1),
        *_moments(patches, even=even),
        _weights(patches, even=even),
        max(1, math.ceil(float(pixel_extent_rad(optics, shape).max()) / straight_rad)),
    )


def _coefficients(nine: FloatArray) -> FloatArray:
    """Coefficients (pixel, 3, 3, n) of v^j u^i from values (pixel, v, u, n) at 0, 1/2 and 1."""

    def along(a: FloatArray, b: FloatArray, c: FloatArray, axis: int) -> FloatArray:
        return np.stack([a, 4.0 * b - 3.0 * a - c, 2.0 * (a + c) - 4.0 * b], axis=axis)

    by_u = along(nine[:, :, 0], nine[:, :, 1], nine[:, :, 2], 2)
    return np.ascontiguousarray(along(by_u[:, 0], by_u[:, 1], by_u[:, 2], 1))


def _at(patches: FloatArray, u: float, v: float) -> tuple[FloatArray, FloatArray]:
    """Unit directions (pixel, 3) at a place of each cell, and solid angle (pixel,) per area du dv there."""
    powers, by_u, by_v = (
        np.outer(np.array(a), np.array(b))
        for a, b in (
            ((1, v, v * v), (1, u, u * u)),
            ((1, v, v * v), (0, 1, 2 * u)),
            ((0, 1, 2 * v), (1, u, u * u)),
        )
    )
    ray, right, down = (np.einsum("pjia,ji->pa", patches[..., :3], p) for p in (powers, by_u, by_v))
    length = np.linalg.norm(ray, axis=1)
    swept = np.abs(np.einsum("pa,pa->p", ray, np.cross(right, down)))
    return ray / length[:, None], swept / length**3


def _moments(patches: FloatArray, *, even: bool) -> tuple[FloatArray, FloatArray]:
    """Mean (pixel, 3) and covariance (pixel, 3, 3) of the directions in each cell."""
    total, first, second = np.zeros(len(patches)), np.zeros((len(patches), 3)), np.zeros((len(patches), 3, 3))
    middle = _at(patches, 0.5, 0.5)[0]
    beams = 8  # a side of a pixel, for the moments of its directions: as `cast` has them
    places = (np.arange(beams) + 0.5) / beams
    for v in places:
        for u in places:
            directions, angle = _at(patches, float(u), float(v))
            weight, away = np.ones_like(angle) if even else angle, directions - middle
            total += weight
            first += weight[:, None] * away
            second += weight[:, None, None] * away[:, :, None] * away[:, None, :]
    mean = first / total[:, None]
    spread = second / total[:, None, None] - mean[:, :, None] * mean[:, None, :]
    return np.ascontiguousarray(middle + mean), np.ascontiguousarray(spread)


def _weights(patches: FloatArray, *, even: bool) -> FloatArray:
    """Weights (pixel, 6) of places in each cell: by solid angle, or equal for all angles."""
    out = np.zeros((len(patches), 6))
    out[:, 0] = 1.0
    if even:
        return out
    at = {(i, j): _at(patches, 0.5 + 0.5 * i, 0.5 + 0.5 * j)[1] for i in (-1, 0, 1) for j in (-1, 0, 1)}
    middle = at[0, 0]
    out[:, 0] = middle
    out[:, 1], out[:, 2] = at[1, 0] - at[-1, 0], at[0, 1] - at[0, -1]
    out[:, 3] = 2 * (at[1, 0] + at[-1, 0] - 2 * middle)
    out[:, 4] = at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]
    out[:, 5] = 2 * (at[0, 1] + at[0, -1] - 2 * middle)
    mean = out[:, 0] + (out[:, 3] + out[:, 5]) / 12.0
    return np.ascontiguousarray(out / mean[:, None])
