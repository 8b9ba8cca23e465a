"""Windows of frames, each of which gives its own layers, and the cells of an estimate.

A cell is computed, journaled, stored and sent to a cluster as one unit. It is a few windows of a band of rows, over all
columns. The cells depend on the sizes of the recording and its stored chunks alone, never on workers or memory, as they
are also the chunks of the layers file.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from tofmix.wording import counted


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows [start, start + length) of frames, `stride` apart.

    Frames after the last whole window are left out and counted in `frames_left_out`.
    """

    length: int
    stride: int
    count: int
    frames_left_out: int

    def of_samples(self, each: int) -> "Windows":
        """The same windows in samples of a pixel, where each frame has `each` of them."""
        return Windows(self.length * each, self.stride * each, self.count, self.frames_left_out * each)

    def in_frames(self, each: int) -> "Windows":
        """The inverse of `of_samples`: the windows in frames."""
        return Windows(self.length // each, self.stride // each, self.count, self.frames_left_out // each)

    def start(self, window: int) -> int:
        """First frame of a window."""
        return window * self.stride

    def stop(self, window: int) -> int:
        """One past the last frame of a window."""
        return window * self.stride + self.length


def plan_windows(n_frames: int, *, window: int | None = None, stride: int | None = None) -> Windows:
    """Plan the windows of a recording.

    Parameters
    ----------
    n_frames : int
        Frames in the recording, at least 1.
    window : int, optional
        Frames in a window; one window over all frames without it.
    stride : int, optional
        Frames from one window's start to the next; `window` without it.

    Returns
    -------
    Windows
        Whole windows only.

    Raises
    ------
    ValueError
        If a number is below 1, or the window is longer than the recording.
    """
    length = n_frames if window is None else window
    step = length if stride is None else stride
    if length < 1 or step < 1:
        raise ValueError(f"window {length} and stride {step} must be at least 1 frame")
    if length > n_frames:
        raise ValueError(f"a window of {counted(length, 'frame')} is longer than the recording's {n_frames}")
    count = (n_frames - length) // step + 1
    used = (count - 1) * step + length
    return Windows(length=length, stride=step, count=count, frames_left_out=n_frames - used)


CELL_PIXELS = 4096
"""Pixels of a cell, each window counted: a few 10 ms of work, and chunks that compress well."""

_CELL_SAMPLES = 1 << 22
"""Most samples of a cell, where one row of one window has not more: 17 MB in memory."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Windows and rows [start, stop) of one cell."""

    index: int
    windows: slice
    rows: slice


@dataclass(frozen=True, slots=True)
class Grid:
    """The cells of an estimate, numbered from 0 with the rows running fastest.

    `image` is (rows, columns); `step` is (windows, rows) of a cell, less at the far edges.
    """

    windows: Windows
    image: tuple[int, int]
    step: tuple[int, int]

    @property
    def bands(self) -> int:
        """Cells next to each other over the rows."""
        return -(-self.image[0] // self.step[1])

    @property
    def groups(self) -> int:
        """Cells that follow each other over the windows."""
        return -(-self.windows.count // self.step[0])

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.groups * self.bands

    def cell(self, index: int) -> Cell:
        """Return the cell of a number in [0, count)."""
        group, band = divmod(index, self.bands)
        first, top = group * self.step[0], band * self.step[1]
        return Cell(
            index,
            slice(first, min(first + self.step[0], self.windows.count)),
            slice(top, min(top + self.step[1], self.image[0])),
        )

    def frames(self, windows: slice) -> slice:
        """Frames that some consecutive windows need."""
        return slice(self.windows.start(windows.start), self.windows.stop(windows.stop - 1))

    def pixels(self, cell: Cell) -> int:
        """Pixels of a cell, each window counted."""
        windows, rows = (len(range(part.start, part.stop)) for part in (cell.windows, cell.rows))
        return windows * rows * self.image[1]

    def cells(self) -> Iterator[Cell]:
        """All cells in order."""
        return map(self.cell, range(self.count))


def plan_grid(windows: Windows, image: tuple[int, int], *, row_step: int = 1) -> Grid:
    """Plan the cells of a recording.

    Parameters
    ----------
    windows : Windows
        From `tofmix.grid.plan_windows`.
    image : (int, int)
        Rows, columns.
    row_step : int
        Rows of a stored chunk of the recording; cells are whole chunks high where that is near their size.

    Returns
    -------
    Grid
        Cells of about 4096 pixels, and one row of one window at least.
    """
    rows, cols = image
    pixels = max(1, min(CELL_PIXELS, _CELL_SAMPLES // windows.length))
    high = max(1, min(rows, pixels // cols))
    if high < rows and row_step <= high:
        high -= high % row_step
    most = min(pixels // (rows * cols), _CELL_SAMPLES // (rows * cols * windows.stride))
    return Grid(windows, image, (max(1, min(windows.count, most)), high))
