"""Cells of layers as the bytes that a layers file stores.

Workers make the chunks, as compression holds no lock; the writer then only places
them. HDF5's own filters are repeated here step by step: shuffle, gzip, Fletcher-32.
The same layers give the same bytes wherever they are made.
"""

import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tofmix.layers import LayerField, Layers

COMPRESSION_LEVEL = 1
"""The fastest that gzip has: packing must not hold up the kernels."""


class EncodedCell(NamedTuple):
    """One chunk for each dataset of the layers, and how many pixels have 0, 1, 2, ... surfaces."""

    tally: tuple[int, ...]
    chunks: tuple[bytes, ...]


def encode_cell(layers: Layers, shape: tuple[int, int, int]) -> EncodedCell:
    """Encode the layers of a cell.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (window, row, col).
    shape : (int, int, int)
        The leading shape of a stored chunk; a cell at the far edge is filled up to it.

    Returns
    -------
    EncodedCell
        The cell.
    """
    tally = np.bincount(layers.n_modes.ravel(), minlength=layers.max_layers + 1)
    return EncodedCell(tuple(tally.tolist()), tuple(_chunks(layers, shape)))


def fill_of(spec: LayerField) -> float:
    """What stands where nothing was estimated: NaN, 0 for integers."""
    return np.nan if spec.dtype.startswith("f") else 0


def _chunks(layers: Layers, shape: tuple[int, int, int]) -> Iterator[bytes]:
    for spec in layers.fields:
        values = np.ascontiguousarray(getattr(layers, spec.name), dtype=np.dtype(spec.dtype).newbyteorder("<"))
        if values.shape[:3] != shape:
            whole = np.full((*shape, *values.shape[3:]), fill_of(spec), dtype=values.dtype)
            windows, rows, cols = values.shape[:3]
            whole[:windows, :rows, :cols] = values
            values = whole
        packed = zlib.compress(_shuffled(values), COMPRESSION_LEVEL)
        yield packed + fletcher32(packed).to_bytes(4, "little")


def _shuffled(values: NDArray[Any]) -> bytes:
    """First bytes of all values, then second ones, and so on: they resemble each other."""
    return values.reshape(-1).view(np.uint8).reshape(-1, values.itemsize).T.tobytes()


def fletcher32(data: bytes) -> int:
    """Fletcher's checksum as HDF5 computes it, over big-endian words of 16 bits.

    Parameters
    ----------
    data : bytes
        At most 2^25 bytes; an odd last one is the high byte of a word.

    Returns
    -------
    int
        32 bits.

    References
    ----------
    Fletcher, IEEE Trans. Commun. 30 (1982), 247; H5_checksum_fletcher32 of the HDF5 library.
    """
    words = np.frombuffer(data + b"\0" * (len(data) % 2), dtype=">u2").astype(np.int64)
    # The library folds carries back in: the sums modulo 65535, with 65535 for a sum that is not 0 but divisible.
    first, second = int(words.sum()), int(words @ np.arange(len(words), 0, -1))
    low, high = (total and (total - 1) % 0xFFFF + 1 for total in (first, second))
    return high << 16 | low
