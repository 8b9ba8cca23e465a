"""Where smooth surfaces lie in the pixels that see them: a patch through the pixels around each.

Where beams meet the surfaces of a window: planes, and smooth surfaces pixel by pixel.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tofmix.arrays import FloatArray, IntArray
from tofmix.compiled.jit import borrowing
from tofmix.image.patch import PLACES_9, STATE, Patches, fit_patches, meet
from tofmix.image.segments import LEAST_PIXELS, REACH, members_around
from tofmix.surfaces.linking import Linked
from tofmix.surfaces.nodes import Nodes
from tofmix.surfaces.smooth_linking import Smooth


class Shapes(NamedTuple):
    """The surfaces of a window, as kernels take them.

    Parameters
    ----------
    planes : (surface, 3) float64
        m of 1/r = m . d, 1/mm.
    smooth : (surface,) int32
        Place of each surface in `inverse`; -1: a plane.
    inverse : (smooth surface, row, col) float64
        1 / r of each smooth surface, 1/mm: on its own pixels by its fit, elsewhere that of its nearest pixel.
    """

    planes: FloatArray
    smooth: NDArray[np.int32]
    inverse: FloatArray


class SurfaceView(NamedTuple):
    """The surfaces of a window, and where its pixels look, as kernels take them."""

    planes: Shapes
    directions: FloatArray  # (row, col, 3) float64: Unit vectors d
    rays: FloatArray  # (row, col, 3, 3) float64: Ray through each centre, and its change to the next row and column


def flat(planes: FloatArray) -> Shapes:
    """Surfaces that are all planes (surface, 3)."""
    return Shapes(planes, np.full(len(planes), -1, np.int32), np.zeros((0, 1, 1)))


@borrowing
def inverse_of(shapes: Shapes, label: int, row: int, col: int, directions: FloatArray) -> float:
    """1 / r at which the beam of a pixel, of `directions` (row, col, 3), meets a surface; 0 or less: it does not."""
    place = shapes.smooth[label]
    if place >= 0:
        return float(shapes.inverse[place, row, col])
    total = 0.0
    for i in range(3):
        total += shapes.planes[label, i] * directions[row, col, i]
    return total


def inverses_of(
    shapes: Shapes, label: NDArray[np.int32], row: NDArray[np.intp], col: NDArray[np.intp], directions: FloatArray
) -> FloatArray:
    """The same for many surfaces and pixels, arrays (...); any number for a label below 0."""
    if not len(shapes.planes):
        return np.zeros(label.shape)
    values = np.asarray((shapes.planes[label] * directions[row, col]).sum(axis=-1))
    place = shapes.smooth[label]
    bent = place >= 0
    values[bent] = shapes.inverse[place[bent], row[bent], col[bent]]
    return values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothFits:
    """Patches of the smooth surfaces of a window, one for each layer of them.

    Parameters
    ----------
    item : (smooth surface, row, col) int32
        Patch of each surface in each pixel; -1: none.
    pixel : (item,) int64
        Pixel of each patch, row by row.
    patches : Patches
        The patches.
    mean_mm : (node,) float64
        Range of a smooth surface over the pixel of each of its layers; NaN for other layers.
    """

    item: NDArray[np.int32]
    pixel: IntArray
    patches: Patches
    mean_mm: FloatArray

    def inverses(self, row: int, fine: FloatArray) -> tuple[int, FloatArray]:
        """First patch of a row of pixels, and 1 / r (patch, part) of its patches in the parts of their pixels, 1/mm.

        `fine` is (factor, cols * factor, 3), unit vectors through the parts. A part that misses has the range of the
        nearest part that does not; 0 where all miss.
        """
        factor = fine.shape[0]
        cols = self.item.shape[2]
        first, last = np.searchsorted(self.pixel, [row * cols, (row + 1) * cols])
        parts = np.swapaxes(fine.reshape(factor, cols, factor, 3), 0, 1).reshape(cols, factor * factor, 3)
        some = np.arange(first, last)
        patches = self.patches.some(some)
        rays = parts[self.pixel[some] - row * cols]
        ranges = meet(patches.frame, patches.state[:, np.newaxis, :STATE], rays)[0][:, 0]
        hit = np.isfinite(ranges)
        out = np.where(hit, 1.0 / np.where(hit, ranges, 1.0), 0.0)
        for one in np.flatnonzero(hit.any(axis=1) & ~hit.all(axis=1)):
            known = np.flatnonzero(hit[one])
            nearest = (rays[one][~hit[one]] @ rays[one][known].T).argmax(axis=1)
            out[one, ~hit[one]] = out[one, known[nearest]]
        return int(first), out


def fit_smooth(nodes: Nodes, linked: Linked, smooth: Smooth | None) -> tuple[Shapes, SmoothFits | None]:
    """Fit the smooth surfaces in all pixels that see them.

    Parameters
    ----------
    nodes : Nodes
        The layers.
    linked : Linked
        Their surfaces.
    smooth : Smooth or None
        The smooth ones.
    """
    if smooth is None:
        return flat(linked.planes), None
    view = smooth.view
    rows, cols = view.shape
    which = linked.smooth[linked.label]
    pixels = nodes.row.astype(np.int64) * cols + nodes.col
    members = members_around(view.shape, smooth.segment, pixels, which.astype(np.int64), REACH, own=True)
    ours = np.flatnonzero((which >= 0) & ((members >= 0).sum(axis=1) >= LEAST_PIXELS))
    ours = ours[np.argsort(pixels[ours], kind="stable")]
    pixel, place = pixels[ours], which[ours]
    patches = fit_patches(view, pixel, members[ours], smooth.scales.bend[place], smooth.scales.third[place])
    ranges = meet(patches.frame, patches.state[:, np.newaxis], view.rays(pixel, PLACES_9))[0][:, 0]
    hit = np.isfinite(ranges)
    mean_mm = np.full(len(nodes), np.nan)
    mean_mm[ours] = np.where(
        hit.any(axis=1), np.where(hit, ranges, 0.0).sum(axis=1) / np.maximum(hit.sum(axis=1), 1), np.nan
    )
    item = np.full((len(smooth.scales.bend), rows, cols), -1, np.int32)
    item[place, nodes.row[ours], nodes.col[ours]] = np.arange(len(ours))
    inverse = _extended(nodes, which, mean_mm, item.shape)
    return (
        Shapes(linked.planes, linked.smooth, inverse),
        SmoothFits(item=item, pixel=pixel, patches=patches, mean_mm=mean_mm),
    )


def _extended(nodes: Nodes, which: NDArray[np.int32], mean_mm: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """1 / r (smooth surface, row, col) of each surface in its own pixels, and beyond them that of the nearest one."""
    known = np.isfinite(mean_mm)
    value = np.where(known, 1.0 / np.where(known, mean_mm, 1.0), nodes.inverse)
    places = np.indices(shape[1:]).reshape(2, -1).T
    out = np.zeros(shape)
    for place in range(shape[0]):
        own = np.flatnonzero(which == place)
        tree = cKDTree(np.stack([nodes.row[own], nodes.col[own]], axis=1))
        out[place] = value[own[tree.query(places)[1]]].reshape(shape[1:])
    return out
