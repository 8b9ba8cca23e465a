"""Voxels, read back by plyfile and NumPy."""

import io
import sys
import zipfile
from pathlib import Path

import numpy as np
import plyfile
import pytest

from tofmix.errors import UsageError
from tofmix.io.map_file import check_voxel_path, encode_voxels
from tofmix.mapping.grid import VoxelGrid
from tofmix.mapping.occupancy import VoxelMap

ODDS = np.random.default_rng(2).normal(0, 3, (4, 3, 5)).astype(np.float32)
VOXELS = VoxelMap(grid=VoxelGrid(cell_mm=50.0, first=(-2, 10, 0), shape=(4, 3, 5)), log_odds=ODDS)


def test_ply_holds_the_occupied_voxels() -> None:
    content = encode_voxels(VOXELS, Path("a.ply"), comment="über\nall")
    read = plyfile.PlyData.read(io.BytesIO(content))
    assert read.comments[0] == "\\xfcber all"
    vertices = read["vertex"]
    expected = {}
    for i, j, k in np.ndindex(ODDS.shape):
        if 1 / (1 + np.exp(-float(ODDS[i, j, k]))) > 0.65:
            expected[i, j, k] = ODDS[i, j, k]
    assert 0 < len(expected) < ODDS.size
    assert len(vertices.data) == len(expected)
    for vertex in vertices.data:
        i, j, k = (int(np.floor(vertex[name] / 0.05)) - VOXELS.grid.first[axis] for axis, name in enumerate("xyz"))
        assert vertex["log_odds"] == expected.pop((i, j, k))
        assert vertex["probability"] == pytest.approx(1 / (1 + np.exp(-vertex["log_odds"])))
    assert not expected


def test_npz_holds_the_whole_grid_as_plain_arrays() -> None:
    content = encode_voxels(VOXELS, Path("a.npz"), comment="")
    with np.load(io.BytesIO(content), allow_pickle=False) as read:
        np.testing.assert_array_equal(read["log_odds"], ODDS)
        assert read["origin_mm"].tolist() == [-100, 500, 0]
        assert (read["cell_mm"], read["occupied_thresh"], read["free_thresh"]) == (50, 0.65, 0.196)


def test_the_same_map_has_the_same_bytes_at_any_time() -> None:
    with zipfile.ZipFile(io.BytesIO(encode_voxels(VOXELS, Path("a.npz"), comment=""))) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    assert encode_voxels(VOXELS, Path("a.ply"), comment="c") == encode_voxels(VOXELS, Path("b.ply"), comment="c")


def test_voxel_file_refuses_other_suffixes_and_a_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match=r"\.ply or \.npz"):
        check_voxel_path(Path("a.las"))
    monkeypatch.setitem(sys.modules, "plyfile", None)
    check_voxel_path(Path("a.npz"))
    with pytest.raises(UsageError, match=r"tofmix\[export\]"):
        check_voxel_path(Path("a.ply"))
