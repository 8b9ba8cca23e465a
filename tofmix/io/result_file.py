"""Opening a file of results, layers or surfaces, and the datasets of their lists of fields."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import h5py
import numpy as np

from tofmix.errors import BadInputError
from tofmix.io import hdf5
from tofmix.io.guard import guard

T = TypeVar("T")


@contextmanager
def open_result(path: Path, *, kind: str, make: Callable[[h5py.File, Path], T]) -> Iterator[T]:
    """Open a file of a format, and return the result of `make` for its header.

    Raises
    ------
    BadInputError
        If the file is missing, not HDF5 or cut short, or is of another format.
    """
    with guard.open_for_reading(path) as root:
        with guard.reading(path, "header"):
            hdf5.check_format(root, path, kind=kind, required=True)
            made = make(root, path)
        yield made


def typed_dataset(root: h5py.File, name: str, path: Path, *, dtype: str, dims: tuple[str, ...]) -> h5py.Dataset:
    """A dataset of a type and of as many dimensions as `dims` has names.

    Raises
    ------
    BadInputError
        If it is missing or another.
    """
    dataset = guard.checked_dataset(root, name, path)
    if dataset.ndim != len(dims) or dataset.dtype != np.dtype(dtype):
        raise BadInputError(f"{path}: {name}: expected {dtype} {dims}, got {dataset.dtype} of shape {dataset.shape}")
    return dataset
