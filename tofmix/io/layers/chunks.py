"""Cells of layers as the bytes that a layers file stores.

Workers make the chunks, as compression holds no lock; the writer then only places
them. HDF5's own filters are repeated here step by step: shuffle, gzip, Fletcher-32.
The same layers give the same bytes wherever they are made.
"""

import zlib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array
from tofmix.layers import LayerField, Layers
from tofmix.suspicion.scene import CLUSTER_FIELDS, WindowSamples

_EVIDENCE_CHUNKS = 3  # clusters in time, the memory of samples, and sampled pixels


class EncodedCell(NamedTuple):
    """One chunk for each dataset of the layers, and how many pixels have 0, 1, 2, ... surfaces.

    Where layers are still to be unmixed, another chunk holds the mean phasors. In journals, the last three hold
    the evidence of suspicions: clusters in time, memory, and sampled pixels.
    """

    tally: tuple[int, ...]
    chunks: tuple[bytes, ...]


def encode_cell(
    layers: Layers,
    phasors: Float32Array | None = None,
    evidence: Sequence[WindowSamples] = (),
    *,
    shape: tuple[int, int, int],
) -> EncodedCell:
    """Encode the layers (window, row, col) of a cell.

    `phasors` (window, row, col, 7) are the mean phasors of the same pixels (`tofmix.unmixing.image`), `evidence` is
    that of each window. `shape` is the leading shape of a stored chunk; a cell at the far edge is filled up to it.
    """
    tally = np.bincount(layers.n_modes.ravel(), minlength=layers.max_layers + 1)
    chunks = tuple(_chunks(layers, shape))
    if phasors is not None:
        chunks = (*chunks, _packed(np.ascontiguousarray(phasors, dtype="<f4")))
    if evidence:
        chunks = (*chunks, *_evidence_chunks(evidence))
    return EncodedCell(tuple(tally.tolist()), chunks)


def decode_cell(
    encoded: EncodedCell,
    fields: tuple[LayerField, ...],
    *,
    shape: tuple[int, int, int],
    max_layers: int,
    cell: tuple[int, int, int],
) -> tuple[Layers, Float32Array | None]:
    """Decode a cell that `encode_cell` made with evidence, with its mean phasors (window, row, col, 7) if it has any.

    `fields` are the datasets of its layers, `shape` is the leading shape of a stored chunk, and `cell` are the windows,
    rows and columns of the cell itself.
    """
    arrays: dict[str, Any] = {}
    for spec, chunk in zip(fields, encoded.chunks, strict=False):
        whole = spec.full_shape(shape, max_layers)
        values = _unpacked(chunk, np.dtype(spec.dtype).newbyteorder("<")).reshape(whole)
        arrays[spec.name] = values[: cell[0], : cell[1], : cell[2]].astype(spec.dtype)
    if len(encoded.chunks) == len(fields) + _EVIDENCE_CHUNKS:
        return Layers(**arrays), None
    phasors = _unpacked(encoded.chunks[len(fields)], np.dtype("<f4")).reshape(*cell, -1)
    return Layers(**arrays), phasors.astype(np.float32)


def decode_evidence(encoded: EncodedCell, windows: int) -> list[WindowSamples]:
    """Decode the evidence of each window of a cell of so many windows."""
    times, sums, some = encoded.chunks[-_EVIDENCE_CHUNKS:]
    clusters = _unpacked(times, np.dtype("<f8")).astype(np.float64).reshape(-1, 1 + len(CLUSTER_FIELDS))
    memory = _unpacked(sums, np.dtype("<f8")).astype(np.float64).reshape(windows, -1)
    length, *lines = np.split(_unpacked(some, np.dtype("<f4")).astype(np.float32), [1])
    sampled = lines[0].reshape(-1, int(length[0]))
    return [
        WindowSamples(clusters[clusters[:, 0] == window, 1:], memory[window], sampled[sampled[:, 0] == window, 1:])
        for window in range(windows)
    ]


def fill_of(spec: LayerField) -> float:
    """Value of pixels that were not estimated: NaN, 0 for integers."""
    return np.nan if spec.dtype.startswith("f") else 0


def _evidence_chunks(evidence: Sequence[WindowSamples]) -> tuple[bytes, ...]:
    clusters = _by_window([part.clusters for part in evidence])
    sampled = _by_window([part.sampled for part in evidence])
    memory = np.stack([part.memory for part in evidence])
    some = np.concatenate([[sampled.shape[1]], sampled.ravel()])  # their length first: there may be none
    return _packed(clusters.astype("<f8")), _packed(memory.astype("<f8")), _packed(some.astype("<f4"))


def _by_window(lines: list[NDArray[Any]]) -> NDArray[Any]:
    """Lines (n, ...) of all windows, each with the number of its window first."""
    return np.concatenate([np.column_stack([np.full(len(part), float(n)), part]) for n, part in enumerate(lines)])


def _chunks(layers: Layers, shape: tuple[int, int, int]) -> Iterator[bytes]:
    for spec in layers.fields:
        values = np.ascontiguousarray(getattr(layers, spec.name), dtype=np.dtype(spec.dtype).newbyteorder("<"))
        if values.shape[:3] != shape:
            whole = np.full((*shape, *values.shape[3:]), fill_of(spec), dtype=values.dtype)
            windows, rows, cols = values.shape[:3]
            whole[:windows, :rows, :cols] = values
            values = whole
        yield _packed(values)


def _packed(values: NDArray[Any]) -> bytes:
    """Shuffled, compressed, and with a checksum."""
    compression_level = 1  # the fastest level of gzip: packing must not slow down the kernels
    packed = zlib.compress(_shuffled(values), compression_level)
    return packed + fletcher32(packed).to_bytes(4, "little")


def _unpacked(chunk: bytes, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Values of a chunk, flat; the journal has a separate checksum over it."""
    data = np.frombuffer(zlib.decompress(chunk[:-4]), dtype=np.uint8)
    return np.ascontiguousarray(data.reshape(dtype.itemsize, -1).T).reshape(-1).view(dtype)


def _shuffled(values: NDArray[Any]) -> bytes:
    """First bytes of all values, then second ones, and so on: they resemble each other."""
    return values.reshape(-1).view(np.uint8).reshape(-1, values.itemsize).T.tobytes()


def fletcher32(data: bytes) -> int:
    """Fletcher's checksum as HDF5 computes it, over big-endian words of 16 bits, of at most 2^25 bytes.

    An odd last byte is the high one of a word.

    References
    ----------
    Fletcher, IEEE Trans. Commun. 30 (1982), 247; H5_checksum_fletcher32 of the HDF5 library.
    """
    words = np.frombuffer(data + b"\0" * (len(data) % 2), dtype=">u2").astype(np.int64)
    # The library folds carries back in: the sums modulo 65535, with 65535 for a sum that is not 0 but divisible.
    first, second = int(words.sum()), int(words @ np.arange(len(words), 0, -1))
    low, high = (total and (total - 1) % 0xFFFF + 1 for total in (first, second))
    return high << 16 | low
