"""Files of results, layers or surfaces, open for reading: their datasets are held against `tofmix.io.schema`."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.errors import BadInputError
from tofmix.io import hdf5
from tofmix.io.guard import guard
from tofmix.io.schema import Field
from tofmix.options import MAX_LAYERS_LIMIT
from tofmix.recording import MOST_FRAMES, MOST_PIXELS_A_SIDE

T = TypeVar("T")


@contextmanager
def open_result(path: Path, *, kind: str, make: Callable[[h5py.File, Path], T]) -> Iterator[T]:
    """Open a file of a format, and return the result of `make` for its header."""
    with guard.open_for_reading(path) as root:
        yield read_header(root, path, kind=kind, make=make)


def read_header(
    root: h5py.File, path: Path, *, kind: str, make: Callable[[h5py.File, Path], T], required: bool = True
) -> T:
    """The result of `make` for the header of an open file, whose format is checked first."""
    with guard.reading(path, "header"):
        hdf5.check_format(root, path, kind=kind, required=required)
        return make(root, path)


class ResultFile:
    """An open file of results, which must have the datasets of `fields`.

    `main` is the dataset (window, row, col, layer) of which the others have the lengths.
    """

    def __init__(self, root: h5py.File, path: Path, fields: Iterable[Field], main: str) -> None:
        self.path = path
        self._fields = {spec.name: spec for spec in fields}
        self._datasets = {name: _typed(root, spec, path) for name, spec in self._fields.items()}
        shape = self._datasets[main].shape
        self.shape: tuple[int, int, int] = shape[:3]
        self.max_layers = int(shape[3])
        if max(shape[1:3]) > MOST_PIXELS_A_SIDE or shape[0] > MOST_FRAMES or shape[3] > MAX_LAYERS_LIMIT:
            raise BadInputError(
                f"{path}: {main}: shape {shape}; no more than {MOST_FRAMES} windows of {MOST_PIXELS_A_SIDE} pixels"
                f" a side and {MAX_LAYERS_LIMIT} layers"
            )
        if 0 in shape:
            raise BadInputError(f"{path}: {main}: shape {shape} holds no layer")

    def _check_lengths(self, more: Mapping[str, int]) -> None:
        """Refuse a dataset that has not the lengths of its dimensions."""
        windows, rows, cols = self.shape
        lengths = {"window": windows, "row": rows, "col": cols, "layer": self.max_layers, **more}
        for name, spec in self._fields.items():
            shape, expected = self._datasets[name].shape, tuple(lengths[dim] for dim in spec.dims)
            if shape != expected:
                raise BadInputError(f"{self.path}: {name}: shape {shape}, expected {spec.dims} = {expected}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the datasets, in their order."""
        return tuple(self._datasets)

    def read_dataset(self, name: str, *part: slice | int) -> NDArray[Any]:
        """Read one dataset, or a part along its first dimensions, without a look at its values."""
        with guard.reading(self.path, name):
            return np.asarray(self._datasets[name][part])


def _typed(root: h5py.File, spec: Field, path: Path) -> h5py.Dataset:
    """A dataset of its type and of as many dimensions as it has names of them."""
    dataset = guard.checked_dataset(root, spec.name, path)
    if dataset.ndim != len(spec.dims) or dataset.dtype != np.dtype(spec.dtype):
        got = f"{dataset.dtype} of shape {dataset.shape}"
        raise BadInputError(f"{path}: {spec.name}: expected {spec.dtype} {spec.dims}, got {got}")
    return dataset
