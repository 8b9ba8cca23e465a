"""Marks of suspect layers while a layers file is put together: judged window by window, written when all are known."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import IntArray
from tofmix.grid import Cell, Grid
from tofmix.io.layers.chunks import EncodedCell, decode_evidence
from tofmix.io.layers.layers_file import LayersWriter
from tofmix.layers import Layers, Provenance
from tofmix.suspicion.judge import judge
from tofmix.suspicion.scene import WindowSamples, joined


@dataclass
class Marks:
    """The marks of the windows so far; only marked layers are kept.

    Parameters
    ----------
    grid : Grid
        The cells.
    provenance : Provenance
        Source and options of the layers.
    """

    grid: Grid
    provenance: Provenance
    _found: list[tuple[IntArray, NDArray[np.uint8], NDArray[np.uint32]]] = field(default_factory=list)

    @property
    def max_layers(self) -> int:
        """Length of the layer axis."""
        return int(self.provenance.options["max_layers"])

    def add(self, group: list[tuple[Cell, EncodedCell]], layers: list[Layers]) -> None:
        """Judge the windows of a group of cells that form whole images, whose layers (row, col) are final."""
        pieces: list[list[tuple[int, int, WindowSamples]]] = [[] for _ in layers]
        for cell, encoded in group:
            for window, part in enumerate(decode_evidence(encoded, cell.windows.stop - cell.windows.start)):
                pieces[window].append((cell.rows.start, 0, part))
        first = group[0][0].windows.start
        stride = self.grid.windows.stride // self.provenance.samples_a_frame
        for number, (image, parts) in enumerate(zip(layers, pieces, strict=True), start=first):
            flags, frames = judge(
                image,
                joined(parts),
                self.provenance.sensor,
                first_frame=number * stride,
                circle_mm=self.provenance.unambiguous_range_mm,
            )
            place = np.flatnonzero(flags).astype(np.int64)
            self._found.append((place, flags.ravel()[place], frames.reshape(-1, 2)[place]))

    def write(self, writer: LayersWriter) -> None:
        """Write all marks, if there is any."""
        if not any(len(place) for place, _, _ in self._found):
            return
        passing = any(frames.any() for _, _, frames in self._found)
        step, shape = self.grid.step[0], (*self.grid.image, self.max_layers)
        for start in range(0, len(self._found), step):
            some = self._found[start : start + step]
            suspect = np.zeros((len(some), int(np.prod(shape))), np.uint8)
            ends = np.zeros((*suspect.shape, 2), np.uint32)
            for window, (place, flags, frames) in enumerate(some):
                suspect[window, place], ends[window, place] = flags, frames
            windows = slice(start, start + len(some))
            writer.write_suspects(
                windows, suspect.reshape(-1, *shape), ends.reshape(-1, *shape, 2) if passing else None
            )
