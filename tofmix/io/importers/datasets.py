"""A dataset of an HDF5 file as frames: read in blocks of frames, for any order of its axes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tofmix.io.guard import guard
from tofmix.io.importers.arrays import Frames
from tofmix.io.importers.axes import as_stack, stack_shape
from tofmix.io.importers.base import check_numbers

_BLOCK_BYTES = 64_000_000
"""About the most that is read at once."""


def dataset_frames(
    dataset: h5py.Dataset, names: tuple[str, ...], image: tuple[int, int] | None, path: Path, name: str
) -> Frames:
    """The frames of a dataset that `tofmix.io.guard.guard` has checked.

    `names` are its axes, in the order in which they are stored; `image` are rows and columns where an axis is ``zone``.
    """
    what = f"{path}: {name}"
    check_numbers(dataset.dtype, what)
    frames, targets, (rows, cols) = stack_shape(dataset.shape, names, image, what)

    def images() -> Iterator[NDArray[Any]]:
        for part in _parts(dataset, names, frames, rows * cols * max(1, targets)):
            with guard.reading(path, name):
                block = np.asarray(dataset[part or ...])
            yield from as_stack(block, names, image, what)

    return Frames(images=images(), shape=(frames, rows, cols), targets=targets, dtype=dataset.dtype)


def _parts(dataset: h5py.Dataset, names: tuple[str, ...], frames: int, values: int) -> Iterator[tuple[slice, ...]]:
    """Selections of blocks of frames, of so many values each; all of a single image."""
    if "frame" not in names:
        yield ()
        return
    axis = names.index("frame")
    stored = dataset.chunks[axis] if dataset.chunks else 1
    most = max(1, _BLOCK_BYTES // (values * dataset.dtype.itemsize))
    step = max(1, most // stored * stored) if most >= stored else most
    for start in range(0, frames, step):
        yield (*(slice(None),) * axis, slice(start, min(start + step, frames)))
