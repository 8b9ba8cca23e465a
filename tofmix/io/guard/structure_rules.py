"""Rules on the structure of an HDF5 file, applied before a byte of data is read.

A file's header may claim anything: data that lie in other files, petabytes, a chunk of many gigabytes.
`check_structure` checks every object, and refuses those that refer to other files or need memory without bound. It
belongs in a process that may hang or crash, for the library itself does so on some damaged files: `guard` sees to that.
"""

import math
from collections.abc import Iterator
from typing import TypeAlias

import h5py
import numpy as np

MOST_OBJECTS = 20_000
"""Groups, datasets and types of a file; more would take too long to walk."""

MOST_RANK = 8
"""Dimensions of a dataset; files of tofmix have 4 at most."""

MOST_CHUNK_BYTES = 256 << 20
"""Size of one chunk, bytes: a chunk is unpacked whole, however little of it is read."""

MOST_DATASET_BYTES = 1 << 44
"""Declared size of a dataset, bytes: larger than any disk that a recording is on."""

MOST_EXPANSION = 2000
"""Declared bytes for each byte of the file, twice what gzip reaches: a higher ratio means that the data are missing."""

ALWAYS_FITS_BYTES = 256 << 20
"""Datasets up to this size may announce more than the file holds: reading them takes little."""

MOST_CHUNKS = 1 << 24
"""Chunks of a dataset: the library holds an index of them in memory."""

MOST_WALKED_CHUNKS = 1 << 20
"""Chunks of a dataset up to which each one's place is checked; a larger index takes too long."""

MOST_VALUE_BYTES = 1 << 20
"""Size of one value of a dataset, bytes, such as a text of fixed length."""

MOST_ATTRIBUTES = 1000  # of one object
MOST_ATTRIBUTE_BYTES = 16 << 20  # of one attribute

FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 4: "szip", 5: "nbit", 6: "scaleoffset", 32000: "lzf"}
"""Accepted filters by their numbers: those of the library, none that is loaded from a path."""

MOST_LZF_BYTES = 16 << 20
"""A chunk packed by lzf: its unpacking cannot be checked beforehand, and it grows by 90 at most."""

_OWN_COUNT = ("nbit", "scaleoffset")
"""Filters that believe their own parameters as to how many values they give."""

_CHUNK_SLACK_BYTES = 64 << 10  # of a stored chunk beyond twice its size: headers and checksums

_Object: TypeAlias = "h5py.h5g.GroupID | h5py.h5d.DatasetID | h5py.h5t.TypeID"


class RefusedError(Exception):
    """The file breaks a rule; the text names the object and the rule, not the file."""


def check_structure(root: h5py.File, file_bytes: int) -> None:
    """Check a file against all rules; no data of a dataset are read.

    Parameters
    ----------
    root : h5py.File
        The file, open for reading.
    file_bytes : int
        Its size.

    Raises
    ------
    RefusedError
        If it breaks one.
    OSError, RuntimeError, KeyError, ValueError, MemoryError
        From the library, for a damaged file.
    """
    _check_attributes(root, "the file")
    for name, item in _objects(root):
        if isinstance(item, h5py.h5d.DatasetID):
            check_dataset(item, name, file_bytes)
            _check_attributes(h5py.Dataset(item), name)
        elif isinstance(item, h5py.h5g.GroupID):
            _check_attributes(h5py.Group(item), name)


def _objects(root: h5py.File) -> Iterator[tuple[str, _Object]]:
    """Every object by its name; links that leave the file are refused."""
    links: list[tuple[bytes, int]] = []

    def add(name: bytes, info: h5py.h5l.LinkInfo) -> bool | None:
        links.append((name, info.type))
        return True if len(links) > MOST_OBJECTS else None

    root.id.links.visit(add, info=True)
    if len(links) > MOST_OBJECTS:
        raise RefusedError(f"more than {MOST_OBJECTS} objects; refused")
    for path, kind in links:
        name = path.decode("utf-8", "replace")
        if kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
            raise RefusedError(f"{name}: a link to another file; refused")
    for path, kind in links:
        if kind == h5py.h5l.TYPE_HARD:
            yield path.decode("utf-8", "replace"), h5py.h5o.open(root.id, path)


def check_dataset(item: h5py.h5d.DatasetID, name: str, file_bytes: int) -> None:
    """Check one dataset's header and the places of its chunks.

    Parameters
    ----------
    item : h5py.h5d.DatasetID
        The dataset.
    name : str
        Its name, for the message.
    file_bytes : int
        The file's size.

    Raises
    ------
    RefusedError
        If it breaks a rule.
    """
    plist = item.get_create_plist()
    layout = plist.get_layout()
    if layout == h5py.h5d.VIRTUAL or plist.get_external_count():
        raise RefusedError(f"{name}: its data lie in another file; refused")
    shape = tuple(item.shape or ())
    if len(shape) > MOST_RANK:
        raise RefusedError(f"{name}: {len(shape)} dimensions; at most {MOST_RANK} are read")
    value = item.get_type().get_size()
    if value > MOST_VALUE_BYTES:
        raise RefusedError(f"{name}: one value takes {_size(value)}; at most {_size(MOST_VALUE_BYTES)} are read")
    declared = math.prod(shape) * value
    if declared > MOST_DATASET_BYTES:
        raise RefusedError(
            f"{name}: shape {shape} takes {_size(declared)}; at most {_size(MOST_DATASET_BYTES)} are read"
        )
    if declared > ALWAYS_FITS_BYTES and declared > MOST_EXPANSION * file_bytes:
        raise RefusedError(
            f"{name}: shape {shape} declares {_size(declared)}, the file holds {_size(file_bytes)}; refused"
        )
    if layout == h5py.h5d.CHUNKED:
        _check_filters(plist, value, name)
        _check_chunks(item, plist.get_chunk(), shape, name, file_bytes)


def _check_filters(plist: h5py.h5p.PropDCID, value_bytes: int, name: str) -> None:
    """Check that each filter is known, and cannot unpack a chunk to more than it declares, or not without notice."""
    values = math.prod(plist.get_chunk())
    found = [plist.get_filter(number) for number in range(plist.get_nfilters())]
    codes = [one[0] for one in found]
    for code, _, parameters, _ in found:
        if code not in FILTERS:
            raise RefusedError(f"{name}: filter {code} is not one of {', '.join(FILTERS.values())}; refused")
        if FILTERS[code] in _OWN_COUNT and parameters[2:3] != (values,):
            raise RefusedError(f"{name}: {FILTERS[code]} does not match the number of values in a chunk; refused")
    names = [FILTERS[code] for code in codes]
    if "gzip" in names and not set(names[names.index("gzip") + 1 :]) <= {"shuffle", "fletcher32"}:
        raise RefusedError(f"{name}: compressed by gzip and then by another filter; refused")
    if names.count("lzf") > 1 or ("lzf" in names and values * value_bytes > MOST_LZF_BYTES):
        raise RefusedError(f"{name}: one lzf chunk is over {_size(MOST_LZF_BYTES)}; refused")


def _check_chunks(
    item: h5py.h5d.DatasetID, chunk: tuple[int, ...], shape: tuple[int, ...], name: str, file_bytes: int
) -> None:
    size = math.prod(chunk) * item.get_type().get_size()
    if size > MOST_CHUNK_BYTES:
        raise RefusedError(f"{name}: one chunk {chunk} takes {_size(size)}; at most {_size(MOST_CHUNK_BYTES)} are read")
    count = math.prod(-(-length // step) for length, step in zip(shape, chunk, strict=True))
    if count > MOST_CHUNKS:
        raise RefusedError(f"{name}: {count} chunks of {_size(size)}; at most {MOST_CHUNKS} are read")
    if count > MOST_WALKED_CHUNKS:
        return

    def check(info: h5py.h5d.StoreInfo) -> bool | None:
        seen[0] += 1
        outside = info.byte_offset is not None and info.byte_offset + info.size > file_bytes
        return True if outside or info.size > 2 * size + _CHUNK_SLACK_BYTES or seen[0] > count else None

    seen = [0]
    if item.chunk_iter(check):
        raise RefusedError(f"{name}: its index of chunks is damaged")


def _check_attributes(item: "h5py.File | h5py.Group | h5py.Dataset", name: str) -> None:
    """Check the sizes of all attributes, then read each one: the library can loop on damaged texts."""
    count = h5py.h5a.get_num_attrs(item.id)
    if count > MOST_ATTRIBUTES:
        raise RefusedError(f"{name}: {count} attributes; at most {MOST_ATTRIBUTES} are read")
    for number in range(count):
        attribute = h5py.h5a.open(item.id, index=number)
        what = f"{name}: attribute {attribute.name.decode('utf-8', 'replace')}"
        shape = tuple(attribute.shape or ())
        if len(shape) > MOST_RANK:
            raise RefusedError(f"{what}: {len(shape)} dimensions; at most {MOST_RANK} are read")
        _check_size(math.prod(shape) * attribute.get_type().get_size(), what)
        try:
            value = item.attrs[attribute.name.decode()]
        except TypeError:  # of a type that NumPy lacks: nobody here reads it
            continue
        _check_size(_length(value), what)


def _check_size(size: int, what: str) -> None:
    if size > MOST_ATTRIBUTE_BYTES:
        raise RefusedError(f"{what} takes {_size(size)}; at most {_size(MOST_ATTRIBUTE_BYTES)} are read")


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
