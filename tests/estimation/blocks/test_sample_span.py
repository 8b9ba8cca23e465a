"""Where random values spread if the working range is not known: between the extreme samples of the whole recording."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tofmix.arrays import Float32Array
from tofmix.estimation.beam import beam_of, outlier_interval
from tofmix.estimation.blocks.sample_span import sample_span, sensor_with_span
from tofmix.estimation.blocks.sequence import estimate_cells, estimate_layers
from tofmix.estimation.peaks.incremental import IncrementalDensity
from tofmix.estimation.settings import EstimateOptions
from tofmix.grid import plan_grid
from tofmix.layers import LAYER_FIELDS
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.windows import plan_windows

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
        patch.setattr("tofmix.estimation.blocks.sample_span.DECODED_SAMPLES", least)
        assert sample_span(recording) == (0.0, samples.max())
    assert (recording.reads == 1).all()


def test_invalid_samples_do_not_extend_the_range() -> None:
    samples = np.array([np.nan, np.inf, -np.inf, 2e9, -2e9, 700.0, 900.0], dtype=np.float32)
    assert sample_span(ArrayRecording(samples.reshape(-1, 1, 1), ENDLESS)) == (700.0, 900.0)
    assert sample_span(ArrayRecording(np.full((4, 1, 1), np.nan), ENDLESS)) is None


@pytest.mark.parametrize("circle", [None, 7495.0])
def test_known_range_or_circle_reads_no_samples(circle: float | None) -> None:
    recording = Stored(np.full((4, 2, 1), 900.0, dtype=np.float32), (1, 1))
    if circle is None:
        recording = recording.with_sensor(replace(ENDLESS, range_max_mm=6000.0))
    sensor = sensor_with_span(recording, circle)
    assert (sensor.sample_min_mm, sensor.sample_max_mm) == (None, None)
    assert not recording.reads.any()


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


def test_one_wild_sample_changes_the_outlier_density_of_all_pixels() -> None:
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


def test_cells_alone_and_all_together_have_the_same_interval() -> None:
    rng = np.random.default_rng(5)
    samples = (1200.0 + 12.0 * rng.standard_normal((80, 6, 3))).astype(np.float32)
    samples[3, 1, 1], samples[78, 5, 2] = 2500.0, 9000.0
    recording, windows = ArrayRecording(samples, ENDLESS), plan_windows(80, window=20)
    whole = estimate_layers(recording, windows=windows)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tofmix.grid.CELL_PIXELS", 6)
        grid = plan_grid(windows, (6, 3))
    assert grid.count > 1
    for cell in grid.cells():
        ((_, alone),) = estimate_cells(recording, grid, EstimateOptions(), lambda layers: layers, wanted=[cell])
        for spec in LAYER_FIELDS:
            expected = getattr(whole, spec.name)[cell.windows, cell.rows]
            np.testing.assert_array_equal(getattr(alone, spec.name), expected)


def test_live_density_takes_no_memory_for_a_wild_sample() -> None:
    wild = replace(ENDLESS, sample_min_mm=-9e8, sample_max_mm=9e8)
    np.testing.assert_array_equal(IncrementalDensity(wild, 1).range_mm, IncrementalDensity(ENDLESS, 1).range_mm)
