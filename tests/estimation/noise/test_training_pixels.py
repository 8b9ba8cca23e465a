"""Pixels that teach: some of them, evenly spread, and their medians."""

import numpy as np

from tofmix.estimation.noise.training_pixels import Pixels, medians


def test_some_pixels_are_spread_evenly_and_keep_their_amplitudes() -> None:
    samples = np.arange(30, dtype=np.float32).reshape(10, 3)
    pixels = Pixels(samples=samples, amplitude=2.0 * samples, rounding_mm=0.5)
    few = pixels.some(4)
    np.testing.assert_array_equal(few.samples, samples[[0, 3, 6, 9]])
    assert few.amplitude is not None
    np.testing.assert_array_equal(few.amplitude, 2.0 * few.samples)
    assert few.rounding_mm == 0.5
    assert pixels.some(10) is pixels


def test_medians_leave_out_pixels_without_samples() -> None:
    samples = np.array([[1.0, np.nan, 3.0], [np.nan] * 3, [5.0, np.nan, np.nan]], dtype=np.float32)
    np.testing.assert_array_equal(medians(samples), [2.0, 5.0])
