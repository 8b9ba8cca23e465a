"""Cast a measured scene: the layers of each pixel, moved along the beams as their surfaces are.

A surface that stands elsewhere changes the ranges of its layers by the change of its plane along each beam; the shares
stay as they were measured. Amplitudes follow ``cos(incidence) / r^2``, as those of rectangles do.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve

from tofmix.arrays import FloatArray
from tofmix.optics.projection import beam_directions_of
from tofmix.simulation.measured_scene import MeasuredScene
from tofmix.simulation.model import Model
from tofmix.simulation.surface import NEAREST_MM, Surface
from tofmix.simulation.truth import Truth

_NEIGHBOURS = 3  # of the same surface, at least, whose mean is taken
_EDGE_ON = 1.0e-3  # cosine of incidence below which a plane is seen edge-on, and its layers stay


def cast_measured(model: Model, scene: MeasuredScene) -> Truth:
    """The layers of a measured scene with the model's surfaces where they stand.

    Parameters
    ----------
    model : Model
        With surfaces as effects place them, in the order of the scene's.
    scene : MeasuredScene
        The model's scene.

    Returns
    -------
    Truth
        With `width` and `lost`.
    """
    beams = beam_directions_of(model.sensor.optics, model.sensor.shape)
    range_mm = scene.range_mm.copy()
    amplitude = _amplitude(model, scene, beams) if scene.amplitude is None else scene.amplitude.copy()
    for number, (now, before) in enumerate(zip(model.surfaces, scene.surfaces, strict=True)):
        if _stands(now) == _stands(before):
            continue
        row, col, layer = np.nonzero(scene.surface == number)
        (was_mm, was_cosine), (is_mm, is_cosine) = (_seen(s, beams[row, col]) for s in (before, now))
        here = (was_cosine > _EDGE_ON) & (is_cosine > _EDGE_ON)
        old = range_mm[row, col, layer]
        new = np.maximum(np.where(here, old + is_mm - was_mm, old), NEAREST_MM)
        range_mm[row, col, layer] = new
        brighter = np.where(here, is_cosine / np.maximum(was_cosine, _EDGE_ON), 1.0) * (old / new) ** 2
        amplitude[row, col, layer] *= brighter
    return _sorted(model, scene, range_mm, amplitude)


def by_neighbours(model: Model, scene: MeasuredScene) -> tuple[MeasuredScene, FloatArray]:
    """The scene with each range as the neighbours of its pixel saw it, and what the pixel itself saw beside that.

    A law of range that is evaluated at a measured range moves with the error of this range, which every pixel's mean of
    another recording shows with the other sign. The mean of the neighbours has no part of that error. Ranges are
    smoothed beside the plane of their surface, so that only its curvature matters.

    Parameters
    ----------
    model : Model
        Of the camera.
    scene : MeasuredScene
        The model's scene.

    Returns
    -------
    MeasuredScene
        Layers of no surface, and pixels with few neighbours of their surface, keep their ranges.
    (surface + 1, pixel) float64
        Measured range less the smoothed one, mm; 0 of no surface, and where a pixel sees a surface twice.

    References
    ----------
    Fuller, Measurement Error Models (1987), section 1.2: the slope of a law by values with errors.
    """
    beams = beam_directions_of(model.sensor.optics, model.sensor.shape)
    around = np.ones((3, 3))
    around[1, 1] = 0.0
    range_mm, apart = scene.range_mm.copy(), np.zeros((len(scene.surfaces) + 1, *scene.shape))
    for number, surface in enumerate(scene.surfaces):
        own = scene.surface == number
        once = own.sum(axis=2) == 1
        row, col, layer = np.nonzero(own & once[:, :, None])
        beside = np.zeros(scene.shape)
        beside[row, col] = scene.range_mm[row, col, layer] - _seen(surface, beams[row, col])[0]
        count = convolve(once.astype(np.float64), around, mode="constant")
        mean = convolve(beside, around, mode="constant") / np.maximum(count, 1.0)
        use = count[row, col] >= _NEIGHBOURS
        row, col, layer = row[use], col[use], layer[use]
        apart[number, row, col] = (beside - mean)[row, col]
        range_mm[row, col, layer] -= apart[number, row, col]
    return replace(scene, range_mm=range_mm), apart.reshape(len(apart), -1)


def _sorted(model: Model, scene: MeasuredScene, range_mm: FloatArray, amplitude: FloatArray) -> Truth:
    """The truth, with the layers of each pixel from near to far."""
    order = np.argsort(range_mm, axis=2, kind="stable")  # NaN last

    def near_to_far(values: FloatArray) -> FloatArray:
        return np.asarray(np.take_along_axis(values, order, axis=2))

    empty = (np.nan_to_num(scene.share).sum(axis=2) + scene.no_return) == 0  # nothing is known: no return
    returned = 1.0 - np.broadcast_to(model.outlier_share, scene.shape)
    return Truth(
        n_modes=(scene.surface >= 0).sum(axis=2).astype(np.uint8),
        range_true=near_to_far(range_mm).astype(np.float32),
        weight_true=near_to_far(scene.share * returned[:, :, None]).astype(np.float32),
        weight_no_return=(np.where(empty, 1.0, scene.no_return) * returned).astype(np.float32),
        surface=np.take_along_axis(scene.surface, order, axis=2),
        amplitude=np.nan_to_num(near_to_far(amplitude)).astype(np.float32),
        width=np.nan_to_num(near_to_far(scene.width), nan=1.0),
        lost=scene.lost,
    )


def _stands(surface: Surface) -> Sequence[object]:
    """Where a surface stands; its name and brightness do not matter."""
    return surface.center_mm, surface.yaw_deg, surface.pitch_deg, surface.roll_deg


def _seen(surface: Surface, beams: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range (n,) of a plane along beams (n, 3), mm, and the cosine of incidence, both above 0 where it is ahead."""
    normal = surface.rotation()[:, 2]
    distance = float(normal @ np.array(surface.center_mm))
    cosine = beams @ (normal if distance >= 0 else -normal)
    return abs(distance) / np.maximum(cosine, _EDGE_ON), cosine


def _amplitude(model: Model, scene: MeasuredScene, beams: FloatArray) -> FloatArray:
    """Amplitudes (row, col, layer) by the law of rectangles, where the recording has none."""
    cosine, reflectivity = np.ones(scene.range_mm.shape), np.full(scene.range_mm.shape, np.nan)
    for number, surface in enumerate(scene.surfaces):
        row, col, layer = np.nonzero(scene.surface == number)
        cosine[row, col, layer] = np.maximum(_seen(surface, beams[row, col])[1], _EDGE_ON)
        reflectivity[row, col, layer] = surface.reflectivity
    usual = scene.surfaces[0].reflectivity if scene.surfaces else 1.0
    gain = 1000.0 * model.sensor.integration_time_ms / 1.2
    return np.asarray(gain * np.nan_to_num(reflectivity, nan=usual) * cosine * (1000.0 / scene.range_mm) ** 2)
