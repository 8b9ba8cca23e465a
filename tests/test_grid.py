"""Cells cover every pixel of every window once, and depend on sizes alone."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tofmix.grid import plan_grid
from tofmix.windows import plan_windows


@given(
    count=st.integers(1, 40),
    stride=st.integers(1, 20),
    length=st.integers(1, 20),
    rows=st.integers(1, 300),
    cols=st.integers(1, 300),
    row_step=st.integers(1, 60),
)
def test_cells_cover_each_window_and_row_once(
    count: int, stride: int, length: int, rows: int, cols: int, row_step: int
) -> None:
    windows = plan_windows((count - 1) * stride + length, window=length, stride=stride)
    grid = plan_grid(windows, (rows, cols), row_step=row_step)
    seen = np.zeros((windows.count, rows), dtype=int)
    for index, cell in enumerate(grid.cells()):
        assert cell.index == index
        seen[cell.windows, cell.rows] += 1
        assert grid.pixels(cell) == cols * np.ones_like(seen)[cell.windows, cell.rows].sum()
    assert np.all(seen == 1)
    assert index + 1 == grid.count == grid.groups * grid.bands


def test_cells_fit_the_image_and_its_chunks() -> None:
    def step(n: int, window: int, image: tuple[int, int], row_step: int = 1) -> tuple[int, int]:
        return plan_grid(plan_windows(n, window=window), image, row_step=row_step).step

    assert step(100, 100, (144, 176)) == (1, 23)
    assert step(100, 100, (144, 176), 8) == (1, 16)
    assert step(100, 100, (144, 176), 144) == (1, 23)
    assert step(500, 100, (1, 3)) == (5, 1)
    assert step(10_000, 1, (1, 1)) == (4096, 1)
    assert step(300, 100, (10, 5000)) == (1, 1)


def test_long_windows_make_small_cells() -> None:
    # Samples, not pixels, take the memory.
    grid = plan_grid(plan_windows(20_000), (144, 176), row_step=8)
    assert grid.step == (1, 1)
    assert plan_grid(plan_windows(10**6, window=10**5), (1, 1)).step[0] == 10


def test_the_frames_of_a_cell_are_those_of_its_windows() -> None:
    grid = plan_grid(plan_windows(60, window=20, stride=7), (4, 4))
    assert grid.frames(slice(1, 3)) == slice(7, 34)
