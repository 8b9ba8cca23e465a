"""The rectangles of a model as half-spaces of beam directions, which the casting kernel tests.

A beam from the sensor meets a rectangle where its unit direction d fulfils five
conditions, each linear in d: one for each edge (d lies on the inner side of the
plane through the sensor and that edge), and one for the range. With N the
plane's unit normal away from the sensor and h its distance, the range along the
beam is r = h / (N . d) and the cosine of incidence N . d.

Being linear with unit vectors, a condition that holds at a cell's centre by more than the cell's radius holds in all of
it. So `tofmix.simulation.casting.cast` finds every pixel with an edge, even of a thin object.
"""

from typing import NamedTuple

import numpy as np

from tofmix.arrays import FloatArray
from tofmix.simulation.model import Model
from tofmix.simulation.surface import Surface

_EDGE_ON_MM = 1.0e-6  # a plane that passes this near to the sensor is seen edge-on: it covers no area


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
    if distance < _EDGE_ON_MM:
        scene.distance[k] = 1.0
        scene.min_cosine[k] = 2.0  # a cosine that no beam has
        return
    scene.normal[k], scene.distance[k] = normal, distance
    scene.min_cosine[k] = distance / range_max_mm
    for side in range(4):
        axis = axes[:, side // 2] * (1 if side % 2 else -1)
        edge = (surface.size_mm[side // 2] / 2 + axis @ center) * normal - distance * axis
        scene.edges[k, side] = edge / np.linalg.norm(edge)
