"""A recording in memory: its own copy, invalid samples as NaN, and refusals."""

import numpy as np
import pytest

from tofmix.recording import ArrayRecording, FrameSpan
from tofmix.sensor import Sensor


def test_array_recording_copies_samples_and_stores_invalid_as_nan(sensor: Sensor) -> None:
    samples = np.array([[[1.0, np.inf]], [[-np.inf, np.nan]]])
    recording = ArrayRecording(samples, sensor)
    samples[:] = 5
    assert recording.shape == (2, 1, 2)
    assert recording.sensor is sensor
    np.testing.assert_array_equal(recording.read_range(slice(None), slice(None)), [[[1, np.nan]], [[np.nan, np.nan]]])
    np.testing.assert_array_equal(recording.read_range(slice(1, 2), slice(0, 1)), [[[np.nan, np.nan]]])


@pytest.mark.parametrize("shape", [(3, 4), (0, 2, 2), (1, 2, 3, 4)])
def test_other_shapes_are_refused(shape: tuple[int, ...], sensor: Sensor) -> None:
    with pytest.raises(ValueError, match="range: expected"):
        ArrayRecording(np.zeros(shape), sensor)


def test_a_span_of_frames_is_a_recording_of_its_own() -> None:
    samples = np.arange(10 * 2 * 3, dtype=np.float32).reshape(10, 2, 3)
    span = FrameSpan(ArrayRecording(samples, Sensor(name="x")), 4, 9)
    assert span.shape == (5, 2, 3)
    assert span.row_step == 1
    assert span.sensor.name == "x"
    for frames in (slice(None), slice(1, 3), slice(0, 99)):
        np.testing.assert_array_equal(span.read_range(frames, slice(1, 2)), samples[4:9][frames, 1:2])
    for start, stop in ((-1, 3), (3, 3), (0, 11)):
        with pytest.raises(ValueError, match="the recording has 10"):
            FrameSpan(ArrayRecording(samples, Sensor(name="x")), start, stop)
