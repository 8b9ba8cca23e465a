"""`--fov` with `--projection`: walls that a pinhole saw are flat again, and the printed line says which it was."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.commandline import Tofmix

from tofmix.errors import ExitCode

WALL_MM, SHAPE, VIEW = 2500.0, (6, 8), "64x50"


@pytest.fixture
def layers(tofmix: Tofmix, tmp_path: Path) -> Path:
    """Layers of a flat wall, whose ranges are along the beams of an ideal pinhole; their file knows no lens."""
    rows, cols = SHAPE
    x = (np.arange(cols) - (cols - 1) / 2) / (cols / 2) * np.tan(np.radians(32.0))
    y = (np.arange(rows) - (rows - 1) / 2) / (rows / 2) * np.tan(np.radians(25.0))
    ranges = WALL_MM * np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    noise = np.random.default_rng(5).normal(0.0, 1.0, (40, *SHAPE))
    np.save(tmp_path / "wall.npy", ranges + noise)
    assert tofmix("import", tmp_path / "wall.npy", "-o", tmp_path / "wall.h5").code == 0
    assert tofmix("estimate", tmp_path / "wall.h5").code == 0
    return tmp_path / "wall.layers.h5"


def depths_mm(path: Path) -> np.ndarray:
    names = path.read_text().splitlines()[0].split(",")
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=names.index("z")) * 1000.0


def test_wall_seen_by_a_pinhole_is_exported_flat(tofmix: Tofmix, layers: Path) -> None:
    output = layers.with_name("wall.csv")
    done = tofmix("export", layers, "-o", output, "--fov", VIEW, "--projection", "pinhole")
    assert done.code == 0
    assert "placed by an ideal pinhole of 64 x 50 degrees" in done.out
    assert np.abs(depths_mm(output) - WALL_MM).max() < 1.0
    done = tofmix("export", layers, "-o", output, "--fov", VIEW, "--overwrite")
    assert "placed by field of view 64 x 50 degrees, equal angles" in done.out
    assert np.ptp(depths_mm(output)) > 30.0


def test_surfaces_take_the_view_of_a_file_that_has_none(tofmix: Tofmix, layers: Path) -> None:
    assert tofmix("surfaces", layers).code == ExitCode.BAD_INPUT
    done = tofmix("surfaces", layers, "--fov", VIEW, "--projection", "pinhole")
    assert done.code == 0
    assert "1 surface" in done.out
    assert "an ideal pinhole of 64 x 50 degrees" in done.out
    planes = layers.with_name("wall.json")
    assert tofmix("export", layers.with_name("wall.surfaces.h5"), "-o", planes, "--what", "planes").code == 0
    (plane,) = json.loads(planes.read_text())["surfaces"]
    assert abs(abs(plane["offset_mm"]) - WALL_MM) < 1.0
