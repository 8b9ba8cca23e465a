"""Truth of a synthetic recording beyond its first frame: draws of effects, and ranges frame by frame."""

from collections.abc import Iterable

import h5py
import numpy as np

from tofmix.arrays import Float32Array
from tofmix.io import hdf5
from tofmix.simulation.effects import EffectTruth

RANGE_TRUE_FRAMES = "range_true_frames"


def add_effect_truth(truth: h5py.Group, drawn: Iterable[EffectTruth], chunk_frames: int) -> None:
    """Write ``truth/effects``, a dataset for each thing that was drawn once a recording."""
    group = hdf5.add_group(truth, "effects")
    for item in drawn:
        dims = dict(zip(item.dims, item.values.shape, strict=True))
        chunks = tuple(min(n, chunk_frames) if dim == "frame" else n for dim, n in dims.items())
        floats = item.values.dtype.kind == "f"
        hdf5.add_variable(
            group,
            item.name,
            dims=dims,
            dtype=item.values.dtype.str[1:],
            units=item.unit,
            long_name=item.long_name,
            chunks=chunks,
            fill=np.nan if floats else None,
            data=item.values,
        )


def add_range_true_frames(truth: h5py.Group, shape: tuple[int, ...], chunks: tuple[int, ...]) -> None:
    """Add ``truth/range_true_frames`` (frame, row, col, layer), which `write_range_true_frames` fills."""
    dims = dict(zip(("frame", "row", "col", "layer"), shape, strict=True))
    hdf5.add_variable(
        truth,
        RANGE_TRUE_FRAMES,
        dims=dims,
        dtype="f4",
        units="mm",
        long_name="range of each surface in each frame",
        fill=np.nan,
        chunks=chunks,
    )


def write_range_true_frames(truth: h5py.Group, start: int, range_mm: Float32Array) -> None:
    """Write true ranges (n, row, col, layer) of the frames from `start` on."""
    truth[RANGE_TRUE_FRAMES][start : start + len(range_mm)] = range_mm
