"""Datasets whose chunks cannot unpack to more than they declare.

gzip unpacks 1 byte to up to 1032, and the HDF5 library unpacks to the end of the data, beyond the declared size of the
chunk. So a stored chunk that could become large is unpacked here first, without keeping it, and refused if it is larger
than declared. `tofmix.io.guard.guard` hands out every dataset as a `BoundedDataset`.
"""

import itertools
import math
import zlib
from collections.abc import Iterator
from typing import Any

import h5py

from tofmix.io.guard.structure_rules import LIMITS

GZIP, FLETCHER32 = 1, 3  # HDF5's numbers of these filters

MOST_GZIP = 1040
"""Bytes that one packed byte can become at most, and some more."""

UNCHECKED_BYTES = 512 << 20
"""A chunk that cannot become larger than this is not unpacked twice."""

_PIECE_BYTES = 1 << 20  # packed bytes that are unpacked at once


class BoundedDataset(h5py.Dataset):  # type: ignore[misc]  # h5py has no types
    """A dataset for reading; it raises OSError where a chunk unpacks to more than its declared size."""

    def __init__(self, bind: h5py.h5d.DatasetID) -> None:
        super().__init__(bind, readonly=True)
        self._codes = filters_of(bind)
        self._size = math.prod(self.chunks or ()) * self.dtype.itemsize
        self._passed: set[tuple[int, ...]] = set()
        self._may_burst = GZIP in self._codes and _largest_stored(bind) * MOST_GZIP > UNCHECKED_BYTES

    def __getitem__(self, args: Any, new_dtype: Any = None) -> Any:  # noqa: ANN401  as h5py has it
        if self._may_burst:
            for place in self._touched(args if isinstance(args, tuple) else (args,)):
                if place not in self._passed:
                    self._check(place)
                    self._passed.add(place)
        return super().__getitem__(args, new_dtype)

    def _touched(self, args: tuple[Any, ...]) -> Iterator[tuple[int, ...]]:
        """Where the chunks begin that a selection touches; of an axis that is not chosen by a slice, all."""
        rank = self.ndim
        if Ellipsis in args:
            at = args.index(Ellipsis)
            args = (*args[:at], *(slice(None),) * (rank - len(args) + 1), *args[at + 1 :])
        args = (*args, *(slice(None),) * (rank - len(args)))
        axes = []
        for chosen, length, step in zip(args, self.shape, self.chunks, strict=True):
            if isinstance(chosen, int):
                first, stop = chosen % length, chosen % length + 1
            elif isinstance(chosen, slice):
                first, stop, _ = chosen.indices(length)
            else:
                first, stop = 0, length
            axes.append(range(first - first % step, stop, step))
        return itertools.product(*axes)

    def _check(self, place: tuple[int, ...]) -> None:
        info = self.id.get_chunk_info_by_coord(place)
        if info.byte_offset is None or info.size * MOST_GZIP <= UNCHECKED_BYTES:
            return
        mask, data = self.id.read_direct_chunk(place)
        if mask >> self._codes.index(GZIP) & 1:
            return  # it is not packed
        inflate, left, view = zlib.decompressobj(), self._size, memoryview(data)
        for start in range(0, len(view), _PIECE_BYTES):
            piece = bytes(view[start : start + _PIECE_BYTES])
            while piece and not inflate.eof:
                left -= len(inflate.decompress(piece, _PIECE_BYTES))
                if left < 0:
                    raise OSError(f"the chunk at {place} unpacks to more than the {self._size} bytes that it declares")
                piece = inflate.unconsumed_tail


def filters_of(bind: h5py.h5d.DatasetID) -> list[int]:
    """Numbers of the filters of a dataset, in order."""
    plist = bind.get_create_plist()
    return [plist.get_filter(number)[0] for number in range(plist.get_nfilters())]


def _largest_stored(bind: h5py.h5d.DatasetID) -> int:
    """Bytes of the largest stored chunk; from its declared size if that is sufficient."""
    chunk = bind.get_create_plist().get_chunk()
    declared: int = math.prod(chunk) * bind.get_type().get_size()
    count = math.prod(-(-length // step) for length, step in zip(bind.shape, chunk, strict=True))
    # If the guard has checked the chunks, no stored chunk is larger than three times its declared size.
    if count <= LIMITS.walked_chunks and 3 * declared * MOST_GZIP <= UNCHECKED_BYTES:
        return declared
    largest = [0]

    def see(info: h5py.h5d.StoreInfo) -> None:
        largest[0] = max(largest[0], info.size)

    bind.chunk_iter(see)
    return largest[0]
