"""Maps of two and three dimensions, read back by parsers that share nothing with their writers."""

import io
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import plyfile
import pytest
import yaml
from numpy.typing import NDArray

from tofmix.errors import UsageError
from tofmix.io.map_file import check_voxel_path, encode_map, encode_voxels, map_paths
from tofmix.mapping.grid import VoxelGrid
from tofmix.mapping.occupancy import FloorMap, State, VoxelMap


def read_map(text: Path) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """As ROS's map_server does in trinary mode: 0 free, 100 occupied, -1 unknown; row 0 at the least y."""
    about = yaml.safe_load(text.read_text())
    magic, size, most, pixels = (text.parent / about["image"]).read_bytes().split(b"\n", 3)
    width, height = (int(n) for n in size.split())
    assert (magic, most, len(pixels)) == (b"P5", b"255", width * height)
    image = np.frombuffer(pixels, dtype=np.uint8).reshape(height, width)[::-1]
    occupancy = (255 - image) / 255 if not about["negate"] else image / 255
    cells = np.full(image.shape, -1.0)
    cells[occupancy > about["occupied_thresh"]] = 100
    cells[occupancy < about["free_thresh"]] = 0
    return about, cells


def write(path: Path, map_: FloorMap, comment: str = "from a test") -> Path:
    for name, content in encode_map(map_, path, comment=comment).items():
        name.write_bytes(content)
    return path


def test_a_map_reads_back_cell_by_cell(tmp_path: Path) -> None:
    cells = np.random.default_rng(1).integers(0, 3, (7, 4)).astype(np.uint8)
    about, read = read_map(write(tmp_path / "a.yaml", FloorMap(cells=cells, cell_mm=50.0, origin_mm=(-150.0, 2050.0))))
    said = {State.FREE: 0, State.UNKNOWN: -1, State.OCCUPIED: 100}
    for x, y in np.ndindex(7, 4):
        assert read[y, x] == said[State(int(cells[x, y]))]
    assert about["origin"] == [-0.15, 2.05, 0.0]
    assert about["resolution"] == 0.05
    assert about["mode"] == "trinary"


def test_special_characters_and_names_of_images_are_held_or_refused(tmp_path: Path) -> None:
    flat = FloorMap(cells=np.zeros((1, 1), dtype=np.uint8), cell_mm=33.3, origin_mm=(0.0, -0.0))
    name = 'no: "1" # é.yaml'
    about, _ = read_map(write(tmp_path / name, flat, comment="two\nlines: here"))
    assert about["image"] == 'no: "1" # é.pgm'
    assert about["resolution"] == 0.0333
    assert map_paths(Path("a.b.yml")) == (Path("a.b.pgm"), Path("a.b.yml"))
    with pytest.raises(UsageError, match=r"must end in \.yaml"):
        map_paths(Path("a.pgm"))


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


def test_voxels_as_npz_are_the_whole_grid_with_the_same_bytes_at_any_time() -> None:
    content = encode_voxels(VOXELS, Path("a.npz"), comment="")
    with np.load(io.BytesIO(content), allow_pickle=False) as read:
        np.testing.assert_array_equal(read["log_odds"], ODDS)
        assert read["origin_mm"].tolist() == [-100, 500, 0]
        assert (read["cell_mm"], read["occupied_thresh"], read["free_thresh"]) == (50, 0.65, 0.196)
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
