"""Maxima of F(r) = P(k r) - P(r) against a plain NumPy twin, and what they promise."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import find_peaks
from support.drawing import draw

from tofmix.estimation.beam import beam_of
from tofmix.estimation.peaks.counters import Cpdf
from tofmix.estimation.samples import sort_samples
from tofmix.sensor import Sensor


def _twin(samples: NDArray[np.float64], sensor: Sensor, bins: int, ratio: float) -> NDArray[np.float64]:
    """Places of the maxima, by np.interp and SciPy's search for peaks, which takes a plateau once."""
    assert sensor.range_min_mm is not None
    assert sensor.range_max_mm is not None
    assert sensor.noise is not None
    width = (sensor.range_max_mm - sensor.range_min_mm) / bins
    more = int(np.ceil(4 * sensor.noise.sigma(sensor.range_max_mm) / width))
    edges = sensor.range_min_mm + width * np.arange(bins + more + 1)
    below = np.array([(samples <= edge).sum() for edge in edges])
    rise = np.round(np.interp(ratio * edges, edges, below) - below, 9)
    _, plateaus = find_peaks(np.concatenate([[-1.0], rise, [-1.0]]), plateau_size=1)
    first, last = plateaus["left_edges"] - 1, plateaus["right_edges"] - 1
    middle = (edges[first] + edges[last]) / 2
    window = (ratio - 1) * middle
    held = rise[first] / np.minimum(window / width, 1)
    return np.asarray((middle + np.maximum(window, width) / 2)[held > 1 + 1e-6])


@pytest.mark.parametrize(("bins", "ratio", "n"), [(15, 1.1, 100), (15, 1.1, 15), (60, 1.1, 100), (30, 1.02, 60)])
def test_peaks_equal_the_twin(bins: int, ratio: float, n: int, rng: np.random.Generator, sensor: Sensor) -> None:
    block = draw(rng, sensor, ranges_mm=[1000, 2500, 4100], shares=[0.2, 0.3, 0.4], n=n, pixels=200, outliers=0.02)
    peaks = Cpdf(bins=bins, ratio=ratio).peaks(sort_samples(block), beam_of(sensor))
    for pixel, column in enumerate(block.T):
        expected = _twin(column.astype(np.float64), sensor, bins, ratio)
        np.testing.assert_allclose(peaks.place[pixel, : peaks.found[pixel]], expected, atol=1e-6)


def test_places_have_no_shift_and_heights_are_shares(rng: np.random.Generator, sensor: Sensor) -> None:
    # The ranges lie anywhere in their bins, so that what is left on average is the shift.
    errors, shares = [], []
    for nearer in rng.uniform(1000, 1800, 300):
        block = draw(rng, sensor, ranges_mm=[nearer, 3500], shares=[0.3, 0.7], n=200, pixels=1)
        peaks = Cpdf().peaks(sort_samples(block), beam_of(sensor))
        assert peaks.found[0] == 2
        errors.append(peaks.place[0, 0] - nearer)
        shares.append(peaks.height[0, 0])
    bin_mm = 5700 / 15
    assert abs(np.mean(errors)) < 0.1 * bin_mm
    assert np.max(np.abs(errors)) < bin_mm
    assert np.mean(shares) == pytest.approx(0.3, abs=0.06)


def test_no_return_is_a_peak_at_the_ranges_end(rng: np.random.Generator, sensor: Sensor) -> None:
    block = draw(rng, sensor, ranges_mm=[1000], shares=[0.5], n=100, pixels=50)
    peaks = Cpdf().peaks(sort_samples(block), beam_of(sensor))
    assert np.all(peaks.found == 2)
    np.testing.assert_allclose(peaks.place[:, 1], 6000, atol=450)


@pytest.mark.parametrize("samples", [[1000.0], [1000.0, 3000.0, 5000.0], [1e6, 1e6, 1e6], [-1e6, -1e6, 1e6]])
def test_pixel_without_a_mode_has_a_guess(samples: list[float], sensor: Sensor) -> None:
    block = np.array(samples, dtype=np.float32)[:, np.newaxis]
    peaks = Cpdf().peaks(sort_samples(block), beam_of(sensor))
    assert peaks.found[0] == 0
    nearest = np.abs(block[:, 0] - peaks.place[0, 0]).min()
    assert nearest < 400
    assert peaks.height[0, 0] > 0


def test_empty_pixels_and_sensors_without_range_max_are_handled(sensor: Sensor) -> None:
    block = np.full((20, 2), np.nan, np.float32)
    block[:, 0] = 2000.0
    for camera in (sensor, replace(sensor, range_min_mm=None, range_max_mm=None)):
        assert Cpdf().peaks(sort_samples(block), beam_of(camera)).found.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("name", "value"), [("bins", 1), ("bins", 101), ("ratio", 1.0), ("ratio", 10.1), ("ratio", np.nan)]
)
def test_parameters_out_of_bounds_are_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Cpdf(**{name: value})  # type: ignore[arg-type]  # any number may come
