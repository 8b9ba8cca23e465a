"""Cast the beams of a model's pixels: which surfaces each one sees, how far, and with which share.

Use it once a model; every frame of a still scene has the same truth. Nothing
here is random, and no noise, bias or effect enters.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray, IntArray
from tofmix.errors import BadInputError
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import cell_nodes
from tofmix.sensors.camera import CompleteCamera
from tofmix.simulation.casting.cast_cells import cast_cells, reached_cells
from tofmix.simulation.casting.cast_kernel import SceneArrays, cast_row, reached_row, scene_arrays
from tofmix.simulation.casting.measured_cast import cast_measured
from tofmix.simulation.model import Model
from tofmix.simulation.surface import MAX_LENGTH_MM
from tofmix.simulation.truth import Truth

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
