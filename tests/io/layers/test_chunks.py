"""Chunks as HDF5 itself makes and checks them."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.io import hdf5
from tofmix.io.layers.chunks import encode_cell, fill_of, fletcher32
from tofmix.io.schema import field_of
from tofmix.io.storage import AtomicFile
from tofmix.layers import LAYER_DIMS, LAYER_FIELDS, Layers


def made_up(shape: tuple[int, int, int], layers: int = 3) -> Layers:
    rng = np.random.default_rng(2)
    out = Layers.empty(shape, layers)
    for spec in LAYER_FIELDS:
        values = getattr(out, spec.name)
        values[...] = (
            rng.integers(0, layers + 1, values.shape) if spec.dtype == "u1" else rng.normal(50, 9, values.shape)
        )
    return out


@pytest.mark.parametrize("cell", [(2, 3, 5), (1, 3, 5), (2, 1, 5)])
def test_hdf5_reads_what_was_encoded(tmp_path: Path, cell: tuple[int, int, int]) -> None:
    layers, whole = made_up(cell), (2, 3, 5)
    encoded = encode_cell(layers, shape=whole)
    with (
        AtomicFile(tmp_path / "a.h5", overwrite=False) as file,
        hdf5.create(file, kind="x", title="", history="") as root,
    ):
        for name, length in zip(LAYER_DIMS, (*whole, 3), strict=True):
            hdf5.add_scale(root, name, length)
        for spec, chunk in zip(LAYER_FIELDS, encoded.chunks, strict=True):
            hdf5.add_field(root, field_of(spec), dict(zip(LAYER_DIMS, (*whole, 3), strict=True)))
            root[spec.name].id.write_direct_chunk((0,) * len(spec.dims), chunk)
    windows, rows, cols = cell
    with h5py.File(tmp_path / "a.h5") as root:  # reading checks Fletcher's sum
        for spec in LAYER_FIELDS:
            read = root[spec.name][...]
            np.testing.assert_array_equal(read[:windows, :rows, :cols], getattr(layers, spec.name))
            rest = np.ones(read.shape[:3], dtype=bool)
            rest[:windows, :rows, :cols] = False
            np.testing.assert_array_equal(read[rest], np.full_like(read[rest], fill_of(spec)))
    assert encoded.tally == tuple(int((layers.n_modes == n).sum()) for n in range(4))


@pytest.mark.slow
@given(data=st.binary(max_size=4000) | st.sampled_from([b"\xff" * 800, b"\0" * 9, b"\xff\xff\0\0", b""]))
def test_fletcher32_is_that_of_the_library(data: bytes) -> None:
    # The library's loop: 16-bit big-endian words, carries folded in every 360 words.
    low = high = 0
    words = [int.from_bytes(data[k : k + 2].ljust(2, b"\0"), "big") for k in range(0, len(data), 2)]
    for start in range(0, len(words), 360):
        for word in words[start : start + 360]:
            low += word
            high += low
        low, high = (low & 0xFFFF) + (low >> 16), (high & 0xFFFF) + (high >> 16)
    low, high = (low & 0xFFFF) + (low >> 16), (high & 0xFFFF) + (high >> 16)
    assert fletcher32(data) == (high << 16 | low)


def test_a_flipped_bit_in_a_chunk_is_noticed(tmp_path: Path) -> None:
    chunk = bytearray(encode_cell(made_up((1, 4, 4)), shape=(1, 4, 4)).chunks[2])
    chunk[7] ^= 4
    with h5py.File(tmp_path / "a.h5", "w") as root:
        dataset = root.create_dataset(
            "range", (1, 4, 4, 3), "f4", chunks=(1, 4, 4, 3), compression="gzip", shuffle=True, fletcher32=True
        )
        dataset.id.write_direct_chunk((0, 0, 0, 0), bytes(chunk))
        with pytest.raises(OSError, match=r"filter returned failure|Fletcher32"):
            dataset[...]
