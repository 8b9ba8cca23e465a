"""Counters of peaks against plain NumPy twins, and their options."""

import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import click
import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import find_peaks
from support.drawing import draw
from support.files import boards, write_recording

from tofmix.cli.estimate import estimate
from tofmix.cli.main import run
from tofmix.errors import ExitCode
from tofmix.estimation.beam import beam_of
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.peaks.counters import COUNTERS, Cpdf, Fourier, Kde
from tofmix.estimation.peaks.modes import find_modes
from tofmix.estimation.samples import sort_samples
from tofmix.estimation.settings import EstimateOptions
from tofmix.options import COUNTERS as COUNTER_OPTIONS
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


def _twin_fourier(samples: NDArray[np.float64], sensor: Sensor, order: int, level: float) -> NDArray[np.float64]:
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
def test_peaks_equal_the_twin_fourier(order: int, level: float, rng: np.random.Generator, sensor: Sensor) -> None:
    block = draw(rng, sensor, ranges_mm=[1000, 2500, 4100], shares=[0.2, 0.3, 0.5], n=60, pixels=100)
    peaks = Fourier(order=order, level=level).peaks(sort_samples(block), beam_of(sensor))
    differing = 0
    for pixel, column in enumerate(block.T):
        expected = _twin_fourier(column.astype(np.float64), sensor, order, level)
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


def test_empty_pixels_and_sensors_without_range_max_are_handled_fourier(sensor: Sensor) -> None:
    block = np.full((20, 2), np.nan, np.float32)
    block[:, 0] = 2000.0
    for camera in (sensor, replace(sensor, range_min_mm=None, range_max_mm=None)):
        assert Fourier(level=0.3).peaks(sort_samples(block), beam_of(camera)).found.tolist() == [1, 0]


def test_peaks_of_a_block_equal_those_of_each_pixel(rng: np.random.Generator, sensor: Sensor) -> None:
    assert sensor.noise is not None
    block = draw(rng, sensor, ranges_mm=[1000, 2500], shares=[0.4, 0.6], n=80, pixels=40)
    block[:, 3] = np.nan
    peaks = Kde(gamma=0.05).peaks(sort_samples(block), beam_of(sensor))
    assert peaks.found[3] == 0
    for pixel in (0, 1, 2, 17):
        expected = find_modes(block[:, pixel], sensor.noise, gamma=0.05)
        np.testing.assert_array_equal(peaks.place[pixel, : peaks.found[pixel]], expected)


OPTIONS = {option.name: option for option in estimate.params if isinstance(option, click.Option)}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "a.h5", boards(40))


def _estimate(recording: Path, *arguments: str) -> int:
    with pytest.raises(SystemExit) as leave:
        run(["estimate", str(recording), "-o", str(recording.with_name("out")), "--overwrite", *arguments])
    return int(leave.value.code or 0)


def test_the_command_names_every_counter_and_its_parameters() -> None:
    parameters = {name: [field.name for field in dataclasses.fields(kind)] for name, kind in COUNTERS.items()}  # type: ignore[arg-type]  # a Protocol cannot say dataclass
    assert {name: list(names) for name, names in COUNTER_OPTIONS.items()} == parameters
    assert isinstance(OPTIONS["counter"].type, click.Choice)
    assert list(OPTIONS["counter"].type.choices) == list(COUNTERS)


@pytest.mark.parametrize("name", COUNTERS)
def test_defaults_and_bounds_are_the_dataclass_s(name: str) -> None:
    for key, value in COUNTERS[name]().as_dict().items():
        option = OPTIONS[key]
        assert option.default == value
        assert option.help is not None
        assert option.help.startswith(f"{name}: ")
        kind = option.type
        assert isinstance(kind, click.IntRange | click.FloatRange)
        for bound, is_open in ((kind.min, kind.min_open), (kind.max, kind.max_open)):
            if bound is not None and not is_open:
                COUNTERS[name](**{key: bound})
            elif bound is not None:
                with pytest.raises(ValueError, match=key):
                    COUNTERS[name](**{key: bound})


@pytest.mark.parametrize("name", COUNTERS)
def test_the_layers_file_names_the_counter_and_its_own_parameters_alone(name: str, recording: Path) -> None:
    assert _estimate(recording, "--counter", name) == 0
    with h5py.File(recording.with_name("out")) as root:
        options = json.loads(root.attrs["options"])
    assert options["counter"] == name
    every = {key for names in COUNTER_OPTIONS.values() for key in names}
    assert {key: options[key] for key in every & set(options)} == COUNTERS[name]().as_dict()


@pytest.mark.parametrize(
    ("counter", "option", "value"),
    [
        ("cpdf", "bins", "2"),
        pytest.param("fourier", "order", "2", marks=pytest.mark.slow),
        pytest.param("cpdf", "ratio", "5", marks=pytest.mark.slow),
        pytest.param("fourier", "level", "0.9", marks=pytest.mark.slow),
    ],
)
def test_every_counter_option_changes_the_layers(counter: str, option: str, value: str, recording: Path) -> None:
    peaks = []
    for extra in ([], [f"--{option}", value]):
        assert _estimate(recording, "--counter", counter, *extra) == 0
        with h5py.File(recording.with_name("out")) as root:
            peaks.append((root["n_peaks"][...], root["range"][...]))
    (one, one_range), (other, other_range) = peaks
    assert not (np.array_equal(one, other) and np.array_equal(one_range, other_range, equal_nan=True))


def test_options_of_another_counter_are_refused(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _estimate(recording, "--counter", "cpdf", "--gamma", "0.02") == ExitCode.USAGE
    assert capsys.readouterr().err == "tofmix: --gamma belongs to --counter kde, not to --counter cpdf\n"
    assert _estimate(recording, "--bins", "15") == ExitCode.USAGE
    monkeypatch.setenv("TOFMIX_ESTIMATE_ORDER", "8")
    assert _estimate(recording) == ExitCode.USAGE
    assert _estimate(recording, "--counter", "fourier") == 0
    assert _estimate(recording, "--counter", "guess") == ExitCode.USAGE


@pytest.mark.parametrize("name", COUNTERS)
def test_every_counter_finds_two_boards(name: str, rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[1000, 3500], shares=[0.4, 0.6], n=100, pixels=50)
    layers = layer_pixels(samples, sensor, EstimateOptions(counter=COUNTERS[name]()))
    right = layers.n_modes == 2
    assert right.mean() > 0.9
    np.testing.assert_allclose(layers.range[right][:, :2], np.tile([1000, 3500], (right.sum(), 1)), atol=60)


@pytest.mark.parametrize("name", COUNTERS)
def test_the_order_of_the_frames_does_not_matter(name: str, rng: np.random.Generator, sensor: Sensor) -> None:
    samples = draw(rng, sensor, ranges_mm=[1000, 2500], shares=[0.4, 0.6], n=60, pixels=20)
    options = EstimateOptions(counter=COUNTERS[name]())
    one, other = layer_pixels(samples, sensor, options), layer_pixels(samples[::-1], sensor, options)
    np.testing.assert_array_equal(one.range, other.range)
    np.testing.assert_array_equal(one.n_peaks, other.n_peaks)
