import numpy as np
import pytest

from tofmix.mapping.beams import count_samples
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor


def test_valid_samples_are_counted_in_the_requested_frames() -> None:
    rng = np.random.default_rng(4)
    samples = np.where(rng.random((9, 3, 2)) < 0.3, np.nan, 1000.0)
    recording = ArrayRecording(samples, Sensor(name="x"))
    for block in (7, 1 << 21):
        counted = count_samples(recording, start=2, stop=8, block_samples=block)
        np.testing.assert_array_equal(counted, np.isfinite(samples[2:8]).sum(axis=0))
    with pytest.raises(ValueError, match="the recording has 9"):
        count_samples(recording, start=2, stop=10)
