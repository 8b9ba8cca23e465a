"""A dataset of an HDF5 file as frames: read in blocks of frames, for any order of its axes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.io.guard import guard
from tofmix.io.importers.axes import as_stack, stack_shape
from tofmix.io.importers.base import check_numbers

_BLOCK_BYTES = 64_000_000
"""About the most that is read at once."""


class DatasetFrames:
    """The frames of a dataset, (row, col) or (target, row, col).

    Parameters
    ----------
    dataset : h5py.Dataset
        The dataset, checked by `tofmix.io.guard.guard`.
    names : tuple of str
        Its axes, in the order in which they are stored.
    image : (int, int), optional
        Rows and columns where an axis is ``zone``.
    path, name
        For messages.
    """

    def __init__(
        self, dataset: h5py.Dataset, names: tuple[str, ...], image: tuple[int, int] | None, path: Path, name: str
    ) -> None:
        self.name, self._path, self.dataset, self._names, self._image = name, path, dataset, names, image
        self.dtype: np.dtype[Any] = dataset.dtype
        check_numbers(self.dtype, f"{path}: {name}")
        frames, self.targets, (rows, cols) = stack_shape(dataset.shape, names, image, f"{path}: {name}")
        self.shape: tuple[int, int, int] = frames, rows, cols

    def __iter__(self) -> Iterator[NDArray[Any]]:
        frames, rows, cols = self.shape
        if "frame" not in self._names:
            yield from self._read(())
            return
        axis = self._names.index("frame")
        stored = self.dataset.chunks[axis] if self.dataset.chunks else 1
        most = max(1, _BLOCK_BYTES // (rows * cols * max(1, self.targets) * self.dtype.itemsize))
        step = max(1, most // stored * stored) if most >= stored else most
        for start in range(0, frames, step):
            yield from self._read((*(slice(None),) * axis, slice(start, min(start + step, frames))))

    def _read(self, part: tuple[slice, ...]) -> NDArray[Any]:
        with guard.reading(self._path, self.name):
            block = np.asarray(self.dataset[part or ...])
        return as_stack(block, self._names, self._image, f"{self._path}: {self.name}")
