"""The kernel density's peaks over a block are those of its pixels, and its bounds."""

import numpy as np
import pytest
from support.drawing import draw

from tofmix.estimation.beam import beam_of
from tofmix.estimation.peaks.counters import Kde
from tofmix.estimation.peaks.modes import find_modes
from tofmix.estimation.samples import sort_samples
from tofmix.sensor import Sensor


def test_peaks_of_a_block_equal_those_of_each_pixel(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    block = draw(rng, sensor, ranges_mm=[1000, 2500], shares=[0.4, 0.6], n=80, pixels=40)
    block[:, 3] = np.nan
    peaks = Kde(gamma=0.05).peaks(sort_samples(block), beam_of(sensor))
    assert peaks.found[3] == 0
    for pixel in (0, 1, 2, 17):
        expected = find_modes(block[:, pixel], sensor.noise, gamma=0.05)
        np.testing.assert_array_equal(peaks.place[pixel, : peaks.found[pixel]], expected)


@pytest.mark.parametrize(
    ("name", "value"), [("gamma", -0.1), ("gamma", 1.0), ("gamma", np.nan), ("epsilon", 0.0), ("epsilon", np.inf)]
)
def test_parameters_out_of_bounds_are_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Kde(**{name: value})
