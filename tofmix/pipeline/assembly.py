"""From finished cells to the layers file, in the cells' order.

Unmixing, lost samples and suspicions need all rows of a window, so they are done here, when all cells are ready. So the
bytes do not depend on the engine. A few windows are finished at the same time.

Marks of suspect layers are judged window by window, and written when all are known.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby, zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array, IntArray
from tofmix.estimation.blocks.finishing import FinishedWindow, finish_window
from tofmix.estimation.settings import MixingChoice
from tofmix.flags import MixingLaw
from tofmix.grid import Cell, Grid
from tofmix.io.layers.chunks import EncodedCell, decode_cell, decode_evidence, encode_cell
from tofmix.io.layers.layers_file import LayersWriter, read_header_image
from tofmix.layers import Layers, Provenance, layer_fields
from tofmix.suspicion import judge
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


def total(tallies: Iterable[tuple[int, ...]]) -> tuple[int, ...]:
    """Add up pixels by their number of surfaces."""
    return tuple(sum(counts) for counts in zip_longest(*tallies, fillvalue=0))


def assemble(
    cells: Iterable[tuple[Cell, EncodedCell]],
    header_file: Path,
    header: bytes,
    target: Path,
    *,
    overwrite: bool,
    inputs: tuple[Path, ...] = (),
    temporary: Path | None = None,
) -> tuple[tuple[int, ...], MixingLaw | None]:
    """Write the layers file from all cells in their order.

    Returns
    -------
    ((n,) int, MixingLaw or None)
        Pixels by their number of surfaces; the law of mixing, if it was measured.
    """
    provenance, grid = read_header_image(header, header_file)
    writer = LayersWriter(
        target,
        windows=grid.windows.in_frames(provenance.samples_a_frame),
        image=grid.image,
        max_layers=int(provenance.options["max_layers"]),
        tile=grid.step,
        provenance=provenance,
        overwrite=overwrite,
        inputs=inputs,
        temporary=temporary,
    )
    with writer:
        marks = Marks(grid, provenance)
        made = _written(cells, grid, provenance, writer, marks)
        marks.write(writer)
        return made


def _written(
    cells: Iterable[tuple[Cell, EncodedCell]], grid: Grid, provenance: Provenance, writer: LayersWriter, marks: Marks
) -> tuple[tuple[int, ...], MixingLaw | None]:
    """Finish the windows of each group of cells, judge them, and write them."""
    tallies, shares, pixels = [], [], []
    # Windows that are unmixed at the same time: each needs some 100 bytes a pixel, and some 100 MB of working memory.
    windows_at_once = 2
    with ThreadPoolExecutor(windows_at_once, thread_name_prefix="tofmix-finish") as pool:
        for group in _groups(cells, grid):
            layers, phasors = _whole(group, grid, provenance)
            results = list(pool.map(partial(_finished, layers, phasors, provenance, grid), range(layers.shape[0])))
            marks.add(group, [result.layers for result in results])
            first = group[0][0].windows.start
            for number, result in enumerate(results):
                if result.phasor_share is not None and result.phasor_pixels is not None:
                    writer.write_law(first + number, result.phasor_share, result.phasor_pixels)
                    shares.append(result.phasor_share)
                    pixels.append(result.phasor_pixels)
            for cell, encoded in group:
                changed = _encoded(cell, encoded, layers, results, grid, provenance)
                writer.write_chunks(cell.windows, cell.rows, changed.chunks)
                tallies.append(changed.tally)
    return total(tallies), MixingLaw.of_windows(np.array(shares), np.array(pixels)) if shares else None


def _encoded(
    cell: Cell, encoded: EncodedCell, before: Layers, results: list[FinishedWindow], grid: Grid, provenance: Provenance
) -> EncodedCell:
    """The cell with the finished layers; as it is where they are those before."""
    if not provenance.has_mixing and all(
        np.array_equal(result.layers.probability[cell.rows], before.probability[window, cell.rows], equal_nan=True)
        for window, result in enumerate(results)
    ):
        return encoded
    part = Layers(
        **{
            spec.name: np.stack([getattr(result.layers, spec.name)[cell.rows] for result in results])
            for spec in provenance.fields
        }
    )
    return encode_cell(part, shape=(*grid.step, grid.image[1]))


def _groups(cells: Iterable[tuple[Cell, EncodedCell]], grid: Grid) -> Iterator[list[tuple[Cell, EncodedCell]]]:
    """Groups of cells of the same windows, which form whole images."""
    for _, members in groupby(cells, key=lambda item: item[0].index // grid.bands):
        yield list(members)


def _whole(
    group: list[tuple[Cell, EncodedCell]], grid: Grid, provenance: Provenance
) -> tuple[Layers, Float32Array | None]:
    """Layers, and mean phasors if there are any, of the leading shape (window, row, col)."""
    fields = layer_fields(provenance.sensor, amplitude=provenance.has_amplitude)
    parts = []
    for cell, encoded in group:
        size = (cell.windows.stop - cell.windows.start, cell.rows.stop - cell.rows.start, grid.image[1])
        most = int(provenance.options["max_layers"])
        parts.append(decode_cell(encoded, fields, shape=(*grid.step, grid.image[1]), max_layers=most, cell=size))
    layers = Layers(
        **{spec.name: np.concatenate([getattr(part, spec.name) for part, _ in parts], axis=1) for spec in fields}
    )
    known = [phasors for _, phasors in parts if phasors is not None]
    return layers, np.concatenate(known, axis=1) if known else None


def _finished(
    layers: Layers, phasors: Float32Array | None, provenance: Provenance, grid: Grid, window: int
) -> FinishedWindow:
    """Finish one window of layers (window, row, col) and their mean phasors."""
    part = Layers(**{spec.name: getattr(layers, spec.name)[window] for spec in layers.fields})
    return finish_window(
        part,
        None if phasors is None else phasors[window],
        provenance.sensor,
        frames=grid.windows.length // provenance.samples_a_frame,
        insist=provenance.options.get("mixing") == MixingChoice.PHASOR,
        circle_mm=provenance.unambiguous_range_mm,
    )
