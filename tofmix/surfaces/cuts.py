"""Cuts: where a surface ends within a pixel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    near: NDArray[np.int32]
    far: NDArray[np.int32]
    first: NDArray[np.int32]
    following: NDArray[np.int32]

    def __len__(self) -> int:
        """Cuts."""
        return len(self.row)


def make_cuts(shares: Shares) -> Cuts:
    """Make a cut between each two entries of a pixel."""
    entries = np.arange(shares.label.shape[2] - 1)
    row, col, entry = np.nonzero(entries < shares.count[..., np.newaxis] - 1)
    first = np.full(shares.count.shape, -1, np.int32)
    number = np.arange(len(row), dtype=np.int32)
    first[row[entry == 0], col[entry == 0]] = number[entry == 0]
    last = entry == shares.count[row, col] - 2
    return Cuts(
        row=row.astype(np.int32), col=col.astype(np.int32), near=shares.label[row, col, entry],
        far=shares.label[row, col, entry + 1], first=first,
        following=np.where(last, -1, number + 1).astype(np.int32),
    )  # fmt: skip
