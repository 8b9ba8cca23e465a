"""Whether two outputs hold the same values, whatever they say of the files that they were made of."""

import sqlite3
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np


def same_content(a: Path, b: Path) -> bool:
    """Compare two files.

    HDF5 files by their datasets, parts of sharded runs by their rows, pages not at all (they show checksums of what
    they were made of), others byte by byte.
    """
    if a.suffix == ".part":
        return _rows(a) == _rows(b)
    if a.suffix == ".html":
        return True
    if a.suffix != ".h5":
        return a.read_bytes() == b.read_bytes()
    with h5py.File(a) as one, h5py.File(b) as other:
        return _values(one).keys() == _values(other).keys() and all(
            np.array_equal(values, _values(other)[name], equal_nan=values.dtype.kind == "f")
            for name, values in _values(one).items()
        )


def _rows(part: Path) -> list[tuple[object, ...]]:
    with closing(sqlite3.connect(f"{part.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        tables = ("about", "cells")
        return [row for table in tables for row in database.execute(f"SELECT * FROM {table} ORDER BY 1")]  # noqa: S608


def _values(root: h5py.File) -> dict[str, np.ndarray]:
    """All datasets by their names; by the links, as the library's own visit also reads indexes that no reader needs."""
    found, names = {}, list[bytes]()
    root.id.links.visit(names.append)
    for name in names:
        item = root.get(name)
        if isinstance(item, h5py.Dataset):
            found[name.decode()] = np.asarray(item[...])
    return found
