"""Datasets of an HDF5 file of any structure."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from tofmix.io.importers.hdf5_source import every_dataset


def visited(root: h5py.File) -> list[tuple[str, tuple[int, ...]]]:
    """The same by h5py, whose time grows with the square of the depth."""
    found: list[tuple[str, tuple[int, ...]]] = []

    def add(name: str, item: h5py.HLObject) -> None:
        if isinstance(item, h5py.Dataset):
            found.append((name, item.shape))

    root.visititems(add)
    return found


@pytest.fixture
def file(tmp_path: Path) -> h5py.File:
    return h5py.File(tmp_path / "a.h5", "w")


def test_each_dataset_is_found_once_where_links_lead_to_it_twice_and_back(file: h5py.File) -> None:
    file["b/x"] = np.zeros((2, 3))
    file["bb"], file["b-"], file["empty"] = np.zeros(4), np.zeros(5), h5py.Empty("f")
    file["a"], file["b/loop"], file["b/root"] = file["b/x"], file["b"], file["/"]
    file["soft"], file["outside"] = h5py.SoftLink("/b/x"), h5py.ExternalLink("none.h5", "/x")
    file["type"] = file["bb"].dtype
    found = [(name, item.shape) for name, item in every_dataset(file)]
    assert found == visited(file)
    assert [name for name, _ in found] == ["a", "b-", "bb", "empty"]


def test_dataset_below_many_groups_is_found_by_its_path(file: h5py.File) -> None:
    path = "/".join(["g"] * 300)
    file[f"{path}/depth"] = np.zeros(2)
    assert [(name, item.shape) for name, item in every_dataset(file)] == visited(file) == [(f"{path}/depth", (2,))]
