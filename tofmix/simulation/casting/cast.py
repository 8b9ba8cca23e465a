"""Cast the beams of a model's pixels: which surfaces each one sees, how far, and with which share.

Use it once a model; every frame of a still scene has the same truth. Nothing
here is random, and no noise, bias or effect enters.

A measured scene has the layers of each pixel, moved along the beams as their surfaces are. A surface that stands
elsewhere changes the ranges of its layers by the change of its plane along each beam; the shares stay as they were
measured. Amplitudes follow ``cos(incidence) / r^2``, as those of rectangles do.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of, cell_nodes
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.casting.cast_cells import cast_cells, reached_cells
from tofmix.simulation.casting.cast_kernel import SceneArrays, cast_row, reached_row, scene_arrays
from tofmix.simulation.events import Truth
from tofmix.simulation.measured_scene import MeasuredScene
from tofmix.simulation.model import Model
from tofmix.simulation.surface import MAX_LENGTH_MM, NEAREST_MM, Surface

EDGE_ON = 1.0e-3  # cosine of incidence below which a plane is seen edge-on, and its layers stay


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
    amplitude = _recorded_amplitude(model, scene, beams) if scene.amplitude is None else scene.amplitude.copy()
    for number, (now, before) in enumerate(zip(model.surfaces, scene.surfaces, strict=True)):
        if _stands(now) == _stands(before):
            continue
        row, col, layer = np.nonzero(scene.surface == number)
        (was_mm, was_cosine), (is_mm, is_cosine) = (met_plane(s, beams[row, col]) for s in (before, now))
        here = (was_cosine > EDGE_ON) & (is_cosine > EDGE_ON)
        old = range_mm[row, col, layer]
        new = np.maximum(np.where(here, old + is_mm - was_mm, old), NEAREST_MM)
        range_mm[row, col, layer] = new
        brighter = np.where(here, is_cosine / np.maximum(was_cosine, EDGE_ON), 1.0) * (old / new) ** 2
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
    neighbours = 3  # of the same surface, at least, whose mean is taken
    for number, surface in enumerate(scene.surfaces):
        own = scene.surface == number
        once = own.sum(axis=2) == 1
        row, col, layer = np.nonzero(own & once[:, :, None])
        beside = np.zeros(scene.shape)
        beside[row, col] = scene.range_mm[row, col, layer] - met_plane(surface, beams[row, col])[0]
        count = convolve(once.astype(np.float64), around, mode="constant")
        mean = convolve(beside, around, mode="constant") / np.maximum(count, 1.0)
        use = count[row, col] >= neighbours
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


def met_plane(surface: Surface, beams: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range (n,) of a plane along beams (n, 3), mm, and the cosine of incidence, both above 0 where it is ahead.

    Of a cosine below `EDGE_ON`, layers of a measured scene stay where they are.
    """
    normal = surface.rotation()[:, 2]
    distance = float(normal @ np.array(surface.center_mm))
    cosine = beams @ (normal if distance >= 0 else -normal)
    return abs(distance) / np.maximum(cosine, EDGE_ON), cosine


def _recorded_amplitude(model: Model, scene: MeasuredScene, beams: FloatArray) -> FloatArray:
    """Amplitudes (row, col, layer) by the law of rectangles, where the recording has none."""
    cosine, reflectivity = np.ones(scene.range_mm.shape), np.full(scene.range_mm.shape, np.nan)
    for number, surface in enumerate(scene.surfaces):
        row, col, layer = np.nonzero(scene.surface == number)
        cosine[row, col, layer] = np.maximum(met_plane(surface, beams[row, col])[1], EDGE_ON)
        reflectivity[row, col, layer] = surface.reflectivity
    usual = scene.surfaces[0].reflectivity if scene.surfaces else 1.0
    gain = 1000.0 * model.sensor.integration_time_ms / 1.2
    return np.asarray(gain * np.nan_to_num(reflectivity, nan=usual) * cosine * (1000.0 / scene.range_mm) ** 2)


MIN_SHARE = 1.0e-4
"""A surface or a gap of less than this share of a pixel is left out, and the others take its place.

Shares are right to 0.001; one sample in 10,000 is what the sensor's random values (p(c_r)) yield anyway; and an edge
that lies on the border of two pixels must not count as a surface of both by a rounding error.
"""

MAX_SURFACES = 4096  # so that never all shares of a pixel are below MIN_SHARE
MAX_LAYERS = int(np.iinfo(np.uint8).max)  # of n_modes

_T = TypeVar("_T", bound=np.generic)


def cast_scene(model: Model, *, time_s: float = 0.0) -> Truth:
    """Compute the surfaces, shares and ranges in each pixel of the model's camera.

    A surface is seen from both sides, at ranges above 0 up to `range_max_mm`; the nearest hides the others, and of
    two in one plane the first in the model is seen. Shares are right to 0.001 for edges of any direction, those along
    the pixel grid included.

    Parameters
    ----------
    model : Model
        The scene and the camera, with its geometry effects.
    time_s : float
        Time since the first frame, s: surfaces may move.

    Returns
    -------
    Truth
        Arrays (rows, cols, layer); layer is the largest number of surfaces in any pixel, at least 1; where surfaces
        move, the largest number at any time.

    Raises
    ------
    BadInputError
        If the model has over 4096 surfaces, a pixel sees more than 255, or a surface has moved out of bounds.

    References
    ----------
    formats.md, Geometry.
    """
    if len(model.surfaces) > MAX_SURFACES:
        raise BadInputError(f"[[surface]]: {len(model.surfaces)} surfaces; this version casts up to {MAX_SURFACES}")
    if model.scene is not None:
        return cast_measured(_placed(model, time_s), model.scene)
    if model.moves:
        return MovingCaster(model).cast(time_s)
    placed = _placed(model, time_s)
    return truth_of(placed, _cast(placed))


class MovingCaster:
    """Casts a scene in which some surfaces move, time after time.

    Only pixels that may see a moving surface are cast again; the others do not change. The values are those of a still
    scene with the surfaces at their places, bit by bit, with room for `layers` surfaces.

    Parameters
    ----------
    model : Model
        The model.

    Attributes
    ----------
    layers : int
        Most surfaces that a pixel may see at any time.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        if model.scene is not None:  # each layer moves by itself
            self.layers = model.scene.range_mm.shape[2]
            return
        self._moving = np.array([model.moves_surface(surface.name) for surface in model.surfaces], dtype=np.bool_)
        away = tuple(
            replace(
                surface, reflectivity=0.0, center_mm=(0.0, 0.0, MAX_LENGTH_MM), yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0
            )
            if moves
            else surface
            for surface, moves in zip(_placed(model, 0.0).surfaces, self._moving, strict=True)
        )
        self._background = _cast(replace(model, surfaces=away, effects=()))
        most = np.bincount(self._background.pixel, minlength=1).max() + self._moving.sum()
        self.layers = max(1, min(int(most), len(model.surfaces), MAX_LAYERS))

    def cast(self, time_s: float) -> Truth:
        """Surfaces of each pixel at a time; see `cast_scene`."""
        model = _placed(self._model, time_s)
        if model.scene is not None:
            return cast_measured(model, model.scene)
        still = self._background
        reached = _reached(model, self._moving)
        fresh = _cast(model, reached)
        kept = ~reached.ravel()[still.pixel]
        truth = truth_of(
            model,
            SeenSurfaces(
                pixel=np.concatenate([fresh.pixel, still.pixel[kept]]),
                surface=np.concatenate([fresh.surface, still.surface[kept]]),
                share=np.concatenate([fresh.share, still.share[kept]]),
                range_mm=np.concatenate([fresh.range_mm, still.range_mm[kept]]),
                cosine=np.concatenate([fresh.cosine, still.cosine[kept]]),
                nothing=np.where(reached.ravel(), fresh.nothing, still.nothing),
            ),
        )
        return truth.padded(self.layers)


def _placed(model: Model, time_s: float) -> Model:
    """The model with its surfaces where they are at a time."""
    if len(model.surfaces) > MAX_SURFACES:
        raise BadInputError(f"[[surface]]: {len(model.surfaces)} surfaces; this version casts up to {MAX_SURFACES}")
    return replace(model, surfaces=model.placed(time_s)) if model.effects else model


class SeenSurfaces(NamedTuple):
    """One entry for each surface that a pixel sees, and the pixels' shares without a surface."""

    pixel: IntArray
    surface: IntArray
    share: FloatArray
    range_mm: FloatArray
    cosine: FloatArray
    nothing: FloatArray


def _cast(model: Model, wanted: BoolArray | None = None) -> SeenSurfaces:
    """Cast row by row, so that memory does not grow with pixels times surfaces; only the pixels (row, col) wanted."""
    sensor, scene = model.sensor, scene_arrays(model)
    if wanted is None:
        wanted = np.ones((sensor.rows, sensor.cols), dtype=np.bool_)
    cast = _row_caster(sensor, scene)
    rows = []
    for row in range(sensor.rows):
        sums = np.zeros((sensor.cols, len(model.surfaces), 3))
        cast(row, wanted[row], sums)
        rows.append(sift(sums, row * sensor.cols))
    return SeenSurfaces(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))


def _row_caster(sensor: CompleteCamera, scene: SceneArrays) -> Callable[[int, BoolArray, FloatArray], None]:
    """Function that casts one image row, from its number and the wanted pixels (col,), into zeros (col, S, 3).

    Cells of equal angles have kernels of their own, which take sines and cosines once a row and once a column.
    """
    optics = sensor.optics
    if not isinstance(optics, Equiangular):
        return lambda row, wanted, sums: cast_cells(cell_nodes(optics, row, sensor.shape), scene, wanted, sums)
    (width, height), azimuths, elevations = optics.pixel_size_rad(sensor.shape), *_angles(sensor, optics)
    return lambda row, wanted, sums: cast_row(elevations[row], azimuths, width, height, scene, wanted, sums)


def _reached(model: Model, moving: BoolArray) -> BoolArray:
    """Pixels (row, col) in which a moving surface may be seen."""
    sensor, scene = model.sensor, scene_arrays(model)
    reached = np.empty((sensor.rows, sensor.cols), dtype=np.bool_)
    optics = sensor.optics
    if not isinstance(optics, Equiangular):
        for row in range(sensor.rows):
            reached_cells(cell_nodes(optics, row, sensor.shape), scene, moving, reached[row])
        return reached
    (width, height), azimuths, elevations = optics.pixel_size_rad(sensor.shape), *_angles(sensor, optics)
    for row, elevation in enumerate(elevations):
        reached_row(elevation, azimuths, width, height, scene, moving, reached[row])
    return reached


def _angles(sensor: CompleteCamera, optics: Equiangular) -> tuple[FloatArray, FloatArray]:
    """Azimuth (col,) of each column's centre and elevation (row,) of each row's, rad."""
    width, height = optics.pixel_size_rad(sensor.shape)
    azimuths = (np.arange(sensor.cols, dtype=np.float64) - (sensor.cols - 1) / 2) * width
    return azimuths, (np.arange(sensor.rows, dtype=np.float64) - (sensor.rows - 1) / 2) * height


def sift(sums: FloatArray, first_pixel: int) -> SeenSurfaces:
    """The surfaces in a row's pixels, without shares below `MIN_SHARE`; the others fill the pixel."""
    share = sums[:, :, 0]
    nothing = 1.0 - share.sum(axis=1)
    share = np.where(share >= MIN_SHARE, share, 0.0)
    nothing = np.where(nothing >= MIN_SHARE, nothing, 0.0)
    whole = share.sum(axis=1) + nothing
    col, surface = np.nonzero(share)
    weight, weighted_range, weighted_cosine = sums[col, surface].T
    return SeenSurfaces(
        pixel=first_pixel + col,
        surface=surface,
        share=share[col, surface] / whole[col],
        range_mm=weighted_range / weight,
        cosine=weighted_cosine / weight,
        nothing=nothing / whole,
    )


def truth_of(model: Model, seen: SeenSurfaces) -> Truth:
    """Sort the surfaces of each pixel from near to far."""
    sensor = model.sensor
    counts = np.bincount(seen.pixel, minlength=sensor.rows * sensor.cols)
    if counts.max() > MAX_LAYERS:
        where = divmod(int(counts.argmax()), sensor.cols)
        raise BadInputError(
            f"[[surface]]: pixel {where} sees {counts.max()} surfaces; a recording holds up to {MAX_LAYERS}"
        )
    order = np.lexsort((seen.surface, seen.range_mm, seen.pixel))
    pixel = seen.pixel[order]
    layer = np.arange(pixel.size) - (np.cumsum(counts) - counts)[pixel]
    image, stack = (sensor.rows, sensor.cols), (sensor.rows, sensor.cols, max(1, int(counts.max())))
    row, col = np.divmod(pixel, sensor.cols)

    def spread(values: NDArray[np.generic], padding: float, dtype: type[_T]) -> NDArray[_T]:
        out = np.full(stack, padding, dtype=dtype)
        out[row, col, layer] = values[order]
        return out

    returned = (1.0 - np.broadcast_to(model.outlier_share, image)).ravel()
    return Truth(
        n_modes=counts.reshape(image).astype(np.uint8),
        range_true=spread(seen.range_mm, np.nan, np.float32),
        weight_true=spread(seen.share * returned[seen.pixel], np.nan, np.float32),
        weight_no_return=(seen.nothing * returned).reshape(image).astype(np.float32),
        surface=spread(seen.surface, -1, np.int16),
        amplitude=spread(_amplitude(model, seen), 0.0, np.float32),
    )


def _amplitude(model: Model, seen: SeenSurfaces) -> FloatArray:
    """``1000 * reflectivity * cos(incidence) * (1000 / r_mm)^2 * tau_ms / 1.2`` of each entry."""
    reflectivity = np.array([surface.reflectivity for surface in model.surfaces], dtype=np.float64)[seen.surface]
    gain = 1000.0 * model.sensor.integration_time_ms / 1.2
    amplitude: FloatArray = gain * reflectivity * seen.cosine * (1000.0 / seen.range_mm) ** 2
    return amplitude
