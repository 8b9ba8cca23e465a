"""Edges as lines, in the image and in space, for the formats that draw them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import FloatArray
from tofmix.io.exporters.placing import on_surfaces
from tofmix.io.surfaces.surfaces_file import SurfacesFile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeLine:
    """A piece of a line of an edge that has the same two surfaces on its sides.

    Parameters
    ----------
    window, line : int
        Window; number of the line in the file.
    near, far : int
        Numbers of the surfaces, -1: none.
    row, col, stderr : (n,) float32
        Points, and their standard errors across the edge, pixels.
    place_m : (n, 3) float64
        Points on the nearer surface, metres; NaN where the beam does not meet it.
    """

    window: int
    line: int
    near: int
    far: int
    row: NDArray[np.float32]
    col: NDArray[np.float32]
    stderr: NDArray[np.float32]
    place_m: FloatArray

    def runs(self) -> list[slice]:
        """Runs of points that have a place in space."""
        known = np.isfinite(self.place_m).all(axis=-1)
        ends = np.flatnonzero(np.diff(known, prepend=False, append=False))
        return [slice(int(start), int(stop)) for start, stop in zip(ends[::2], ends[1::2], strict=True)]


def edge_lines(file: SurfacesFile, windows: Sequence[int]) -> list[EdgeLine]:
    """Lines of some windows, in the order of the file.

    Where a line passes from one pair of surfaces to another, both pieces have the first point of the second.
    """
    return [line for window in windows for line in _lines_of_window(file, window)]


def _lines_of_window(file: SurfacesFile, window: int) -> Iterator[EdgeLine]:
    edges = file.read_edges(window)
    if not len(edges):
        return
    keys = np.stack([edges.line, edges.near, edges.far])
    starts = np.flatnonzero(np.r_[True, (keys[:, 1:] != keys[:, :-1]).any(axis=0)])
    for start, end in zip(starts, [*starts[1:], len(edges)], strict=True):
        goes_on = end < len(edges) and edges.line[end] == edges.line[start]
        part = slice(int(start), int(end) + bool(goes_on))
        near, far = int(edges.near[start]), int(edges.far[start])
        row, col = edges.row[part], edges.col[part]
        on = np.full(len(row), near if near >= 0 else far)
        yield EdgeLine(
            window=window,
            line=int(edges.line[start]),
            near=near,
            far=far,
            row=row,
            col=col,
            stderr=edges.stderr[part],
            place_m=on_surfaces(file, window, on, row, col),
        )
