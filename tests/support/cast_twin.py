"""Twin of the kernel that casts beams, whole rows at once in NumPy: for where kernels run as plain Python.

A pixel that an edge crosses gets 64 x 64 beams here, all alike; the kernel cuts it finer only where the edge is.
`simulation/test_cast.py` holds the kernel against it; `conftest.py` puts it in the kernel's place with the JIT off.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tofmix.simulation.casting.cast_kernel import SceneArrays

Floats = NDArray[np.float64]

SIDE = 64
TIE = 1e-9


def _directions(azimuth: Floats, elevation: Floats) -> Floats:
    """Unit vectors (..., 3)."""
    level = np.cos(elevation)
    parts = np.broadcast_arrays(np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level)
    return np.stack(parts, axis=-1)


def _inside(beams: Floats, scene: SceneArrays) -> tuple[Floats, Floats]:
    """How far (..., S) beams are inside each surface, and their cosines of incidence."""
    cosine = beams @ scene.normal.T
    edges = beams @ scene.edges.reshape(-1, 3).T
    return np.minimum(cosine - scene.min_cosine, edges.reshape(*cosine.shape, 4).min(axis=-1)), cosine


def _add(sums: Floats, weight: float, surface: NDArray[np.intp], cosine: Floats, scene: SceneArrays) -> None:
    """Add one pixel's beams (n,) that meet `surface`."""
    for k, term in enumerate((np.ones(len(cosine)), scene.distance[surface] / cosine, cosine)):
        sums[:, k] += weight * np.bincount(surface, term, minlength=len(sums))


def _filled(beams: Floats, radius: float, scene: SceneArrays) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """The surface that fills each pixel by itself, -1 where none does; and where none is seen at all."""
    inside, cosine = _inside(beams, scene)
    kept, inverse = inside >= -radius, cosine / scene.distance
    front = np.argmax(np.where(inside > radius, inverse, 0.0), axis=1)
    slope = scene.normal / scene.distance[:, None]
    differ = slope[front][:, None] - slope  # (col, S, 3)
    spread = np.sqrt((differ**2).sum(axis=-1))
    hidden = np.einsum("csa,ca->cs", differ, beams) > spread * radius
    others = kept & ~hidden
    others[np.arange(len(front)), front] = False
    alone = (inside[np.arange(len(front)), front] > radius) & ~others.any(axis=1)
    return np.where(alone, front, -1), np.asarray(~kept.any(axis=1))


def cast_row(
    elevation: float,
    azimuths: Floats,
    width: float,
    height: float,
    scene: SceneArrays,
    wanted: NDArray[np.bool_],
    sums: Floats,
) -> None:
    """Twin of `tofmix.simulation.casting.cast_kernel.cast_row`."""
    if len(scene.distance) == 0:
        return
    level = np.full(len(azimuths), elevation)
    front, empty = _filled(_directions(azimuths, level), 0.5 * math.hypot(width, height), scene)
    for col in np.flatnonzero(wanted & ~empty):
        side = 8 if front[col] >= 0 else SIDE
        part = (np.arange(side) + 0.5) / side - 0.5
        beams = _directions(azimuths[col] + part * width, (elevation + part * height)[:, None]).reshape(-1, 3)
        if front[col] >= 0:
            _add(sums[col], side**-2, np.full(side**2, front[col]), beams @ scene.normal[front[col]], scene)
            continue
        inside, cosine = _inside(beams, scene)
        inverse = np.where(inside >= 0.0, cosine / scene.distance, 0.0)
        nearest = inverse.max(axis=1)
        first = np.argmax(inverse >= nearest[:, None] * (1.0 - TIE), axis=1)  # of two in one plane the first is seen
        met = nearest > 0.0
        _add(sums[col], side**-2, first[met], cosine[met, first[met]], scene)


def cast_cells(nodes: Floats, scene: SceneArrays, wanted: NDArray[np.bool_], sums: Floats) -> None:
    """Twin of `tofmix.simulation.casting.cast_cells.cast_cells`: 64 x 64 beams in every pixel, by solid angle."""
    if len(scene.distance) == 0:
        return
    t = (np.arange(SIDE) + 0.5) / SIDE
    basis = np.stack([(2 * t - 1) * (t - 1), 4 * t * (1 - t), t * (2 * t - 1)], axis=1)
    slope = np.stack([4 * t - 3, 4 - 8 * t, 4 * t - 1], axis=1)
    for col in np.flatnonzero(wanted):
        cell = nodes[:, 2 * col : 2 * col + 3]
        ray, across, down = (
            np.einsum("vj,ui,jia->vua", v, u, cell).reshape(-1, 3)
            for v, u in ((basis, basis), (basis, slope), (slope, basis))
        )
        size = np.linalg.norm(ray, axis=1)
        weight = np.abs((ray * np.cross(across, down)).sum(axis=1)) / size**3
        inside, cosine = _inside(ray / size[:, np.newaxis], scene)
        inverse = np.where(inside >= 0.0, cosine / scene.distance, 0.0)
        nearest = inverse.max(axis=1)
        first = np.argmax(inverse >= nearest[:, None] * (1.0 - TIE), axis=1)
        met = np.flatnonzero(nearest > 0.0)
        surface, part = first[met], weight[met] / weight.sum()
        cosine = cosine[met, surface]
        for k, term in enumerate((part, part * scene.distance[surface] / cosine, part * cosine)):
            sums[col, :, k] += np.bincount(surface, term, minlength=len(scene.distance))
