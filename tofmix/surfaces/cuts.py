"""Cuts: where a surface ends within a pixel, or at its border."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.surfaces.found import NO_SURFACE
from tofmix.surfaces.settings import ShareSettings
from tofmix.surfaces.shapes import Shapes, inverses_of
from tofmix.surfaces.shares import Shares


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cuts:
    """The cuts of one window, by row, column, and near to far.

    Parameters
    ----------
    row, col : (cut,) int32
        Pixel.
    near, far : (cut,) int32
        Surface that ends there, and the next one that the pixel sees; `NO_SURFACE`: open space.
    first : (row, col) int32
        Number of the first cut of each pixel; -1: it has none.
    following : (cut,) int32
        Number of the pixel's next cut; -1 after the last.
    entry : (cut,) int32
        Cuts of the pixel that are nearer.
    margin : (cut,) float64
        Distance beyond the pixel's border up to which the edge may lie: 0 for a cut within the pixel.
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    near: NDArray[np.int32]
    far: NDArray[np.int32]
    first: NDArray[np.int32]
    following: NDArray[np.int32]
    entry: NDArray[np.int32]
    margin: FloatArray

    def __len__(self) -> int:
        """Cuts."""
        return len(self.row)


def make_cuts(shares: Shares, planes: Shapes, directions: FloatArray, settings: ShareSettings) -> Cuts:
    """Make a cut between each two entries of a pixel, and one in each pixel at whose border its only surface ends.

    Parameters
    ----------
    shares : Shares
        Surfaces in each pixel.
    planes : Shapes
        Of the surfaces.
    directions : (row, col, 3) float64
        Unit vectors d.
    settings : ShareSettings
        Thresholds.
    """
    entries = np.arange(shares.label.shape[2] - 1)
    row, col, entry = np.nonzero(entries < shares.count[..., np.newaxis] - 1)
    at_border, behind = _borders(shares, planes, directions, settings.crease)
    border = np.nonzero(at_border)
    number = np.arange(len(row) + len(border[0]), dtype=np.int32)
    inner = number[: len(row)]
    first = np.full(shares.count.shape, -1, np.int32)
    first[row[entry == 0], col[entry == 0]] = inner[entry == 0]
    first[border] = number[len(row) :]
    last = entry == shares.count[row, col] - 2
    return Cuts(
        row=np.concatenate([row, border[0]]).astype(np.int32),
        col=np.concatenate([col, border[1]]).astype(np.int32),
        near=np.concatenate([shares.label[row, col, entry], shares.label[(*border, 0)]]),
        far=np.concatenate([shares.label[row, col, entry + 1], behind[border]]),
        first=first,
        following=np.concatenate([np.where(last, -1, inner + 1), np.full(len(border[0]), -1)]).astype(np.int32),
        entry=np.concatenate([entry, np.zeros(len(border[0]))]).astype(np.int32),
        margin=np.where(number < len(row), 0.0, settings.border_margin),
    )


def _borders(
    shares: Shares, planes: Shapes, directions: FloatArray, crease: float
) -> tuple[BoolArray, NDArray[np.int32]]:
    """Pixels (row, col) that one surface fills and next to which it is not seen, and the surface behind it there."""
    rows, cols = shares.count.shape
    alone = (shares.count == 1) & (shares.label[..., 0] != NO_SURFACE)
    found = np.zeros((rows, cols), bool)
    behind = np.full((rows, cols), NO_SURFACE, np.int32)
    places = np.indices((rows, cols))
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        here = (slice(max(0, -down), rows - max(0, down)), slice(max(0, -right), cols - max(0, right)))
        there = (slice(max(0, down), rows - max(0, -down)), slice(max(0, right), cols - max(0, -right)))
        surface = shares.label[here][..., 0]
        plane = inverses_of(planes, surface, places[0][there], places[1][there], directions)
        ends = alone[here] & (shares.count[there] > 0) & (shares.label[there] != surface[..., np.newaxis]).all(axis=-1)
        ends &= (plane > 0) & (shares.inverse[there][..., 0] * (1.0 + crease) < plane)
        new = ends & ~found[here]
        behind[here][new] = shares.label[there][..., 0][new]
        found[here] |= ends
    return found, behind
