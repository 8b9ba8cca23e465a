"""The image and the text of a 2-D map, read back by a parser that shares nothing with the writer, and by PyYAML."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from tofmix.errors import UsageError
from tofmix.io.map_file import encode_map, map_paths
from tofmix.mapping.occupancy import FloorMap, State


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


def test_the_image_has_its_far_left_corner_first(tmp_path: Path) -> None:
    cells = np.full((3, 2), State.UNKNOWN, dtype=np.uint8)
    cells[0, 1] = State.OCCUPIED  # least x, greatest y
    write(tmp_path / "a.yaml", FloorMap(cells=cells, cell_mm=100.0, origin_mm=(0.0, 0.0)))
    assert (tmp_path / "a.pgm").read_bytes() == b"P5\n3 2\n255\n" + bytes([0, 205, 205, 205, 205, 205])


def test_special_characters_in_names_and_comments_survive_yaml(tmp_path: Path) -> None:
    flat = FloorMap(cells=np.zeros((1, 1), dtype=np.uint8), cell_mm=33.3, origin_mm=(0.0, -0.0))
    name = 'no: "1" # é.yaml'
    about, _ = read_map(write(tmp_path / name, flat, comment="two\nlines: here"))
    assert about["image"] == 'no: "1" # é.pgm'
    assert about["resolution"] == 0.0333


def test_the_image_is_named_before_the_text_and_other_endings_are_refused() -> None:
    assert map_paths(Path("a.b.yml")) == (Path("a.b.pgm"), Path("a.b.yml"))
    with pytest.raises(UsageError, match=r"must end in \.yaml"):
        map_paths(Path("a.pgm"))
