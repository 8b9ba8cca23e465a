"""From finished cells to the layers file, in the cells' order.

Unmixing needs all rows of a window, so it is done here, when all cells are ready. So the bytes do not depend on the
engine. A few windows are unmixed at the same time.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import groupby, zip_longest
from pathlib import Path

import numpy as np

from tofmix.arrays import Float32Array
from tofmix.estimation.settings import MixingChoice
from tofmix.grid import Cell, Grid
from tofmix.io.layers.chunks import EncodedCell, decode_cell, encode_cell
from tofmix.io.layers.layers_file import LayersWriter
from tofmix.io.layers.provenance import read_header_image
from tofmix.layers import Layers, Provenance, layer_fields
from tofmix.mixing import MixingLaw
from tofmix.pipeline.suspects import Marks
from tofmix.unmixing.rewriting import Rewritten
from tofmix.unmixing.unmix import unmix

_WINDOWS_AT_ONCE = 2
"""Windows that are unmixed at the same time: each needs some 100 bytes a pixel, and some 100 MB of working memory."""


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
        put = _unmixed if provenance.is_unmixed else _as_they_are
        made = put(cells, grid, provenance, writer, marks)
        marks.write(writer)
        return made


def _as_they_are(
    cells: Iterable[tuple[Cell, EncodedCell]], grid: Grid, provenance: Provenance, writer: LayersWriter, marks: Marks
) -> tuple[tuple[int, ...], None]:
    """Write cells whose layers are final."""
    tallies = []
    for group in _groups(cells, grid):
        layers, _ = _whole(group, grid, provenance)
        marks.add(group, _windows(layers))
        for cell, encoded in group:
            writer.write_chunks(cell.windows, cell.rows, encoded.chunks)
            tallies.append(encoded.tally)
    return total(tallies), None


def _unmixed(
    cells: Iterable[tuple[Cell, EncodedCell]], grid: Grid, provenance: Provenance, writer: LayersWriter, marks: Marks
) -> tuple[tuple[int, ...], MixingLaw]:
    """Unmix the windows of each group of cells, and write them."""
    shape = (*grid.step, grid.image[1])
    tallies, shares, pixels = [], [], []
    with ThreadPoolExecutor(_WINDOWS_AT_ONCE, thread_name_prefix="tofmix-unmix") as pool:
        for group in _groups(cells, grid):
            places = [cell for cell, _ in group]
            layers, phasors = _whole(group, grid, provenance)
            assert phasors is not None  # noqa: S101  cells of a recording that is unmixed have them
            results = list(pool.map(partial(_unmix, layers, phasors, provenance), range(len(phasors))))
            marks.add(group, [result.layers for result in results])
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


def _groups(cells: Iterable[tuple[Cell, EncodedCell]], grid: Grid) -> Iterator[list[tuple[Cell, EncodedCell]]]:
    """Groups of cells of the same windows, which form whole images."""
    for _, members in groupby(cells, key=lambda item: item[0].index // grid.bands):
        yield list(members)


def _windows(layers: Layers) -> list[Layers]:
    """Layers (row, col) of each window of layers (window, row, col)."""
    return [
        Layers(**{spec.name: getattr(layers, spec.name)[window] for spec in layers.fields})
        for window in range(layers.shape[0])
    ]


def _whole(
    group: list[tuple[Cell, EncodedCell]], grid: Grid, provenance: Provenance
) -> tuple[Layers, Float32Array | None]:
    """Layers, and mean phasors if there are any, of the leading shape (window, row, col)."""
    fields = layer_fields(provenance.sensor)
    parts = []
    for cell, encoded in group:
        size = (cell.windows.stop - cell.windows.start, cell.rows.stop - cell.rows.start, grid.image[1])
        most = int(provenance.options["max_layers"])
        parts.append(decode_cell(encoded, fields, shape=(*grid.step, grid.image[1]), max_layers=most, cell=size))
    layers = Layers(**{spec.name: np.concatenate([getattr(part, spec.name) for part, _ in parts], axis=1)
                       for spec in fields})  # fmt: skip
    known = [phasors for _, phasors in parts if phasors is not None]
    return layers, np.concatenate(known, axis=1) if known else None


def _unmix(layers: Layers, phasors: Float32Array, provenance: Provenance, window: int) -> Rewritten:
    """Unmix one window of layers (window, row, col) and their mean phasors."""
    part = Layers(**{spec.name: getattr(layers, spec.name)[window] for spec in layers.fields})
    return unmix(
        part, phasors[window], provenance.sensor, insist=provenance.options["mixing"] == MixingChoice.PHASOR,
        circle_mm=provenance.unambiguous_range_mm,
    )  # fmt: skip
