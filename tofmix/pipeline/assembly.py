"""From finished cells to the layers file, in the cells' order.

Unmixing needs all rows of a window, so it is done here, when all cells are ready. So the bytes do not depend on the
engine. A few windows are unmixed at the same time.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import groupby, zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array
from tofmix.estimation.settings import MixingChoice
from tofmix.grid import Cell, Grid
from tofmix.io.layers.chunks import EncodedCell, decode_cell, decode_chunk, encode_cell, replace_chunk
from tofmix.io.layers.layers_file import LayersWriter
from tofmix.io.layers.provenance import read_header_image
from tofmix.layers import Layers, Provenance, layer_fields
from tofmix.lost_samples import learn_losses
from tofmix.mixing import MixingLaw
from tofmix.unmixing.rewriting import Rewritten
from tofmix.unmixing.unmix import unmix

Read = Callable[[Cell], EncodedCell]
"""Reads a cell."""

_WINDOWS_AT_ONCE = 2
"""Windows that are unmixed at the same time: each needs some 100 bytes a pixel, and some 100 MB of working memory."""


def total(tallies: Iterable[tuple[int, ...]]) -> tuple[int, ...]:
    """Add up pixels by their number of surfaces."""
    return tuple(sum(counts) for counts in zip_longest(*tallies, fillvalue=0))


def assemble(
    cells: Sequence[Cell],
    read: Read,
    header_file: Path,
    header: bytes,
    target: Path,
    *,
    overwrite: bool,
    inputs: tuple[Path, ...] = (),
    temporary: Path | None = None,
) -> tuple[tuple[int, ...], MixingLaw | None]:
    """Write the layers file from all cells in their order.

    Parameters
    ----------
    cells : sequence of Cell
        All cells of the grid.
    read : callable
        Gives a cell as it was encoded; a cell may be read twice.
    header_file, header
        From `tofmix.io.layers.provenance.header_image`, and the file that holds it.
    target : Path
        The layers file.
    overwrite, inputs, temporary
        As for `tofmix.io.layers.layers_file.LayersWriter`.

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
        if provenance.is_unmixed:
            return _unmixed(cells, read, grid, provenance, writer)
        return _written(cells, read, grid, provenance, writer), None


def _written(
    cells: Sequence[Cell], read: Read, grid: Grid, provenance: Provenance, writer: LayersWriter
) -> tuple[int, ...]:
    """Write cells as they are, but for the probabilities of pixels with lost samples; return the tally.

    Each cell is read twice, so that no more than one is in memory: what all pixels of a window lose is learnt first.
    """
    number = {spec.name: place for place, spec in enumerate(provenance.fields)}
    frames, tallies = grid.windows.length // provenance.samples_a_frame, []
    for group in _windows_together(cells, grid):
        lost = np.concatenate([_decoded(cell, read(cell), grid, provenance, number["invalid_share"])
                               for cell in group], axis=1)  # fmt: skip
        losses = [learn_losses(image, frames) for image in lost]
        for cell in group:
            encoded, own = read(cell), lost[:, cell.rows]
            if own.any():
                probability = _decoded(cell, encoded, grid, provenance, number["probability"])
                for values, shares, learnt in zip(probability, own, losses, strict=True):
                    values[:] = learnt.weighed(values, shares)
                encoded = replace_chunk(encoded, number["probability"], probability, shape=_chunk_of(grid))
            writer.write_chunks(cell.windows, cell.rows, encoded.chunks)
            tallies.append(encoded.tally)
    return total(tallies)


def _decoded(cell: Cell, encoded: EncodedCell, grid: Grid, provenance: Provenance, number: int) -> NDArray[np.float32]:
    """One dataset of a cell, (window, row, col) or (window, row, col, layer)."""
    spec, most = provenance.fields[number], int(provenance.options["max_layers"])
    return decode_chunk(encoded, number, spec, shape=_chunk_of(grid), max_layers=most, cell=_size_of(cell, grid))


def _chunk_of(grid: Grid) -> tuple[int, int, int]:
    """Windows, rows and columns of a stored chunk."""
    return (*grid.step, grid.image[1])


def _size_of(cell: Cell, grid: Grid) -> tuple[int, int, int]:
    """Windows, rows and columns of a cell."""
    return cell.windows.stop - cell.windows.start, cell.rows.stop - cell.rows.start, grid.image[1]


def _unmixed(
    cells: Sequence[Cell], read: Read, grid: Grid, provenance: Provenance, writer: LayersWriter
) -> tuple[tuple[int, ...], MixingLaw]:
    """Unmix the windows of each group of cells, and write them."""
    shape, frames = _chunk_of(grid), grid.windows.length // provenance.samples_a_frame
    tallies, shares, pixels = [], [], []
    with ThreadPoolExecutor(_WINDOWS_AT_ONCE, thread_name_prefix="tofmix-unmix") as pool:
        for places in _windows_together(cells, grid):
            layers, phasors = _whole([(cell, read(cell)) for cell in places], grid, provenance)
            results = list(pool.map(partial(_unmix, layers, phasors, provenance, frames), range(len(phasors))))
            first = places[0].windows.start
            for number, result in enumerate(results):
                writer.write_law(first + number, result.phasor_share, result.informative_pixels)
                shares.append(result.phasor_share)
                pixels.append(result.informative_pixels)
            for cell in places:
                part = Layers(**{
                    spec.name: np.stack([getattr(result.layers, spec.name)[cell.rows] for result in results])
                    for spec in provenance.fields
                })  # fmt: skip
                encoded = encode_cell(part, shape=shape)
                writer.write_chunks(cell.windows, cell.rows, encoded.chunks)
                tallies.append(encoded.tally)
    return total(tallies), MixingLaw.of_windows(np.array(shares), np.array(pixels))


def _windows_together(cells: Iterable[Cell], grid: Grid) -> Iterator[list[Cell]]:
    """Groups of cells of the same windows, which form whole images."""
    for _, members in groupby(cells, key=lambda cell: cell.index // grid.bands):
        yield list(members)


def _whole(group: list[tuple[Cell, EncodedCell]], grid: Grid, provenance: Provenance) -> tuple[Layers, Float32Array]:
    """Layers and mean phasors of the leading shape (window, row, col)."""
    fields = layer_fields(provenance.sensor, amplitude=provenance.has_amplitude)
    parts = []
    for cell, encoded in group:
        size, most = _size_of(cell, grid), int(provenance.options["max_layers"])
        parts.append(decode_cell(encoded, fields, shape=_chunk_of(grid), max_layers=most, cell=size))
    layers = Layers(**{spec.name: np.concatenate([getattr(part, spec.name) for part, _ in parts], axis=1)
                       for spec in fields})  # fmt: skip
    return layers, np.concatenate([phasors for _, phasors in parts], axis=1)


def _unmix(layers: Layers, phasors: Float32Array, provenance: Provenance, frames: int, window: int) -> Rewritten:
    """Unmix one window of layers (window, row, col) and their mean phasors; then let its lost samples count."""
    part = Layers(**{spec.name: getattr(layers, spec.name)[window] for spec in layers.fields})
    result = unmix(
        part, phasors[window], provenance.sensor, insist=provenance.options["mixing"] == MixingChoice.PHASOR,
        circle_mm=provenance.unambiguous_range_mm,
    )  # fmt: skip
    found = result.layers
    assert found.invalid_share is not None  # noqa: S101  every estimate has it
    probability = learn_losses(found.invalid_share, frames).weighed(found.probability, found.invalid_share)
    return replace(result, layers=replace(found, probability=probability))
