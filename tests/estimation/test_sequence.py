"""Windows, blocks and workers: they change when and where a pixel is fitted, never what comes out."""

from dataclasses import replace

import numpy as np
import pytest
from drawing import draw

from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.sequence import estimate_layers, estimate_windows, tile_shape
from tofmix.estimation.settings import EstimateOptions
from tofmix.layers import LAYER_FIELDS, Layers
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor
from tofmix.windows import Windows, plan_windows


@pytest.fixture
def recording(rng: np.random.Generator, sensor: Sensor) -> ArrayRecording:
    samples = draw(rng, sensor, ranges_mm=[1000, 2600], shares=[0.4, 0.5], n=60, pixels=23 * 7)
    return ArrayRecording(samples.reshape(60, 23, 7), sensor)


def _assembled(recording: ArrayRecording, windows: Windows, workers: int, chunk_mb: float) -> Layers:
    parts = list(estimate_windows(recording, windows, workers=workers, chunk_mb=chunk_mb))
    assert [part.windows.start for part in parts] == sorted(part.windows.start for part in parts)
    return Layers(
        **{spec.name: np.concatenate([getattr(part.layers, spec.name) for part in parts]) for spec in LAYER_FIELDS}
    )


@pytest.mark.parametrize(("window", "stride"), [(None, None), (20, 20), (20, 7), (15, 40)])
def test_results_do_not_depend_on_workers_or_chunks(
    recording: ArrayRecording, window: int | None, stride: int | None
) -> None:
    windows = plan_windows(60, window=window, stride=stride)
    reference = estimate_layers(recording, windows=windows)
    for workers, chunk_mb in ((1, 1e-9), (2, 0.01), (3, 64.0)):
        layers = _assembled(recording, windows, workers, chunk_mb)
        for spec in LAYER_FIELDS:
            np.testing.assert_array_equal(getattr(layers, spec.name), getattr(reference, spec.name))


def test_each_window_is_the_estimate_of_its_frames(recording: ArrayRecording, sensor: Sensor) -> None:
    windows = plan_windows(60, window=25, stride=10)
    layers = estimate_layers(recording, windows=windows)
    for k in range(windows.count):
        alone = layer_pixels(recording.read_range(slice(10 * k, 10 * k + 25), slice(None)), sensor)
        for spec in LAYER_FIELDS:
            np.testing.assert_array_equal(getattr(layers, spec.name)[k], getattr(alone, spec.name))


def test_progress_counts_every_pixel_of_every_window(recording: ArrayRecording) -> None:
    done: list[int] = []
    windows = plan_windows(60, window=20)
    for _ in estimate_windows(recording, windows, workers=2, chunk_mb=0.02, progress=done.append):
        pass
    assert sum(done) == 3 * 23 * 7


def test_a_consumer_may_stop_early(recording: ArrayRecording) -> None:
    parts = estimate_windows(recording, plan_windows(60, window=1), EstimateOptions(min_samples=2), workers=2)
    next(parts)
    parts.close()  # type: ignore[attr-defined]  # it is a generator
    with pytest.raises(StopIteration):
        next(parts)


def test_an_error_in_a_worker_reaches_the_caller(recording: ArrayRecording) -> None:
    samples = recording.read_range(slice(None), slice(None))
    blind = ArrayRecording(samples, replace(recording.sensor, noise=None))
    with pytest.raises(ValueError, match="noise curve"):
        estimate_layers(blind)


@pytest.mark.parametrize(("workers", "chunk_mb"), [(0, 1.0), (1, 0.0), (1, float("nan"))])
def test_numbers_out_of_bounds_are_refused(recording: ArrayRecording, workers: int, chunk_mb: float) -> None:
    with pytest.raises(ValueError, match="workers"):
        next(estimate_windows(recording, plan_windows(60), workers=workers, chunk_mb=chunk_mb))


def test_tiles_fit_the_image() -> None:
    assert tile_shape(1, 144, 176) == (1, 11)
    assert tile_shape(5, 1, 3) == (5, 1)
    assert tile_shape(10_000, 1, 1) == (2048, 1)
    assert tile_shape(3, 10, 5000) == (1, 1)
