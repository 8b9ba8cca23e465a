"""The registry, and the options of `tofmix estimate` that stand for it."""

import dataclasses
import json
from pathlib import Path

import click
import h5py
import numpy as np
import pytest
from support.drawing import draw
from support.files import boards, write_recording

from tofmix.cli.estimate import estimate
from tofmix.cli.main import run
from tofmix.errors import ExitCode
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.peaks.counters import COUNTERS
from tofmix.estimation.settings import EstimateOptions
from tofmix.options import COUNTERS as COUNTER_OPTIONS
from tofmix.sensor import Sensor

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
