import numpy as np
import pytest

from tofmix.mapping.averages import count_samples
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor


def test_valid_samples_are_counted_in_the_frames_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tofmix.mapping.averages._BLOCK_SAMPLES", 7)
    rng = np.random.default_rng(4)
    samples = np.where(rng.random((9, 3, 2)) < 0.3, np.nan, 1000.0)
    recording = ArrayRecording(samples, Sensor(name="x"))
    np.testing.assert_array_equal(count_samples(recording, start=2, stop=8), np.isfinite(samples[2:8]).sum(axis=0))
    with pytest.raises(ValueError, match="the recording has 9"):
        count_samples(recording, start=2, stop=10)
