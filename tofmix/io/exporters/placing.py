"""Places of an image in space, on the planes of surfaces."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tofmix.arrays import FloatArray
from tofmix.errors import BadInputError
from tofmix.io.surfaces.surfaces_file import SurfacesFile
from tofmix.optics.projection import Projection, unit
from tofmix.points import MM_A_METRE
from tofmix.surfaces.found import plane_ranges


def optics_of(file: SurfacesFile) -> Projection:
    """The projection of a surfaces file.

    Raises
    ------
    BadInputError
        If the file lacks them, or they are impossible.
    """
    with _worded(file):
        optics = file.provenance.sensor.optics
    if optics is None:
        raise BadInputError(f"{file.path}: sensor: no field of view, so surfaces cannot be placed in space")
    return optics


def directions(file: SurfacesFile, row: ArrayLike, col: ArrayLike) -> FloatArray:
    """Unit vectors (..., 3) along the beams at places of the image, in pixels.

    Raises
    ------
    BadInputError
        If the file lacks the directions of its pixels, or no beam passes there.
    """
    optics = optics_of(file)
    with _worded(file):
        return unit(optics.rays(row, col, shape=file.shape[1:]))


def on_planes(
    file: SurfacesFile, surface: NDArray[np.integer], row: NDArray[np.floating], col: NDArray[np.floating]
) -> FloatArray:
    """Points at which the beams at places of the image meet the planes of surfaces.

    Parameters
    ----------
    file : SurfacesFile
        The surfaces.
    surface : (n,) int
        Number of the surface at each place.
    row, col : (n,) float
        Places, pixels.

    Returns
    -------
    (n, 3) float64
        Metres in the sensor's frame; NaN where a beam does not meet its plane, and without a surface.

    Raises
    ------
    BadInputError
        As `directions`.
    """
    along = directions(file, row, col)
    return np.asarray(along * (plane_ranges(file.planes, surface, along) / MM_A_METRE)[:, np.newaxis])


@contextmanager
def _worded(file: SurfacesFile) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise BadInputError(f"{file.path}: sensor: {error}") from error
