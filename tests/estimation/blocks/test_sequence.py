"""Windows, cells, bands and workers: they change when and where a pixel is fitted, never what comes out."""

import threading
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from support.drawing import draw
from support.sizes import sized

from tofmix.arrays import Float32Array
from tofmix.estimation.blocks.reading import MemoryTooSmallError, ReadPlan, plan_reading, read_groups, working_bytes
from tofmix.estimation.blocks.sequence import estimate_cells, estimate_layers
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.settings import EstimateOptions
from tofmix.grid import Grid, plan_grid
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor
from tofmix.windows import plan_windows

COLS = sized(7, 1)


@pytest.fixture
def recording(rng: np.random.Generator, sensor: Sensor) -> ArrayRecording:
    samples = draw(rng, sensor, ranges_mm=[1000, 2600], shares=[0.4, 0.5], n=60, pixels=23 * COLS)
    return ArrayRecording(samples.reshape(60, 23, COLS), sensor)


class Counting(ArrayRecording):
    """Stored in chunks of 7 frames and 4 rows; counts how often each is read."""

    frame_step, row_step = 7, 4

    def __init__(self, recording: ArrayRecording) -> None:
        super().__init__(recording.read_range(slice(None), slice(None)), recording.sensor)
        self.chunks: Counter[tuple[int, int]] = Counter()
        self.largest = 0
        self.threads: set[str] = set()

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        for frame in {f // 7 for f in range(frames.start, frames.stop)}:
            self.chunks.update((frame, row) for row in {r // 4 for r in range(rows.start, rows.stop)})
        samples = super().read_range(frames, rows)
        self.largest = max(self.largest, samples.size)
        self.threads.add(threading.current_thread().name)
        return samples


def assert_equal(one: Layers, other: Layers) -> None:
    for spec in LAYER_FIELDS:
        np.testing.assert_array_equal(getattr(one, spec.name), getattr(other, spec.name), err_msg=spec.name)


def small(grid: Grid, rows: int, windows: int = 1) -> Grid:
    """The same grid in cells of a few rows."""
    return replace(grid, step=(windows, rows))


@pytest.mark.parametrize(("window", "stride"), [(None, None), (20, 20), (20, 7), (15, 40)])
@pytest.mark.parametrize("step", [(1, 23), (1, 4), (2, 8)])
def test_results_do_not_depend_on_workers_memory_or_cells(
    recording: ArrayRecording, window: int | None, stride: int | None, step: tuple[int, int]
) -> None:
    windows = plan_windows(60, window=window, stride=stride)
    reference = estimate_layers(recording, windows=windows)
    grid = small(plan_grid(windows, (23, COLS)), step[1], step[0])
    options = EstimateOptions()
    least = 2 * working_bytes(grid)
    for workers, buffer_bytes in ((1, 10**9), (2, least + 43_000 * COLS), (2, least + 6_400 * step[1] // 4 * COLS)):
        counting = Counting(recording)
        out = Layers.empty(reference.shape, options.max_layers)
        for cell, layers in estimate_cells(
            counting, grid, options, lambda layers: layers, workers=workers, buffer_bytes=buffer_bytes
        ):
            for spec in LAYER_FIELDS:
                getattr(out, spec.name)[cell.windows, cell.rows] = getattr(layers, spec.name)
        assert_equal(out, reference)
        assert counting.threads == {"tofmix-reader"}
        if step[1] < 23:
            assert max(counting.chunks.values()) == 1, "a chunk was read twice"


def test_less_memory_reads_less_at_once(recording: ArrayRecording) -> None:
    windows = plan_windows(60, window=20, stride=5)
    grid = small(plan_grid(windows, (23, COLS)), 4)
    largest = []
    for buffer_bytes in (10**9, working_bytes(grid) + 1_400 * COLS):
        counting = Counting(recording)
        plan = plan_reading(counting, grid, buffer_bytes=buffer_bytes, workers=1)
        for group in read_groups(counting, grid, plan, grid.cells()):
            assert sum(slab.range_mm.shape[0] for slab in group.slabs) >= 20
        largest.append(counting.largest)
        assert set(counting.chunks.values()) == {1}
    assert largest[1] <= 7 * 4 * COLS < largest[0]


def test_only_the_frames_of_wanted_cells_are_read(recording: ArrayRecording) -> None:
    grid = small(plan_grid(plan_windows(60, window=10), (23, COLS)), 4)
    counting = Counting(recording)
    wanted = [grid.cell(8), grid.cell(13)]
    little = working_bytes(grid) + 1_400 * COLS
    found = estimate_cells(counting, grid, EstimateOptions(), lambda _: None, wanted=wanted, buffer_bytes=little)
    done = [cell.index for cell, _ in found]
    assert done == [13, 8]  # band by band
    # Cell 8: window 1 (frames 10 to 19), rows 8 to 11. Cell 13: window 2 (frames 20 to 29), rows 4 to 7.
    assert set(counting.chunks) == {(1, 2), (2, 2)} | {(2, 1), (3, 1), (4, 1)}


def test_chunks_over_several_bands_are_reported(recording: ArrayRecording) -> None:
    class Framed(ArrayRecording):
        row_step = 23

    framed = Framed(recording.read_range(slice(None), slice(None)), recording.sensor)
    grid = small(plan_grid(plan_windows(60), (23, COLS)), 4)
    assert not plan_reading(framed, grid, buffer_bytes=10**9, workers=1).rereads
    assert plan_reading(framed, grid, buffer_bytes=working_bytes(grid) + 2_800 * COLS, workers=1).rereads
    with pytest.raises(MemoryTooSmallError, match="one row of one window takes") as refusal:
        plan_reading(framed, grid, buffer_bytes=1000, workers=1)
    assert isinstance(plan_reading(framed, grid, buffer_bytes=refusal.value.needed_bytes, workers=1), ReadPlan)


def test_long_windows_are_worked_on_in_pieces(recording: ArrayRecording, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = estimate_layers(recording)
    monkeypatch.setattr("tofmix.estimation.blocks.sequence.PIECE_SAMPLES", 3 * 60)
    assert_equal(estimate_layers(recording), reference)


def test_each_window_is_the_estimate_of_its_frames(recording: ArrayRecording, sensor: Sensor) -> None:
    windows = plan_windows(60, window=25, stride=10)
    layers = estimate_layers(recording, windows=windows)
    for k in range(windows.count):
        alone = layer_pixels(recording.read_range(slice(10 * k, 10 * k + 25), slice(None)), sensor)
        for spec in LAYER_FIELDS:
            np.testing.assert_array_equal(getattr(layers, spec.name)[k], getattr(alone, spec.name))


def test_a_consumer_may_stop_early(recording: ArrayRecording) -> None:
    grid = small(plan_grid(plan_windows(60, window=1), (23, COLS)), 4)
    before = set(threading.enumerate())
    cells = estimate_cells(recording, grid, EstimateOptions(min_samples=2), lambda _: None, workers=2)
    next(cells)
    assert set(threading.enumerate()) > before
    cells.close()
    with pytest.raises(StopIteration):
        next(cells)
    assert set(threading.enumerate()) <= before


def test_an_error_while_reading_reaches_the_caller(recording: ArrayRecording) -> None:
    class Broken(ArrayRecording):
        def read_range(self, frames: slice, rows: slice) -> Float32Array:
            raise OSError(f"no frames {frames} of rows {rows}")

    broken = Broken(recording.read_range(slice(None), slice(None)), recording.sensor)
    with pytest.raises(OSError, match="no frames slice"):
        estimate_layers(broken, workers=2)


def test_an_error_in_a_worker_reaches_the_caller(recording: ArrayRecording) -> None:
    samples = recording.read_range(slice(None), slice(None))
    blind = ArrayRecording(samples, replace(recording.sensor, noise=None))
    with pytest.raises(ValueError, match="noise curve"):
        estimate_layers(blind)


def test_zero_workers_are_refused(recording: ArrayRecording) -> None:
    with pytest.raises(ValueError, match="workers: 0"):
        estimate_layers(recording, workers=0)
