"""Rules on the structure of an HDF5 file, applied before a byte of data is read.

A file's header may claim anything: data that lie in other files, petabytes, a chunk of many gigabytes.
`check_structure` checks every object, and refuses those that refer to other files or need memory without bound. It
belongs in a process that may hang or crash, for the library itself does so on some damaged files: `guard` sees to that.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

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
    """Sizes up to which a file is read.

    Parameters
    ----------
    objects : int
        Groups, datasets and types of a file; more would take too long to walk.
    rank : int
        Dimensions of a dataset or an attribute; files of tofmix have 4 at most.
    chunk_bytes : int
        Size of one chunk: a chunk is unpacked whole, however little of it is read.
    lzf_chunk_bytes : int
        Size of a chunk packed by lzf: its unpacking cannot be checked beforehand, and it grows by 90 at most.
    chunk_slack_bytes : int
        Size of a stored chunk beyond twice its size: headers and checksums.
    dataset_bytes : int
        Declared size of a dataset: larger than any disk that a recording is on.
    expansion : int
        Declared bytes for each byte of the file, twice what gzip reaches: a higher ratio means that the data are
        missing.
    always_fits_bytes : int
        Declared size up to which a dataset may exceed that ratio: reading it takes little.
    chunks : int
        Chunks of a dataset: the library holds an index of them in memory.
    walked_chunks : int
        Most chunks of a dataset whose positions are checked; a larger index takes too long.
    value_bytes : int
        Size of one value of a dataset, such as a text of fixed length.
    attributes, attribute_bytes : int
        Attributes of one object, and the size of each.
    """

    objects: WholeNumber = 20_000
    rank: WholeNumber = 8
    chunk_bytes: WholeNumber = 256 << 20
    lzf_chunk_bytes: WholeNumber = 16 << 20
    chunk_slack_bytes: WholeNumber = 64 << 10
    dataset_bytes: WholeNumber = 1 << 44
    expansion: WholeNumber = 2000
    always_fits_bytes: WholeNumber = 256 << 20
    chunks: WholeNumber = 1 << 24
    walked_chunks: WholeNumber = 1 << 20
    value_bytes: WholeNumber = 1 << 20
    attributes: WholeNumber = 1000
    attribute_bytes: WholeNumber = 16 << 20

    def __post_init__(self) -> None:
        check_bounds(self)


LIMITS = Limits()


class RefusedError(Exception):
    """The file breaks a rule; the text names the object and the rule, not the file."""


def check_structure(root: h5py.File, file_bytes: int, limits: Limits = LIMITS) -> None:
    """Check a file against all rules; no data of a dataset are read.

    Parameters
    ----------
    root : h5py.File
        The file, open for reading.
    file_bytes : int
        Its size.
    limits : Limits
        Sizes up to which it is read.

    Raises
    ------
    RefusedError
        If it breaks one.
    OSError, RuntimeError, KeyError, ValueError, MemoryError
        From the library, for a damaged file.
    """
    _check_attributes(root, "the file", limits)
    for name, item in _objects(root, limits.objects):
        if isinstance(item, h5py.h5d.DatasetID):
            check_dataset(item, name, file_bytes, limits)
            _check_attributes(h5py.Dataset(item), name, limits)
        elif isinstance(item, h5py.h5g.GroupID):
            _check_attributes(h5py.Group(item), name, limits)


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
        name = path.decode("utf-8", "replace")
        if kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
            raise RefusedError(f"{name}: a link to another file; refused")
    for path, kind in links:
        if kind == h5py.h5l.TYPE_HARD:
            yield path.decode("utf-8", "replace"), h5py.h5o.open(root.id, path)


def check_dataset(item: h5py.h5d.DatasetID, name: str, file_bytes: int, limits: Limits = LIMITS) -> None:
    """Check one dataset's header and the places of its chunks.

    Parameters
    ----------
    item : h5py.h5d.DatasetID
        The dataset.
    name : str
        Its name, for the message.
    file_bytes : int
        The file's size.
    limits : Limits
        Sizes up to which it is read.

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
    if len(shape) > limits.rank:
        raise RefusedError(f"{name}: {len(shape)} dimensions; at most {limits.rank} are read")
    value = item.get_type().get_size()
    if value > limits.value_bytes:
        raise RefusedError(f"{name}: one value takes {_size(value)}; at most {_size(limits.value_bytes)} are read")
    declared = math.prod(shape) * value
    if declared > limits.dataset_bytes:
        raise RefusedError(
            f"{name}: shape {shape} takes {_size(declared)}; at most {_size(limits.dataset_bytes)} are read"
        )
    if declared > limits.always_fits_bytes and declared > limits.expansion * file_bytes:
        raise RefusedError(
            f"{name}: shape {shape} declares {_size(declared)}, the file holds {_size(file_bytes)}; refused"
        )
    if layout == h5py.h5d.CHUNKED:
        _check_filters(plist, value, name, limits.lzf_chunk_bytes)
        _check_chunks(item, plist.get_chunk(), shape, name, file_bytes, limits)


def _check_filters(plist: h5py.h5p.PropDCID, value_bytes: int, name: str, most_lzf_bytes: int) -> None:
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
    if names.count("lzf") > 1 or ("lzf" in names and values * value_bytes > most_lzf_bytes):
        raise RefusedError(f"{name}: one lzf chunk is over {_size(most_lzf_bytes)}; refused")


def _check_chunks(
    item: h5py.h5d.DatasetID,
    chunk: tuple[int, ...],
    shape: tuple[int, ...],
    name: str,
    file_bytes: int,
    limits: Limits,
) -> None:
    size = math.prod(chunk) * item.get_type().get_size()
    if size > limits.chunk_bytes:
        raise RefusedError(
            f"{name}: one chunk {chunk} takes {_size(size)}; at most {_size(limits.chunk_bytes)} are read"
        )
    count = math.prod(-(-length // step) for length, step in zip(shape, chunk, strict=True))
    if count > limits.chunks:
        raise RefusedError(f"{name}: {count} chunks of {_size(size)}; at most {limits.chunks} are read")
    if count > limits.walked_chunks:
        return

    def check(info: h5py.h5d.StoreInfo) -> bool | None:
        seen[0] += 1
        outside = info.byte_offset is not None and info.byte_offset + info.size > file_bytes
        return True if outside or info.size > 2 * size + limits.chunk_slack_bytes or seen[0] > count else None

    seen = [0]
    if item.chunk_iter(check):
        raise RefusedError(f"{name}: its index of chunks is damaged")


def _check_attributes(item: "h5py.File | h5py.Group | h5py.Dataset", name: str, limits: Limits) -> None:
    """Check the sizes of all attributes, then read each one: the library can loop on damaged texts."""
    count = h5py.h5a.get_num_attrs(item.id)
    if count > limits.attributes:
        raise RefusedError(f"{name}: {count} attributes; at most {limits.attributes} are read")
    for number in range(count):
        attribute = h5py.h5a.open(item.id, index=number)
        what = f"{name}: attribute {attribute.name.decode('utf-8', 'replace')}"
        shape = tuple(attribute.shape or ())
        if len(shape) > limits.rank:
            raise RefusedError(f"{what}: {len(shape)} dimensions; at most {limits.rank} are read")
        _check_size(math.prod(shape) * attribute.get_type().get_size(), what, limits.attribute_bytes)
        try:
            value = item.attrs[attribute.name.decode()]
        except TypeError:  # of a type that NumPy lacks: nobody here reads it
            continue
        _check_size(_length(value), what, limits.attribute_bytes)


def _check_size(size: int, what: str, most: int) -> None:
    if size > most:
        raise RefusedError(f"{what} takes {_size(size)}; at most {_size(most)} are read")


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
