"""Windows, cells, bands and workers change when a pixel is fitted, never what; the span and the means of samples."""

import threading
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drawing import draw
from support.sizes import sized

from tofmix.arrays import Float32Array
from tofmix.estimation.beam import beam_of, outlier_interval
from tofmix.estimation.blocks import finishing
from tofmix.estimation.blocks.finishing import layer_amplitudes
from tofmix.estimation.blocks.reading import MemoryTooSmallError, ReadPlan, plan_reading, read_groups, working_bytes
from tofmix.estimation.blocks.sequence import estimate_cells, estimate_layers
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.peaks.incremental import IncrementalDensity
from tofmix.estimation.samples import invalid_share, sample_span
from tofmix.estimation.settings import EstimateOptions
from tofmix.flags import Mixing
from tofmix.grid import Grid, plan_grid, plan_windows
from tofmix.layers import LAYER_FIELDS, Layers, layer_fields
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.unmixing.unmix import Rewritten

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


def test_an_error_while_reading_or_in_a_worker_reaches_the_caller(recording: ArrayRecording) -> None:
    class Broken(ArrayRecording):
        def read_range(self, frames: slice, rows: slice) -> Float32Array:
            raise OSError(f"no frames {frames} of rows {rows}")

    broken = Broken(recording.read_range(slice(None), slice(None)), recording.sensor)
    with pytest.raises(OSError, match="no frames slice"):
        estimate_layers(broken, workers=2)
    samples = recording.read_range(slice(None), slice(None))
    blind = ArrayRecording(samples, replace(recording.sensor, noise=None))
    with pytest.raises(ValueError, match="noise curve"):
        estimate_layers(blind)
    with pytest.raises(ValueError, match="workers: 0"):
        estimate_layers(recording, workers=0)


CURVE = NoiseCurve(np.array([500.0, 3000.0]), np.array([10.0, 20.0]))
ENDLESS = Sensor(name="endless", noise=CURVE)


class Stored(ArrayRecording):
    """Samples in stored chunks of some frames and rows, which notes what is read."""

    def __init__(self, samples: Float32Array, step: tuple[int, int]) -> None:
        super().__init__(samples, ENDLESS)
        self.step = step
        self.reads = np.zeros(samples.shape[:2], dtype=np.int64)

    @property
    def frame_step(self) -> int:
        return self.step[0]

    @property
    def row_step(self) -> int:
        return self.step[1]

    def read_range(self, frames: slice, rows: slice) -> Float32Array:
        self.reads[frames, rows] += 1
        return super().read_range(frames, rows)


@pytest.mark.slow
@given(
    shape=st.tuples(st.integers(1, 40), st.integers(1, 30)),
    step=st.tuples(st.integers(1, 50), st.integers(1, 40)),
    least=st.integers(1, 400),
)
def test_every_sample_is_read_once_for_any_chunks(shape: tuple[int, int], step: tuple[int, int], least: int) -> None:
    samples = np.arange(shape[0] * shape[1], dtype=np.float32).reshape(*shape, 1)
    recording = Stored(samples, step)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tofmix.estimation.samples.DECODED_SAMPLES", least)
        assert sample_span(recording) == (0.0, samples.max())
    assert (recording.reads == 1).all()


def test_wild_samples_cost_no_memory_and_invalid_ones_no_range() -> None:
    samples = np.array([np.nan, np.inf, -np.inf, 2e9, -2e9, 700.0, 900.0], dtype=np.float32)
    assert sample_span(ArrayRecording(samples.reshape(-1, 1, 1), ENDLESS)) == (700.0, 900.0)
    assert sample_span(ArrayRecording(np.full((4, 1, 1), np.nan), ENDLESS)) is None
    rng = np.random.default_rng(4)
    samples = (1200.0 + 12.0 * rng.standard_normal((60, 4, 3))).astype(np.float32)
    samples[7, 0, 0] = 1500.0  # a random value of the first pixel
    wild = samples.copy()
    wild[55, 3, 2] = 60_000.0
    near, far = (estimate_layers(ArrayRecording(values, ENDLESS)) for values in (samples, wild))
    # The first pixel's own samples are the same; its random value is the less likely, the longer the interval.
    ratio = (60_000.0 - samples.min()) / (1500.0 - samples.min())
    fell = near.log_likelihood[0, 0, 0] - far.log_likelihood[0, 0, 0]
    assert fell == pytest.approx(np.log(ratio), abs=0.02)
    endless = replace(ENDLESS, sample_min_mm=-9e8, sample_max_mm=9e8)
    np.testing.assert_array_equal(IncrementalDensity(endless, 1).range_mm, IncrementalDensity(ENDLESS, 1).range_mm)


@pytest.mark.parametrize(
    ("known", "interval"),
    [
        ({"sample_min_mm": 400.0, "sample_max_mm": 2900.0}, (400.0, 2900.0)),
        ({"sample_min_mm": 400.0, "sample_max_mm": 2900.0, "range_min_mm": 300.0}, (300.0, 2900.0)),
        ({"sample_min_mm": 400.0, "sample_max_mm": 2900.0, "range_min_mm": 3500.0}, (400.0, 2900.0)),
        ({"sample_min_mm": 400.0, "sample_max_mm": 2900.0, "range_max_mm": 6000.0}, (0.0, 6000.0)),
        ({"sample_min_mm": 500.0, "sample_max_mm": 500.0}, (470.0, 530.0)),  # 6 sigma of 10 mm
        ({}, (0.0, 3000.0)),
    ],
)
def test_random_values_spread_over_the_working_range_or_the_extreme_samples(
    known: dict[str, float], interval: tuple[float, float]
) -> None:
    sensor = replace(ENDLESS, **known)  # type: ignore[arg-type]  # all numbers
    assert outlier_interval(sensor, CURVE) == interval
    assert beam_of(sensor).outlier_density == pytest.approx(1e-4 / (interval[1] - interval[0]))


CAMERA = Sensor(name="a", range_min_mm=100.0, range_max_mm=6000.0, noise=NoiseCurve(np.array([1e3]), np.array([10.0])))


def two_surfaces(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Samples (frame, row, col) and amplitudes of a near bright and a far dark surface; a tenth is lost."""
    rng = np.random.default_rng(seed)
    near = rng.random((60, 3, 4)) < 0.5
    samples = np.where(near, 1000.0, 3000.0) + 10.0 * rng.standard_normal(near.shape)
    light = np.where(near, 400.0, 50.0) + rng.standard_normal(near.shape)
    samples[rng.random(near.shape) < 0.1] = np.nan
    samples[0, 0, 0], light[0, 0, 0] = 5000.0, 1e6  # of no layer
    light[1, 1, 1] = np.nan
    return samples.astype(np.float32), light.astype(np.float32)


def test_amplitudes_are_means_of_the_samples_of_their_layer() -> None:
    samples, light = two_surfaces()
    layers = layer_pixels(samples, CAMERA)
    found = layer_amplitudes(samples, light, layers)
    assert (layers.n_modes == 2).all()
    for row, col in np.ndindex(3, 4):
        for layer, place in enumerate((1000.0, 3000.0)):
            of_layer = np.abs(samples[:, row, col] - place) < 60.0
            assert found[row, col, layer] == pytest.approx(np.nanmean(light[of_layer, row, col]), rel=1e-6)
    assert np.isnan(found[..., 2:]).all()
    samples = np.array([[2.0], [4998.0], [1.0], [4999.0]], np.float32)
    layers = layer_pixels(samples[:1].repeat(4, axis=0), CAMERA)
    assert layer_amplitudes(samples, np.array([[1.0], [2], [3], [4]]), layers)[0, 0] == pytest.approx(2.0)
    assert layer_amplitudes(samples, np.array([[1.0], [2], [3], [4]]), layers, circle_mm=5e3)[0, 0] == pytest.approx(
        2.5
    )
    samples, light = two_surfaces()
    with_light, without = (estimate_layers(ArrayRecording(samples, CAMERA, *more)) for more in ((light,), ()))
    assert without.amplitude is None
    assert with_light.amplitude is not None
    np.testing.assert_allclose(with_light.amplitude[0, 2, 2, :2], [400.0, 50.0], rtol=0.02)
    assert with_light.probability.tobytes() == without.probability.tobytes()


def test_invalid_share_counts_frames_without_any_valid_target_but_not_those_of_a_filter() -> None:
    samples = np.array([[1.0, np.nan], [np.nan, np.nan], [2.0, 3.0], [4.0, 2e9], [np.nan, np.inf], [np.nan, 1.0]])
    np.testing.assert_allclose(invalid_share(samples), [0.5, 4 / 6], rtol=1e-6)
    np.testing.assert_allclose(invalid_share(samples, samples_a_frame=2), [1 / 3, 1 / 3], rtol=1e-6)
    samples = np.array([[1.0, np.nan], [np.inf, np.inf], [np.inf, 3.0], [4.0, 2e9]])
    np.testing.assert_allclose(invalid_share(samples, is_filtered=True), [0.0, 2 / 3], rtol=1e-6)


def test_estimate_gives_the_share_of_lost_samples_and_weighs_layers_by_it() -> None:
    rng = np.random.default_rng(3)
    samples = 2000.0 + 10.0 * rng.standard_normal((100, 12, 12))
    lost = np.zeros(samples.shape, bool)
    lost[:, 4:8, 4:8] = rng.random((100, 4, 4)) < 0.92
    found = estimate_layers(ArrayRecording(np.where(lost, np.nan, samples), CAMERA))
    assert found.invalid_share is not None
    np.testing.assert_allclose(found.invalid_share[0], lost.mean(axis=0), atol=1e-6)
    dark = lost.any(axis=0) & (found.n_modes[0] > 0)
    assert found.probability[0, dark, 0].max() < 0.3
    assert (found.probability[0, ~lost.any(axis=0), 0] == 1.0).all()


@pytest.mark.parametrize("insist", [False, True])
def test_unmixed_pixels_behind_a_filter_over_pixels_stay_if_sums_are_insisted_on(
    monkeypatch: pytest.MonkeyPatch, *, insist: bool
) -> None:
    layers = Layers.empty((1, 3), 2, layer_fields(Sensor(name="camera")))
    layers = replace(layers, invalid_share=np.zeros((1, 3), np.float32))
    layers.n_modes[:] = [1, 2, 2]
    layers.probability[0] = [[0.9, np.nan], [0.9, 0.9], [0.9, 0.9]]
    mixing = np.array([[Mixing.ONE_SURFACE, Mixing.EVENTS, Mixing.PHASOR]], np.uint8)
    unmixed = Rewritten(layers=replace(layers, mixing=mixing), phasor_share=1.0, informative_pixels=1)
    monkeypatch.setattr(finishing, "unmix", lambda *_, **__: unmixed)
    sensor = Sensor(name="camera", neighbour_correlation=0.6)
    done = finishing.finish_window(layers, np.zeros((1, 3, 7), np.float32), sensor, frames=9, insist=insist).layers
    kept = Mixing.PHASOR if insist else Mixing.UNDECIDED
    assert done.mixing is not None
    np.testing.assert_array_equal(done.mixing, [[Mixing.ONE_SURFACE, Mixing.UNDECIDED, kept]])
    assert [bool((row > 0.5).any()) for row in done.probability[0]] == [True, False, insist]
