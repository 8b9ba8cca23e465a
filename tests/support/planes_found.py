"""Surfaces as `tofmix surfaces` finds them, made by hand: a board before a wall, with an edge or two."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tofmix.io.surfaces_file import SurfacesWriter
from tofmix.sensor import Sensor
from tofmix.surfaces.found import Edges, Planes, SurfacesProvenance, WindowSurfaces, no_edges

ROWS, COLS, LAYERS, FACTOR = 6, 8, 3, 4
SENSOR = Sensor(name="camera", range_max_mm=7500.0, fov_horizontal_deg=16.0, fov_vertical_deg=12.0)

BOARD_MM, WALL_MM = 1000.0, 2500.0
"""Depths of two planes that face the camera."""

LEFT, RIGHT, TOP, BOTTOM = 1.25, 5.5, 0.25, 3.75
"""Edges of the board: columns and rows; all lie between parts of pixels."""


def provenance(factor: int = FACTOR) -> SurfacesProvenance:
    """Where made-up surfaces are from."""
    return SurfacesProvenance(
        source="a.layers.h5", source_sha256="ab" * 32, version="9.9", sensor=SENSOR, options={"factor": factor}
    )


def places(count: int, factor: int) -> NDArray[np.float64]:
    """Where the parts of `count` pixels lie, in pixels, one after the other."""
    return np.array([k + (part + 0.5) / factor - 0.5 for k in range(count) for part in range(factor)])


def board_and_wall() -> WindowSurfaces:
    """A board (surface 0) before a wall (surface 1), and no return in the last column of pixels."""
    row, col = np.meshgrid(np.arange(ROWS), np.arange(COLS), indexing="ij")
    across = (col > LEFT - 0.5) & (col < RIGHT + 0.5) & (row > TOP - 0.5) & (row < BOTTOM + 0.5)
    inside = (col > LEFT + 0.5) & (col < RIGHT - 0.5) & (row > TOP + 0.5) & (row < BOTTOM - 0.5)
    surface = np.full((ROWS, COLS, LAYERS), -1, dtype=np.int32)
    wall = ~inside & (col < COLS - 1)
    surface[..., 0] = np.where(across, 0, np.where(wall, 1, -1))
    surface[..., 1] = np.where(across & wall, 1, -1)
    fine_row, fine_col = np.meshgrid(places(ROWS, FACTOR), places(COLS, FACTOR), indexing="ij")
    board = (fine_col > LEFT) & (fine_col < RIGHT) & (fine_row > TOP) & (fine_row < BOTTOM)
    surface_fine = np.where(board, 0, np.where(fine_col < COLS - 1.5, 1, -1)).astype(np.int32)
    rays = SENSOR.optics.rays(fine_row, fine_col, shape=(ROWS, COLS)) if SENSOR.optics else fine_row
    depth = np.array([BOARD_MM, WALL_MM, np.nan])[surface_fine]
    return WindowSurfaces(
        surface=surface,
        planes=Planes(
            n_pixels=np.array([(surface == k).sum() for k in (0, 1)], dtype=np.uint32),
            normal=np.array([[0, 0, 1]] * 2, dtype=np.float32),
            offset_mm=np.array([BOARD_MM, WALL_MM], dtype=np.float32),
            rms_mm=np.array([1.5, 2.5], dtype=np.float32),
        ),
        edges=board_edges(),
        range_fine=(depth / rays[..., 2]).astype(np.float32),
        surface_fine=surface_fine,
    )


def board_edges() -> Edges:
    """Line 0: the board's left edge and, from its lower corner on, its lower one; line 1: the end of the wall."""
    line_0 = [(0.25, 1.25), (1.5, 1.25), (3.75, 1.25), (3.75, 4.0), (3.75, 5.5)]
    line_1 = [(-0.5, 6.5), (5.5, 6.5)]
    row, col = np.array(line_0 + line_1, dtype=np.float32).T
    return Edges(
        row=row,
        col=col,
        stderr=np.array([0.02, 0.03, 0.02, 0.05, np.nan, 0.1, 0.2], dtype=np.float32),
        near=np.array([0] * 5 + [1] * 2, dtype=np.int32),
        far=np.array([1] * 5 + [-1] * 2, dtype=np.int32),
        line=np.array([0] * 5 + [1] * 2, dtype=np.int32),
    )


def nothing_found() -> WindowSurfaces:
    """A window without a surface."""
    return WindowSurfaces(
        surface=np.full((ROWS, COLS, LAYERS), -1, dtype=np.int32),
        planes=Planes(
            n_pixels=np.zeros(0, np.uint32),
            normal=np.zeros((0, 3), np.float32),
            offset_mm=np.zeros(0, np.float32),
            rms_mm=np.zeros(0, np.float32),
        ),
        edges=no_edges(),
        range_fine=np.full((ROWS * FACTOR, COLS * FACTOR), np.nan, dtype=np.float32),
        surface_fine=np.full((ROWS * FACTOR, COLS * FACTOR), -1, dtype=np.int32),
    )


def write_surfaces(path: Path, *windows: WindowSurfaces, **settings: Any) -> Path:  # noqa: ANN401  the writer's own
    """Write a surfaces file of some windows."""
    shape = (len(windows), ROWS, COLS)
    with SurfacesWriter(
        path, shape=shape, max_layers=LAYERS, factor=FACTOR, provenance=provenance(), **settings
    ) as writer:
        for found in windows:
            writer.write(found)
    return path
