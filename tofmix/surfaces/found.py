"""The results of `surfaces`: the surface of each layer, planes, edges, and a finer range image."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.sensor import Sensor

NO_SURFACE = -1
"""Number of no surface: a layer that is of none, or no return."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planes:
    """Planes of surfaces, n . x = offset in the sensor's frame (x right, y down, z forward), n toward positive offset.

    A smooth surface that is no plane has NaN as normal and offset.

    Parameters
    ----------
    n_pixels : (surface,) uint32
        Layers that are of the surface.
    normal : (surface, 3) float32
        Unit vectors.
    offset_mm : (surface,) float32
        Distance of the plane from the sensor, mm, 0 or more.
    rms_mm : (surface,) float32
        Root mean square distance of the layers from the plane, or from the smooth fit, along the beams, mm.
    """

    n_pixels: NDArray[np.uint32]
    normal: NDArray[np.float32]
    offset_mm: NDArray[np.float32]
    rms_mm: NDArray[np.float32]

    def __len__(self) -> int:
        """Surfaces."""
        return len(self.n_pixels)

    @property
    def is_smooth(self) -> BoolArray:
        """Which surfaces (surface,) are smooth and no planes."""
        return np.asarray(np.isnan(self.offset_mm) & np.isnan(self.normal).all(axis=-1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edges:
    """Points of edges; those of a line follow one another, the nearer surface to the left as rows run downward.

    All arrays are (point,). Places are in pixels: the centre of the pixel (row, col) is at row, col.

    Parameters
    ----------
    row, col : float32
        Places.
    stderr : float32
        Standard error across the edge, pixels.
    near, far : int32
        Numbers of the surfaces on both sides; the nearer one ends at the edge. `NO_SURFACE` as `far`: no return.
    line : int32
        Number of the line that the point belongs to, ascending from 0.
    """

    row: NDArray[np.float32]
    col: NDArray[np.float32]
    stderr: NDArray[np.float32]
    near: NDArray[np.int32]
    far: NDArray[np.int32]
    line: NDArray[np.int32]

    def __len__(self) -> int:
        """Points."""
        return len(self.row)

    def lines(self) -> list[slice]:
        """Points of each line."""
        bounds = [*np.flatnonzero(np.diff(self.line, prepend=-1)), len(self)]
        return [slice(int(a), int(b)) for a, b in pairwise(bounds)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowSurfaces:
    """The surfaces of one window, numbered from 0.

    Parameters
    ----------
    surface : (row, col, layer) int32
        Number of the surface that each layer is of; `NO_SURFACE`: none, or no layer.
    planes : Planes
        Of each surface.
    edges : Edges
        Where surfaces end.
    range_fine : (rows x factor, cols x factor) float32
        Range of the nearest surface at the centre of each part of a pixel, mm; NaN: no return, or not known.
    surface_fine : (rows x factor, cols x factor) int32
        Its surface.
    assumed : int
        Mixed pixels whose shares of samples stand for areas, though nothing tells it.
    """

    surface: NDArray[np.int32]
    planes: Planes
    edges: Edges
    range_fine: NDArray[np.float32]
    surface_fine: NDArray[np.int32]
    assumed: int = 0

    @property
    def factor(self) -> int:
        """Parts along each side of a pixel."""
        return int(self.range_fine.shape[0] // self.surface.shape[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfacesProvenance:
    """Source and options of surfaces; independent of time, machine and number of workers.

    `source` is the base name of the layers file, `source_sha256` its checksum; `options` are those that affect
    values, by their names on the command line, `factor` among them.
    """

    source: str
    source_sha256: str
    version: str
    sensor: Sensor
    options: dict[str, str | int | float] = field(default_factory=dict)


def no_edges() -> Edges:
    """Edges without a point."""
    kinds = {"row": "f4", "col": "f4", "stderr": "f4", "near": "i4", "far": "i4", "line": "i4"}
    arrays: dict[str, Any] = {name: np.zeros(0, dtype=kind) for name, kind in kinds.items()}
    return Edges(**arrays)


def plane_ranges(planes: Planes, surface: NDArray[np.integer], directions: FloatArray) -> FloatArray:
    """Ranges at which beams meet planes.

    Parameters
    ----------
    planes : Planes
        Of the surfaces.
    surface : (...) int
        Number of the surface of each beam; `NO_SURFACE`: none.
    directions : (..., 3) float64
        Unit vectors.

    Returns
    -------
    (...) float64
        mm; NaN where there is no surface, where it is no plane, and where the beam does not meet its plane.
    """
    known = surface >= 0
    index = np.where(known, surface, 0)
    if not len(planes):
        return np.full(surface.shape, np.nan)
    along = (planes.normal[index].astype(np.float64) * directions).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = planes.offset_mm[index].astype(np.float64) / along
    return np.asarray(np.where(known & (ranges > 0), ranges, np.nan))
