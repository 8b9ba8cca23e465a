import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tofmix.errors import UsageError
from tofmix.layers import Layers
from tofmix.optics.geometry import unambiguous_range_mm
from tofmix.recording import ArrayRecording
from tofmix.report.averaging import Averaging, average_layers, average_samples
from tofmix.sensor import Sensor

PERIOD = unambiguous_range_mm(20.0e6)


def naive_phasor_mean(samples: list[float], amplitudes: list[float]) -> float:
    """One pixel, sample by sample."""
    known = [(r, a) for r, a in zip(samples, amplitudes, strict=True) if math.isfinite(r)]
    if not known:
        return math.nan
    x = sum(a * math.cos(2 * math.pi * r / PERIOD) for r, a in known)
    y = sum(a * math.sin(2 * math.pi * r / PERIOD) for r, a in known)
    mean = sum(r for r, _ in known) / len(known)
    turn = math.atan2(y, x) * PERIOD / (2 * math.pi)
    return min((turn + k * PERIOD for k in range(-2, 4)), key=lambda r: abs(r - mean))


@pytest.mark.parametrize(("row_step", "block"), [(1, 1 << 19), (4, 40), (9, 7), (1, 1)])
def test_phasor_mean_is_the_naive_one_in_any_blocks(
    row_step: int, block: int, make_recording: Callable[..., object]
) -> None:
    recording = make_recording((30, 9, 5), row_step=row_step)
    image = average_samples(recording, start=3, stop=28, block_samples=block)  # type: ignore[arg-type]
    assert image.averaging is Averaging.PHASOR
    samples, amplitude = recording.range_mm[3:28], recording.amplitude[3:28]  # type: ignore[attr-defined]
    for row in range(9):
        for col in range(5):
            expected = naive_phasor_mean(samples[:, row, col].tolist(), amplitude[:, row, col].tolist())
            assert image.range_mm[row, col] == pytest.approx(expected, nan_ok=True)


def test_average_reads_no_more_samples_at_once_than_it_is_allowed(make_recording: Callable[..., object]) -> None:
    recording = make_recording((50, 9, 11), row_step=2)
    average_samples(recording, start=0, stop=50, block_samples=100)  # type: ignore[arg-type]
    assert max(recording.blocks) <= 100  # type: ignore[attr-defined]


def test_the_mean_keeps_to_the_turn_of_the_samples() -> None:
    class WithAmplitude(ArrayRecording):
        has_amplitude = True

        def read_amplitude(self, frames: slice, rows: slice) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
            return np.ones_like(self.read_range(frames, rows))

    sensor = Sensor(name="far", modulation_frequency_hz=20.0e6)
    recording = WithAmplitude(np.full((4, 1, 1), 2.4 * PERIOD), sensor)
    assert average_samples(recording, start=0, stop=4).range_mm[0, 0] == pytest.approx(2.4 * PERIOD, rel=1e-6)


def test_two_surfaces_average_to_a_point_between(make_recording: Callable[..., object]) -> None:
    recording = make_recording((40, 1, 2))
    recording.range_mm[::2], recording.range_mm[1::2] = 2400, 3600  # type: ignore[attr-defined]
    image = average_samples(recording, start=0, stop=40)  # type: ignore[arg-type]
    assert ((image.range_mm > 2500) & (image.range_mm < 3500)).all()


def test_without_amplitude_or_frequency_the_plain_mean(make_recording: Callable[..., object]) -> None:
    recording = make_recording((30, 3, 4))
    samples = recording.range_mm.astype(np.float64)  # type: ignore[attr-defined]
    expected = np.full((3, 4), np.nan)
    known = np.isfinite(samples).any(axis=0)
    expected[known] = np.nanmean(samples[:, known], axis=0)
    bare = replace(recording, sensor=Sensor(name="no frequency"))  # type: ignore[type-var]
    dim = replace(recording, has_amplitude=False)  # type: ignore[type-var]
    plain = ArrayRecording(samples, Sensor(name="plain", modulation_frequency_hz=20.0e6))
    for case in (bare, dim, plain):
        image = average_samples(case, start=0, stop=30)  # type: ignore[arg-type]
        assert image.averaging is Averaging.PLAIN
        np.testing.assert_allclose(image.range_mm, expected, rtol=1e-6)


def test_no_light_at_all_falls_back_to_the_plain_mean(make_recording: Callable[..., object]) -> None:
    recording = make_recording((30, 3, 4))
    recording.amplitude[...] = 0  # type: ignore[attr-defined]
    image = average_samples(recording, start=0, stop=30)  # type: ignore[arg-type]
    expected = np.nanmean(recording.range_mm[:, 1:], axis=0)  # type: ignore[attr-defined]
    np.testing.assert_allclose(image.range_mm[1:], expected, rtol=1e-6)
    assert np.isnan(image.range_mm[0, 0])


@pytest.mark.parametrize(("start", "stop"), [(0, 31), (5, 5), (-1, 4)])
def test_frames_that_are_not_there_are_refused(start: int, stop: int, make_recording: Callable[..., object]) -> None:
    with pytest.raises(UsageError, match="it has 30"):
        average_samples(make_recording((30, 2, 2)), start=start, stop=stop)  # type: ignore[arg-type]


def test_layers_average_by_their_shares(make_layers: Callable[..., Layers]) -> None:
    layers = make_layers((6, 5))
    image = average_layers(layers)
    assert image.averaging is Averaging.LAYERS
    for pixel in np.ndindex(6, 5):
        n = int(layers.n_modes[pixel])
        weight, range_mm = layers.weight[pixel][:n].astype(float), layers.range[pixel][:n].astype(float)
        expected = float((weight * range_mm).sum() / weight.sum()) if n else math.nan
        assert image.range_mm[pixel] == pytest.approx(expected, nan_ok=True)


def test_averaging_does_not_alter_its_input(
    make_layers: Callable[..., Layers], make_recording: Callable[..., object]
) -> None:
    layers, recording = make_layers(), make_recording()
    before = layers.range.copy(), recording.range_mm.copy(), recording.amplitude.copy()  # type: ignore[attr-defined]
    average_layers(layers)
    average_samples(recording, start=0, stop=50)  # type: ignore[arg-type]
    for old, new in zip(before, (layers.range, recording.range_mm, recording.amplitude), strict=True):  # type: ignore[attr-defined]
        np.testing.assert_array_equal(old, new)


def test_on_a_circle_the_mean_is_a_direction() -> None:
    samples = np.where(np.arange(40) % 2, 30.0, 5980.0)[:, np.newaxis, np.newaxis]
    recording = ArrayRecording(np.concatenate([samples, np.full((40, 1, 1), np.nan)], axis=2), Sensor(name="x"))
    image = average_samples(recording, start=0, stop=40, unambiguous_range_mm=6000.0)
    assert image.averaging is Averaging.CIRCULAR
    assert image.range_mm[0, 0] == pytest.approx(5.0, abs=1e-3)
    assert np.isnan(image.range_mm[0, 1])


def test_on_a_circle_layers_are_averaged_by_their_directions() -> None:
    layers = Layers.empty((1, 2), 2)
    layers.range[0, 0], layers.weight[0, 0] = (30.0, 5980.0), (0.5, 0.5)
    image = average_layers(layers, unambiguous_range_mm=6000.0)
    assert image.range_mm[0, 0] == pytest.approx(5.0, abs=1e-3)
    assert np.isnan(image.range_mm[0, 1])
