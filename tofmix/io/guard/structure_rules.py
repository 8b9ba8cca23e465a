"""Rules on the structure of an HDF5 file, applied before a byte of data is read.

A file's header may claim anything: data that lie in other files, petabytes, a chunk of many gigabytes.
`check_structure` checks every object, and refuses those that refer to other files or need memory without bound. It
belongs in a process that may hang or crash, for the library itself does so on some damaged files: `guard` sees to that.

Datasets whose chunks cannot unpack to more than they declare.

gzip unpacks 1 byte to up to 1032, and the HDF5 library unpacks to the end of the data, beyond the declared size of the
chunk. So a stored chunk that could become large is unpacked here first, without keeping it, and refused if it is larger
than declared. `tofmix.io.guard.guard` hands out every dataset as a `BoundedDataset`.
"""

import itertools
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import h5py
import numpy as np

from tofmix.bounds import WholeNumber, check_bounds

FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 4: "szip", 5: "nbit", 6: "scaleoffset", 32000: "lzf"}
"""Accepted filters by their numbers: those of the library, none that is loaded from a path."""

_OWN_COUNT = ("nbit", "scaleoffset")
"""Filters that believe their own parameters as to how many values they give."""

_Object: TypeAlias = "h5py.h5g.GroupID | h5py.h5d.DatasetID | h5py.h5t.TypeID"


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Sizes up to which a file is read."""

    objects: WholeNumber = 20_000  # groups, datasets and types of a file; more would take too long to walk
    rank: WholeNumber = 8  # dimensions; files of tofmix have 4 at most
    chunk_bytes: WholeNumber = 256 << 20  # a chunk is unpacked whole, however little of it is read
    lzf_chunk_bytes: WholeNumber = 16 << 20  # lzf cannot be checked before unpacking, and grows by 90 at most
    chunk_slack_bytes: WholeNumber = 64 << 10  # of a stored chunk beyond twice its size: headers and checksums
    dataset_bytes: WholeNumber = 1 << 44  # declared: larger than any disk that a recording is on
    expansion: WholeNumber = 2000  # declared bytes for one of the file, twice what gzip reaches
    always_fits_bytes: WholeNumber = 256 << 20  # declared bytes that may exceed that ratio: reading takes little
    chunks: WholeNumber = 1 << 24  # of a dataset: the library holds an index of them in memory
    walked_chunks: WholeNumber = 1 << 20  # of a dataset whose places are checked; a larger index takes too long
    value_bytes: WholeNumber = 1 << 20  # one value of a dataset, such as a text of fixed length
    attributes: WholeNumber = 1000  # of one object
    attribute_bytes: WholeNumber = 16 << 20

    def __post_init__(self) -> None:
        check_bounds(self)


LIMITS = Limits()


class RefusedError(Exception):
    """The file breaks a rule; the text names the object and the rule, not the file."""


def library_reason(error: BaseException) -> str:
    """Shorten the HDF5 library's message to its reason: the text in its last brackets."""
    text = " ".join(str(error).split()) or type(error).__name__
    if "truncated file" in text or "bad byte number" in text:
        return "truncated HDF5 file; the rest of it is missing"
    return text[text.rfind("(") + 1 : -1] if text.endswith(")") else text


def check_structure(root: h5py.File, file_bytes: int, limits: Limits = LIMITS) -> None:
    """Check a file of so many bytes against all rules; no data of a dataset are read.

    Raises
    ------
    RefusedError
        If it breaks one.
    OSError, RuntimeError, KeyError, ValueError, MemoryError
        From the library, for a damaged file.
    """
    _refuse("the file", _attribute_faults(root, limits))
    for name, item in _objects(root, limits.objects):
        if isinstance(item, h5py.h5d.DatasetID):
            _refuse(name, _dataset_faults(item, file_bytes, limits))
            _refuse(name, _attribute_faults(h5py.Dataset(item), limits))
        elif isinstance(item, h5py.h5g.GroupID):
            _refuse(name, _attribute_faults(h5py.Group(item), limits))


def _refuse(name: str, faults: Iterator[str]) -> None:
    for fault in faults:
        raise RefusedError(f"{name}: {fault}")


def _objects(root: h5py.File, most: int) -> Iterator[tuple[str, _Object]]:
    """Every object by its name; links that leave the file are refused."""
    links: list[tuple[bytes, int]] = []

    def add(name: bytes, info: h5py.h5l.LinkInfo) -> bool | None:
        links.append((name, info.type))
        return True if len(links) > most else None

    root.id.links.visit(add, info=True)
    if len(links) > most:
        raise RefusedError(f"more than {most} objects; refused")
    for path, kind in links:
        if kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
            raise RefusedError(f"{path.decode('utf-8', 'replace')}: a link to another file; refused")
    for path, kind in links:
        if kind == h5py.h5l.TYPE_HARD:
            yield path.decode("utf-8", "replace"), h5py.h5o.open(root.id, path)


def _dataset_faults(item: h5py.h5d.DatasetID, file_bytes: int, limits: Limits) -> Iterator[str]:
    """What is wrong with a dataset's header and the places of its chunks; each rule relies on those before it."""
    plist = item.get_create_plist()
    layout = plist.get_layout()
    if layout == h5py.h5d.VIRTUAL or plist.get_external_count():
        yield "its data lie in another file; refused"
    shape, value = tuple(item.shape or ()), item.get_type().get_size()
    if len(shape) > limits.rank:
        yield f"{len(shape)} dimensions; at most {limits.rank} are read"
    if value > limits.value_bytes:
        yield f"one value takes {_size(value)}; at most {_size(limits.value_bytes)} are read"
    declared = math.prod(shape) * value
    if declared > limits.dataset_bytes:
        yield f"shape {shape} takes {_size(declared)}; at most {_size(limits.dataset_bytes)} are read"
    if declared > limits.always_fits_bytes and declared > limits.expansion * file_bytes:
        yield f"shape {shape} declares {_size(declared)}, the file holds {_size(file_bytes)}; refused"
    if layout == h5py.h5d.CHUNKED:
        chunk = plist.get_chunk()
        yield from _filter_faults(plist, math.prod(chunk), value, limits)
        yield from _chunk_faults(item, chunk, file_bytes, limits)


def _filter_faults(plist: h5py.h5p.PropDCID, values: int, value_bytes: int, limits: Limits) -> Iterator[str]:
    """Filters that are not known, or may unpack a chunk to more than it declares, or not without notice."""
    names = []
    for code, _, parameters, _ in (plist.get_filter(number) for number in range(plist.get_nfilters())):
        if code not in FILTERS:
            yield f"filter {code} is not one of {', '.join(FILTERS.values())}; refused"
        if FILTERS[code] in _OWN_COUNT and parameters[2:3] != (values,):
            yield f"{FILTERS[code]} does not match the number of values in a chunk; refused"
        names.append(FILTERS[code])
    if "gzip" in names and not set(names[names.index("gzip") + 1 :]) <= {"shuffle", "fletcher32"}:
        yield "compressed by gzip and then by another filter; refused"
    if names.count("lzf") > 1 or ("lzf" in names and values * value_bytes > limits.lzf_chunk_bytes):
        yield f"one lzf chunk is over {_size(limits.lzf_chunk_bytes)}; refused"


def _chunk_faults(item: h5py.h5d.DatasetID, chunk: tuple[int, ...], file_bytes: int, limits: Limits) -> Iterator[str]:
    size = math.prod(chunk) * item.get_type().get_size()
    if size > limits.chunk_bytes:
        yield f"one chunk {chunk} takes {_size(size)}; at most {_size(limits.chunk_bytes)} are read"
    count = math.prod(-(-length // step) for length, step in zip(item.shape, chunk, strict=True))
    if count > limits.chunks:
        yield f"{count} chunks of {_size(size)}; at most {limits.chunks} are read"
    if count > limits.walked_chunks:
        return
    seen = 0

    def check(info: h5py.h5d.StoreInfo) -> bool | None:
        nonlocal seen
        seen += 1
        outside = info.byte_offset is not None and info.byte_offset + info.size > file_bytes
        return True if outside or info.size > 2 * size + limits.chunk_slack_bytes or seen > count else None

    if item.chunk_iter(check):
        yield "its index of chunks is damaged"


def _attribute_faults(item: "h5py.File | h5py.Group | h5py.Dataset", limits: Limits) -> Iterator[str]:
    """Attributes that are too large; then each one is read: the library can loop on damaged texts."""
    count = h5py.h5a.get_num_attrs(item.id)
    if count > limits.attributes:
        yield f"{count} attributes; at most {limits.attributes} are read"
    for number in range(count):
        attribute = h5py.h5a.open(item.id, index=number)
        what, shape = f"attribute {attribute.name.decode('utf-8', 'replace')}", tuple(attribute.shape or ())
        if len(shape) > limits.rank:
            yield f"{what}: {len(shape)} dimensions; at most {limits.rank} are read"
        size = math.prod(shape) * attribute.get_type().get_size()
        if size <= limits.attribute_bytes:
            try:
                size = _length(item.attrs[attribute.name.decode()])
            except TypeError:  # of a type that NumPy lacks: nobody here reads it
                continue
        if size > limits.attribute_bytes:
            yield f"{what} takes {_size(size)}; at most {_size(limits.attribute_bytes)} are read"


def _length(value: object) -> int:
    """About the bytes of an attribute's value, with the texts that it refers to."""
    if isinstance(value, str | bytes):
        return len(value)
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return sum(_length(part) for part in value.reshape(-1))
    return int(getattr(value, "nbytes", 0))


def _size(size: int) -> str:
    """Bytes in words."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= factor:
            return f"{size / factor:.4g} {unit}"
    return f"{size} bytes"


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
