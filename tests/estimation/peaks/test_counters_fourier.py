"""Maxima of the truncated series against a dense NumPy twin, and what they promise."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.drawing import draw

from tofmix.estimation.beam import beam_of
from tofmix.estimation.peaks.counters import Fourier
from tofmix.estimation.samples import sort_samples
from tofmix.sensor import Sensor


def _twin(samples: NDArray[np.float64], sensor: Sensor, order: int, level: float) -> NDArray[np.float64]:
    """Equations (2) and (3) as they stand, on a grid 25 times as dense; places inside the working range."""
    assert sensor.range_min_mm is not None
    assert sensor.range_max_mm is not None
    low, period = sensor.range_min_mm, sensor.range_max_mm - sensor.range_min_mm
    angle = -np.pi + 2 * np.pi * (samples - low) / period
    at = np.linspace(-np.pi, np.pi, 400 * order, endpoint=False)
    p = np.full(len(at), 1 / (2 * np.pi))
    for j in range(1, order + 1):
        p += np.cos(j * angle).mean() / np.pi * np.cos(j * at) + np.sin(j * angle).mean() / np.pi * np.sin(j * at)
    assert p.sum() * (at[1] - at[0]) == pytest.approx(1)
    tops = (p > np.roll(p, 1)) & (p >= np.roll(p, -1)) & (p > level * (2 * order + 1) / (2 * np.pi))
    return np.asarray(low + period * (at[tops] + np.pi) / (2 * np.pi))


@pytest.mark.parametrize(
    ("order", "level"),
    [(8, 0.05), (16, 0.05), (16, 0.0), pytest.param(40, 0.02, marks=pytest.mark.slow), (1, 0.0)],
)
def test_peaks_equal_the_twin(order: int, level: float, rng: np.random.Generator, sensor: Sensor) -> None:
    block = draw(rng, sensor, ranges_mm=[1000, 2500, 4100], shares=[0.2, 0.3, 0.5], n=60, pixels=100)
    peaks = Fourier(order=order, level=level).peaks(sort_samples(block), beam_of(sensor))
    differing = 0
    for pixel, column in enumerate(block.T):
        expected = _twin(column.astype(np.float64), sensor, order, level)
        # A side lobe at one end may be put beyond the other: the series cannot tell the two.
        found = np.sort(300 + np.mod(peaks.place[pixel, : peaks.found[pixel]] - 300, 5700))
        if len(found) == len(expected):
            np.testing.assert_allclose(found, expected, atol=0.03 * 5700 / order)
        else:
            differing += 1
    assert differing <= 4  # a height within the grid's rounding of the level


def test_heights_are_shares_of_narrow_surfaces(sensor: Sensor) -> None:
    block = np.repeat(np.array([1000.0, 4000.0], np.float32), [30, 70])[:, np.newaxis]
    peaks = Fourier(order=16, level=0.2).peaks(sort_samples(block), beam_of(sensor))
    assert peaks.found[0] == 2
    np.testing.assert_allclose(peaks.place[0, :2], [1000, 4000], atol=40)
    np.testing.assert_allclose(peaks.height[0, :2], [0.3, 0.7], atol=0.03)


def test_samples_just_past_the_end_do_not_come_back_at_the_start(rng: np.random.Generator, sensor: Sensor) -> None:
    block = draw(rng, sensor, ranges_mm=[2000], shares=[0.5], n=400, pixels=20)
    block[block > 5000] += np.float32(200)  # no return at 6200 mm, 500 mm to the series
    peaks = Fourier(order=8, level=0.2).peaks(sort_samples(block), beam_of(sensor))
    assert np.all(peaks.found == 2)
    np.testing.assert_allclose(peaks.place[:, 0], 2000, atol=60)
    np.testing.assert_allclose(peaks.place[:, 1], 6200, atol=60)


@pytest.mark.parametrize("samples", [[1000.0], [1e6, 1e6], [-1e6]])
def test_pixel_without_a_maximum_above_the_level_has_a_guess(samples: list[float], sensor: Sensor) -> None:
    block = np.array([*samples, 1e6], dtype=np.float32)[:, np.newaxis]
    peaks = Fourier(level=0.9).peaks(sort_samples(block), beam_of(sensor))
    assert peaks.found[0] == 0
    assert np.abs(block[:, 0] - peaks.place[0, 0]).min() < 50
    assert peaks.height[0, 0] > 0


def test_empty_pixels_and_sensors_without_range_max_are_handled(sensor: Sensor) -> None:
    block = np.full((20, 2), np.nan, np.float32)
    block[:, 0] = 2000.0
    for camera in (sensor, replace(sensor, range_min_mm=None, range_max_mm=None)):
        assert Fourier(level=0.3).peaks(sort_samples(block), beam_of(camera)).found.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("name", "value"), [("order", 0), ("order", 65), ("level", -0.1), ("level", 1.0), ("level", np.nan)]
)
def test_parameters_out_of_bounds_are_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Fourier(**{name: value})  # type: ignore[arg-type]  # any number may come
