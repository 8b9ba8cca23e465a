"""A recording in memory: its own copy, invalid samples as NaN, and refusals."""

import numpy as np
import pytest

from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor


def test_it_is_its_own_copy_with_nan_for_invalid(sensor: Sensor) -> None:
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
