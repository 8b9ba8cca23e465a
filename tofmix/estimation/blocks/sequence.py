"""Layers of a whole recording: cells of windows and rows, worker threads, one reader.

One thread reads slabs (`reading`) while others work on the cells of earlier ones, as the kernels hold no lock; a group
of cells is read only after an earlier one was taken, so memory stays bounded. Cells come out in the order in which they
were read, each as soon as it is done.
"""

import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import Float32Array
from tofmix.estimation.blocks.finishing import finish_window, layer_amplitudes
from tofmix.estimation.blocks.reading import PIECE_SAMPLES, Group, ReadPlan, plan_reading, read_groups
from tofmix.estimation.layering import layer_pixels, warm_up
from tofmix.estimation.samples import sensor_with_span
from tofmix.estimation.settings import EstimateOptions, MixingChoice
from tofmix.grid import Cell, Grid, Windows, plan_grid
from tofmix.layers import MIXING, Layers, layer_fields
from tofmix.recording import SampleSource, amplitude_source, has_phasors, independent_samples, samples_a_frame
from tofmix.sensor import Sensor, sensor_of_part
from tofmix.suspicion import judge_windows
from tofmix.suspicion.evidence import gather_evidence
from tofmix.suspicion.evidence import warm_up as warm_up_evidence
from tofmix.suspicion.scene import WindowSamples, joined
from tofmix.unmixing.image import FIELD_COUNT, mean_phasors

T = TypeVar("T")

DEFAULT_BUFFER_BYTES = 800_000_000
"""Default of the memory for samples, bytes."""


def resolved_mixing(options: EstimateOptions, source: SampleSource) -> EstimateOptions:
    """The same options with the law of mixing that can be measured: ``events`` where samples are no phasors.

    Raises
    ------
    ValueError
        If phasor sums are insisted on, and amplitudes or the modulation frequency are not known.
    """
    if options.mixing is MixingChoice.EVENTS or has_phasors(source):
        return options
    if options.mixing is MixingChoice.PHASOR:
        raise ValueError("mixing: phasor sums need amplitudes, a modulation frequency, and one sample a frame")
    return replace(options, mixing=MixingChoice.EVENTS)


def estimate_cells(
    source: SampleSource,
    grid: Grid,
    options: EstimateOptions,
    finish: Callable[..., T],
    *,
    workers: int = 1,
    buffer_bytes: int = DEFAULT_BUFFER_BYTES,
    wanted: Iterable[Cell] | None = None,
    phasors: bool = False,
    each: int | None = None,
    evidence: bool = False,
) -> Generator[tuple[Cell, T], None, None]:
    """Estimate the layers of some cells of a recording.

    Parameters
    ----------
    source : SampleSource
        The recording; its sensor must have a noise curve. It is read by one other thread. Without `range_max_mm` and
        `sample_max_mm`, it is read once more before that, for its extreme samples.
    grid : Grid
        From `tofmix.grid.plan_grid`.
    finish : callable
        Called in the worker with the layers of a cell, of the leading shape (window, row, col), under equation (1).
        With `phasors`, its second argument are the mean phasors (window, row, col, 7) float32 of
        `tofmix.unmixing.image`, which `tofmix.unmixing.unmix` takes when a window is whole.
    workers : int
        Threads, at least 1. It changes no value.
    buffer_bytes : int
        Memory for samples and work. It changes no value.
    wanted : iterable of Cell, optional
        The cells to estimate; all without it.
    phasors : bool
        Whether mean phasors are wanted; the recording must have them (`tofmix.recording.has_phasors`).
    each : int, optional
        Samples of a frame, its targets; by default those of the recording.
    evidence : bool
        Whether evidence of suspicions is wanted. Then `finish` is called with the layers, the mean phasors or None, and
        a list of `tofmix.suspicion.scene.Evidence`, one of each window.

    Yields
    ------
    (Cell, T)
        Result of `finish`; bands one after the other, each in the order of its windows.

    Raises
    ------
    ValueError
        If the sensor has no noise curve, or `workers` is below 1.
    MemoryTooSmallError
        If one row of one window does not fit into `buffer_bytes`.
    """
    if workers < 1:
        raise ValueError(f"workers: {workers} is not at least 1")
    sensor = source.sensor
    if sensor.sample_max_mm is None:
        sensor = sensor_with_span(source, options.unambiguous_range_mm)
    plan = plan_reading(source, grid, buffer_bytes=buffer_bytes, workers=workers, phasors=True)
    # Compile or load the kernels before there are threads: several at once would wait for each other.
    warm_up(options, sensor)
    has_light = amplitude_source(source) is not None
    if has_light:
        layer_amplitudes(np.zeros((1, 1)), np.zeros((1, 1)), Layers.empty((1,), options.max_layers))
    if evidence:
        warm_up_evidence(options.max_layers)
    groups = read_groups(source, grid, plan, grid.cells() if wanted is None else wanted, phasors=True)
    each = samples_a_frame(source) if each is None else each
    work = _Work(sensor, grid, options, finish, phasors=phasors, each=each, has_light=has_light, evidence=evidence)
    run = _Run(groups, plan, work, workers)
    with closing(run.results()) as results:
        yield from results


class _Work(Generic[T]):
    """Work on one cell; `each` is the number of samples of a frame, `has_light` whether they have amplitudes.

    With `evidence`, that of suspicions is gathered too.
    """

    def __init__(
        self,
        sensor: Sensor,
        grid: Grid,
        options: EstimateOptions,
        finish: Callable[..., T],
        *,
        phasors: bool,
        each: int,
        has_light: bool,
        evidence: bool,
    ) -> None:
        self._sensor, self._grid, self._options, self._finish = sensor, grid, options, finish
        self._phasors, self._each, self._has_light, self._evidence = phasors, each, has_light, evidence

    def __call__(self, group: Group, cell: Cell) -> T:
        """Estimate a cell of a group."""
        rows, cols = cell.rows.stop - cell.rows.start, self._grid.image[1]
        count = cell.windows.stop - cell.windows.start
        out = Layers.empty(
            (count, rows, cols), self._options.max_layers, layer_fields(self._sensor, amplitude=self._has_light)
        )
        phasors = np.empty((count, rows, cols, FIELD_COUNT), np.float32) if self._phasors else None
        evidence = []
        for window in range(count):
            pieces = []
            frames = self._grid.frames(slice(cell.windows.start + window, cell.windows.start + window + 1))
            for piece_rows, piece_cols in self._pieces(cell.rows):
                samples = group.samples(frames, piece_rows, piece_cols)
                light = group.amplitudes(frames, piece_rows, piece_cols)
                sensor = sensor_of_part(self._sensor, piece_rows, piece_cols)
                layers = layer_pixels(samples, sensor, self._options, amplitude=light, samples_a_frame=self._each)
                if light is not None:
                    circle_mm = self._options.unambiguous_range_mm
                    layers = replace(layers, amplitude=layer_amplitudes(samples, light, layers, circle_mm=circle_mm))
                place = slice(piece_rows.start - cell.rows.start, piece_rows.stop - cell.rows.start)
                for spec in out.fields:
                    getattr(out, spec.name)[window, place, piece_cols] = getattr(layers, spec.name)
                if phasors is not None and light is not None:
                    phasors[window, place, piece_cols] = mean_phasors(samples, light, self._sensor)
                if self._evidence:
                    circle_mm = self._options.unambiguous_range_mm
                    found = gather_evidence(
                        samples,
                        layers,
                        targets=self._each,
                        circle_mm=circle_mm,
                        place=(piece_rows.start, piece_cols.start),
                        image=self._grid.image,
                    )
                    pieces.append((place.start, piece_cols.start, found))
            evidence.append(joined(pieces))
        if self._evidence:
            return self._finish(out, phasors, evidence)
        return self._finish(out) if phasors is None else self._finish(out, phasors)

    def _pieces(self, rows: slice) -> Iterator[tuple[slice, slice]]:
        cols = self._grid.image[1]
        pixels = max(1, PIECE_SAMPLES // self._grid.windows.length)
        high, wide = max(1, pixels // cols), min(pixels, cols)
        for top in range(rows.start, rows.stop, high):
            for left in range(0, cols, wide):
                yield slice(top, min(top + high, rows.stop)), slice(left, min(left + wide, cols))


class _Item(NamedTuple, Generic[T]):
    """A cell that was given to the workers; `last` of its group."""

    cell: Cell
    future: "Future[T]"
    last: bool


class _Run(Generic[T]):
    """The reader, the workers, and the queue of their tasks."""

    def __init__(self, groups: Iterator[Group], plan: ReadPlan, work: _Work[T], workers: int) -> None:
        self._groups, self._work = groups, work
        self._workers = ThreadPoolExecutor(workers, thread_name_prefix="tofmix")
        self._free_slots = threading.Semaphore(plan.ahead)
        self._queue: SimpleQueue[_Item[T] | BaseException | None] = SimpleQueue()
        self._stop = threading.Event()
        self._reader = threading.Thread(target=self._read, name="tofmix-reader", daemon=True)

    def _read(self) -> None:
        """Read group by group; an error is passed on like a result."""
        try:
            while self._free_slots.acquire() and not self._stop.is_set():
                group = next(self._groups, None)
                if group is None:
                    break
                for cell in group.cells:
                    self._queue.put(_Item(cell, self._workers.submit(self._work, group, cell), cell is group.cells[-1]))
                del group, cell  # its samples go when the workers are done with them, not when the next are in
            self._queue.put(None)
        except BaseException as error:  # noqa: BLE001  raised again by `results`
            self._queue.put(error)

    def results(self) -> Generator[tuple[Cell, T], None, None]:
        """Yield the results of the workers, in order."""
        self._reader.start()
        try:
            while (item := self._queue.get()) is not None:
                if isinstance(item, BaseException):
                    raise item
                result = item.future.result()
                if item.last:
                    self._free_slots.release()
                yield item.cell, result
        finally:
            self._stop.set()
            self._free_slots.release()
            self._workers.shutdown(wait=False, cancel_futures=True)
            self._reader.join()
            self._workers.shutdown(wait=True, cancel_futures=True)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedWindows:
    """Layers of all windows of a recording.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (window, row, col).
    phasor_share : (window,) float32 or None
        Share of the samples at edges that are phasor sums, NaN if no pixel determines it; None: not measured.
    phasor_pixels : (window,) uint32 or None Pixels that determine it.
    """

    layers: Layers
    phasor_share: Float32Array | None = None
    phasor_pixels: NDArray[np.uint32] | None = None


def estimate_windows(
    source: SampleSource,
    options: EstimateOptions | None = None,
    *,
    windows: Windows | None = None,
    workers: int = 1,
    buffer_bytes: int = DEFAULT_BUFFER_BYTES,
) -> EstimatedWindows:
    """Layers of a whole recording in memory, and the law of mixing.

    A short form of `estimate_cells` for scripts; parameters and refusals are its own.

    Raises
    ------
    ValueError
        As `estimate_cells`.
    """
    source = independent_samples(source)
    options = resolved_mixing(options or EstimateOptions(), source)
    measured = options.mixing is not MixingChoice.EVENTS
    frames, rows, cols = source.shape
    windows = windows or Windows(length=frames, stride=frames, count=1, frames_left_out=0)
    grid = plan_grid(windows, (rows, cols), row_step=source.row_step)
    shape = windows.count, rows, cols
    has_light = amplitude_source(source) is not None
    has_mixing = measured or source.sensor.filters_over_pixels
    out = Layers.empty(shape, options.max_layers, layer_fields(source.sensor, amplitude=has_light, mixing=has_mixing))
    phasors = np.empty((*shape, FIELD_COUNT), np.float32) if measured else None
    cells = estimate_cells(
        source,
        grid,
        options,
        lambda *parts: parts,
        workers=workers,
        buffer_bytes=buffer_bytes,
        phasors=measured,
        evidence=True,
    )
    pieces: list[list[tuple[int, int, WindowSamples]]] = [[] for _ in range(windows.count)]
    for cell, (layers, *found) in cells:
        for window, part in enumerate(found[1], start=cell.windows.start):
            pieces[window].append((cell.rows.start, 0, part))
        for spec in layers.fields:
            getattr(out, spec.name)[cell.windows, cell.rows] = getattr(layers, spec.name)
        if phasors is not None:
            phasors[cell.windows, cell.rows] = found[0]
    evidence = [joined(parts) for parts in pieces]
    first_frames = [window * windows.stride // samples_a_frame(source) for window in range(windows.count)]
    insist = options.mixing is MixingChoice.PHASOR
    before = [spec for spec in out.fields if spec is not MIXING]  # the last steps give the mixing
    done = [
        finish_window(
            Layers(**{spec.name: getattr(out, spec.name)[window] for spec in before}),
            None if phasors is None else phasors[window],
            source.sensor,
            insist=insist,
            frames=windows.length // samples_a_frame(source),
            circle_mm=options.unambiguous_range_mm,
        )
        for window in range(windows.count)
    ]
    for window, one in enumerate(done):
        for spec in out.fields:
            getattr(out, spec.name)[window] = getattr(one.layers, spec.name)
    marked = judge_windows(
        out, evidence, source.sensor, first_frames=first_frames, circle_mm=options.unambiguous_range_mm
    )
    if phasors is None:
        return EstimatedWindows(layers=marked)
    shares = np.array([one.phasor_share for one in done], np.float32)
    pixels = np.array([one.phasor_pixels for one in done], np.uint32)
    return EstimatedWindows(layers=marked, phasor_share=shares, phasor_pixels=pixels)


def estimate_layers(
    source: SampleSource,
    options: EstimateOptions | None = None,
    *,
    windows: Windows | None = None,
    workers: int = 1,
    buffer_bytes: int = DEFAULT_BUFFER_BYTES,
) -> Layers:
    """Layers of a whole recording in memory, of the leading shape (window, row, col), as `estimate_windows`."""
    return estimate_windows(source, options, windows=windows, workers=workers, buffer_bytes=buffer_bytes).layers
