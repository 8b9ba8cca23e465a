"""`tofmix estimate --noise auto`, `learnt` and `--outliers`: what was chosen is told, stored, and enough to redo."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from support.commandline import Tofmix
from support.files import NOISE, boards, write_recording
from support.learnt_pixels import KNOWN, surfaces

from tofmix.errors import ExitCode
from tofmix.estimation.layering import layer_pixels
from tofmix.io.layers.layers_file import open_layers

pytestmark = pytest.mark.usefixtures("few_draws")

WRONG = {"noise_range": [500.0, 5000.0], "noise_sigma": [10.0, 80.0]}
TRUE = {"noise_range": [500.0, 5000.0], "noise_sigma": [15.0, 15.0]}


@pytest.fixture(scope="module")
def samples() -> np.ndarray[tuple[int, ...], np.dtype[np.uint16]]:
    return boards(60, rows=20, cols=24)


@pytest.mark.parametrize("option", [[], pytest.param(["--noise", "auto"], marks=pytest.mark.slow)])
def test_missing_curve_is_measured_with_a_note(
    tofmix: Tofmix, tmp_path: Path, samples: np.ndarray, option: list[str]
) -> None:
    path = write_recording(tmp_path / "a.h5", samples, noise=None)
    outcome = tofmix.done("estimate", path, *option, "--mixing", "events")
    assert re.search(
        r"a\.h5: noise: sigma 1[45][\d.]* (to 1[45][\d.]* )?mm, Gaussian, widths alike; learnt from 480 p", outcome.err
    )
    assert outcome.err.count("\n") == 1
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert json.loads(root.attrs["options"])["noise"] == "auto"
        np.testing.assert_allclose(root["sensor/noise_sigma"][...], 15.0, rtol=0.08)
        np.testing.assert_allclose(root["range"][0, :, 0, 0], 1200, atol=15)


def test_unmeasurable_noise_is_refused_with_the_remedy(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    path = write_recording(tmp_path / "a.h5", samples[:2], noise=None)
    tofmix("estimate", path).refused(ExitCode.BAD_INPUT, "choose a curve with --noise PROFILE")
    assert not (tmp_path / "a.layers.h5").exists()


@pytest.mark.slow
def test_contradicted_curve_is_replaced_unless_noise_is_file(
    tofmix: Tofmix, tmp_path: Path, samples: np.ndarray
) -> None:
    wrong = write_recording(tmp_path / "wrong.h5", samples, noise=WRONG)
    outcome = tofmix.done("estimate", wrong)
    assert "the samples contradict the file's curve; learnt instead: sigma 1" in outcome.err
    with h5py.File(tmp_path / "wrong.layers.h5") as root:
        np.testing.assert_allclose(root["sensor/noise_sigma"][...], 15.0, rtol=0.08)
    tofmix.done("estimate", wrong, "--noise", "file", "--overwrite")
    with h5py.File(tmp_path / "wrong.layers.h5") as root:
        np.testing.assert_array_equal(root["sensor/noise_sigma"][...], WRONG["noise_sigma"])


def test_consistent_curve_is_kept_without_a_note(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    right = write_recording(tmp_path / "right.h5", samples, noise=TRUE)
    assert tofmix("estimate", right, "--mixing", "events").err == ""
    tofmix.done("estimate", right, "--noise", "file", "-o", tmp_path / "file.h5")
    with h5py.File(tmp_path / "right.layers.h5") as usual, h5py.File(tmp_path / "file.h5") as file:
        for name in ("range", "n_modes", "probability", "weight"):
            np.testing.assert_array_equal(usual[name][...], file[name][...])


@pytest.mark.parametrize(("choice", "stored"), [("file", 1e-4), ("0.01", 0.01), ("0", 0.0)])
def test_outliers_option_sets_the_outlier_share(
    tofmix: Tofmix,
    tmp_path: Path,
    samples: np.ndarray,
    choice: str,
    stored: float,
) -> None:
    path = write_recording(tmp_path / "a.h5", samples)
    tofmix.done("estimate", path, "--outliers", choice)
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert root["sensor"].attrs["outlier_probability"] == stored
        assert json.loads(root.attrs["options"])["outliers"] == (stored if choice != "file" else "file")


def test_outliers_auto_counts_the_outlier_share(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    dirty = samples.copy()
    wild = rng.random(dirty.shape) < 0.02
    dirty[wild] = rng.integers(300, 7500, wild.sum())
    path = write_recording(tmp_path / "a.h5", dirty)
    tofmix.done("estimate", path, "--outliers", "auto")
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert root["sensor"].attrs["outlier_probability"] == pytest.approx(0.02, rel=0.25)
        assert json.loads(root.attrs["options"])["outliers"] == "auto"
        np.testing.assert_array_equal(root["sensor/noise_sigma"][...], NOISE["noise_sigma"])


@pytest.mark.slow
def test_bytes_do_not_depend_on_pieces_where_noise_is_measured(
    tofmix: Tofmix, tmp_path: Path, samples: np.ndarray
) -> None:
    path = write_recording(tmp_path / "a.h5", samples[:, :10, 6:18], noise=None)
    tofmix.same_in_pieces(path, "--noise", "auto", "--outliers", "auto")
    (tmp_path / "by amplitude").mkdir()
    path = write_reflective(tmp_path / "by amplitude" / "b.h5", 0.85)
    tofmix.same_in_pieces(path, "--noise", "auto", "--window", 30)


@pytest.mark.parametrize(
    ("extra", "code", "reason"),
    [
        (["--noise", "auto"], ExitCode.BAD_INPUT, "at least 100 and 5 are needed to tell one sigma"),
        (["--outliers", "auto"], ExitCode.BAD_INPUT, "4 frames; at least 10"),
        (["--outliers", "many"], ExitCode.USAGE, "'many' is not file, auto or a probability"),
        (["--outliers", "1"], ExitCode.USAGE, "probability in [0, 1)"),
        (["--outliers", "nan"], ExitCode.USAGE, "probability in [0, 1)"),
        (["--noise", "Auto"], ExitCode.USAGE, "choose file, auto or one of sr3000"),
    ],
)
def test_estimate_refuses_noise_options_with_their_exit_code(
    tofmix: Tofmix, tmp_path: Path, extra: list[str], code: int, reason: str
) -> None:
    path = write_recording(tmp_path / "a.h5", boards(4))
    tofmix("estimate", path, *extra).refused(code, reason)
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


@pytest.mark.parametrize(
    ("option", "without"),
    [
        (("--noise-shape", "gaussian"), ("--noise", "file")),
        (("--noise-widths", "own"), ("--noise", "sr3000")),
        (("--noise-widths", "common"), ("--sigma", "free")),
    ],
)
def test_noise_shape_and_widths_without_learnt_noise_are_refused(
    tofmix: Tofmix, tmp_path: Path, samples: np.ndarray, option: tuple[str, str], without: tuple[str, str]
) -> None:
    recording = write_recording(tmp_path / "a.h5", samples)
    done = tofmix("estimate", recording, *option, *without)
    done.refused(ExitCode.USAGE, f"{' '.join(option)} needs learnt noise; {' '.join(without)} uses a Gaussian curve")
    assert not (tmp_path / "a.layers.h5").exists()


def write_reflective(path: Path, exponent: float, curve: dict[str, NDArray[np.float64]] | None = None) -> Path:
    """A wall whose reflectivity falls from left to right; sigma is 10 mm (amplitude / 200)^-exponent."""
    rng = np.random.default_rng(7)
    light = np.geomspace(60.0, 600.0, 40) * np.ones((60, 12, 40))
    samples = 1500.0 + 10.0 * (light / 200.0) ** -exponent * rng.standard_normal(light.shape)
    with h5py.File(path, "w") as root:
        root["range"] = np.rint(samples).astype("u2")
        root["amplitude"] = np.rint(light * (1.0 + 0.03 * rng.standard_normal(light.shape))).astype("u2")
        root.create_group("sensor").attrs.update({"range_min_mm": 300.0, "range_max_mm": 7500.0})
        for name, values in (curve or {}).items():
            root["sensor"][name] = values
    return path


@pytest.mark.slow
def test_law_of_amplitude_is_printed_stored_and_read_again(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_reflective(tmp_path / "a.h5", 1.0)
    outcome = tofmix.done("estimate", path, "--noise", "auto")
    told = [line for line in outcome.err.splitlines() if "noise:" in line]
    assert len(told) == 1
    assert "sigma is measured by range and amplitude; it varies as amplitude^-" in told[0]
    with h5py.File(tmp_path / "a.layers.h5") as root:
        stored = {name: root["sensor"][name][...] for name in root["sensor"]}
        sigma, n_modes = root["sigma"][0, :, :, 0], root["n_modes"][0]
    # The rule of docs/reference/formats.md, from what is stored alone.
    light = np.geomspace(60.0, 600.0, 40)
    log_factor = np.interp(np.log(light), np.log(stored["noise_amplitude"]), np.log(stored["noise_amplitude_factor"]))
    reference = np.interp(1500.0, stored["noise_range"], stored["noise_reference_amplitude"])
    at_reference = np.interp(
        np.log(reference), np.log(stored["noise_amplitude"]), np.log(stored["noise_amplitude_factor"])
    )
    curve = np.interp(1500.0, stored["noise_range"], stored["noise_sigma"]) * np.exp(log_factor - at_reference)
    np.testing.assert_allclose(curve[1:-1], 10.0 * (light / 200.0)[1:-1] ** -1, rtol=0.06)
    np.testing.assert_allclose(np.median(sigma, axis=0), curve, rtol=0.1)
    assert (n_modes == 1).mean() > 0.99
    again = write_reflective(tmp_path / "b.h5", 1.0, stored)
    tofmix.done("estimate", again)
    with h5py.File(tmp_path / "a.layers.h5") as one, h5py.File(tmp_path / "b.layers.h5") as other:
        for name in ("n_modes", "range", "sigma", "status"):
            np.testing.assert_array_equal(one[name][...], other[name][...])
    tofmix.done("report", tmp_path / "b.layers.h5", "--html", tmp_path / "b.html")


@pytest.mark.slow
def test_amplitude_without_effect_is_noted_and_changes_no_layer(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_reflective(tmp_path / "a.h5", 0.0)
    outcome = tofmix.done("estimate", path, "--noise", "auto")
    assert "sigma is measured by range only; amplitude adds no information" in outcome.err
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert sorted(root["sensor"]) == ["noise_range", "noise_sigma"]
    with h5py.File(path, "a") as root:
        del root["amplitude"]
    tofmix.done("estimate", path, "-o", tmp_path / "b.layers.h5", "--noise", "auto")
    with h5py.File(tmp_path / "a.layers.h5") as one, h5py.File(tmp_path / "b.layers.h5") as other:
        for name in ("n_modes", "range", "sigma", "sensor/noise_sigma"):
            np.testing.assert_array_equal(one[name][...], other[name][...])


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        ({"noise_amplitude": [1.0, 2.0]}, "go together"),
        (
            {
                "noise_reference_amplitude": [1.0, 2.0],
                "noise_amplitude": [2.0, 1.0],
                "noise_amplitude_factor": [1.0, 1.0],
            },
            "do not ascend",
        ),
        (
            {"noise_reference_amplitude": [1.0], "noise_amplitude": [1.0, 2.0], "noise_amplitude_factor": [1.0, 1.0]},
            "2 ranges, but 1 reference amplitude",
        ),
        (
            {"noise_reference_amplitude": [1.0, 2.0], "noise_amplitude": [1.0, 2.0], "noise_amplitude_factor": [1.0]},
            "2 amplitudes, but 1 factor",
        ),
        (
            {
                "noise_reference_amplitude": [1.0, 2.0],
                "noise_amplitude": [1.0, 2.0],
                "noise_amplitude_factor": [0.0, 1.0],
            },
            "factor must be a list of finite numbers above 0",
        ),
    ],
)
def test_unfit_laws_are_refused(tofmix: Tofmix, tmp_path: Path, law: dict[str, list[float]], reason: str) -> None:
    curve = {"noise_range": [500.0, 5000.0], "noise_sigma": [10.0, 20.0]} | law
    path = write_reflective(tmp_path / "a.h5", 0.0, {name: np.array(values) for name, values in curve.items()})
    tofmix("estimate", path).refused(ExitCode.BAD_INPUT, reason)


FRAMES, ROWS, COLS = 60, 6, 8


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Skewed noise on background, of whole mm, in two windows; four cells."""
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", 24)
    rng = np.random.default_rng(11)
    share, size = rng.uniform(0.0, 0.5, ROWS * COLS), (2 * FRAMES, ROWS * COLS)
    samples = surfaces(rng, size, (1500.0,), errors=KNOWN["skewed"].draw, background=share)
    samples[:, ::5] = surfaces(rng, size, (1500.0, 3000.0), (0.5, 0.5), errors=KNOWN["skewed"].draw)[:, ::5]
    block = samples.reshape(2 * FRAMES, ROWS, COLS).astype(np.uint16)
    return write_recording(tmp_path / "a.h5", block, noise=None)


WINDOW = ("--window", FRAMES)
QUICK = (*WINDOW, "--noise-shape", "gaussian")
"""Background alone is learnt: most of the time goes into shapes."""


@pytest.mark.slow
def test_bytes_do_not_depend_on_pieces_where_noise_is_learnt(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    tofmix.same_in_pieces(recording, *QUICK)
    assert "% by pixel" in tofmix.done("info", tmp_path / "whole.h5").out


@pytest.mark.slow
def test_layers_follow_from_the_sensor_that_their_file_carries(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    tofmix.done("estimate", recording, *WINDOW)
    with h5py.File(recording) as root:
        samples = root["range"][...].astype(np.float32)
    with open_layers(tmp_path / "a.layers.h5") as layers:
        sensor = layers.provenance.sensor
        assert sensor.learnt is not None
        assert sensor.noise is not None
        assert sensor.noise.shape is not None
        for window in range(2):
            stored = layers.read_window(window)
            again = layer_pixels(samples[window * FRAMES : (window + 1) * FRAMES], sensor)
            for a, b in zip(again.arrays(), stored.arrays(), strict=True):
                assert a.astype(b.dtype).tobytes() == b.tobytes()
    with h5py.File(tmp_path / "a.layers.h5") as root:
        names = {"noise_drift", "noise_gain_samples", "noise_gain_background", "noise_gain_of_one_more"}
        assert names | {"noise_gain_of_first", "noise_shape_z", "noise_shape_density"} <= set(root["sensor"])
        prior = root["sensor/noise_background_prior"][...]
        # Shares are uniform from 0 to a half, and 0 in every fifth pixel.
        assert prior[0] / prior.sum() == pytest.approx(0.2, abs=0.08)
        assert root["sensor/noise_background"].shape == (ROWS, COLS)
        number = root["n_modes"][...].reshape(2, -1)
        assert (number[:, ::5] == 2).mean() > 0.9
        assert (np.delete(number, np.s_[::5], axis=1) == 1).mean() > 0.9
        tofmix.done("verify", tmp_path / "a.layers.h5")


@pytest.mark.slow
def test_noise_widths_own_is_stored_in_the_file(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    tofmix.done("estimate", recording, *WINDOW, "--noise-widths", "own", "--noise-shape", "gaussian")
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert root["noise_width"].shape == root["n_modes"].shape
        assert root["noise_width"].attrs["units"] == "1"
        assert root["sensor"].attrs["noise_width_spread"] > 0
        assert "noise_shape_z" not in root["sensor"]
        width = root["noise_width"][...]
        assert np.isfinite(width).all()
        assert ((width >= np.exp(-1.5) - 1e-6) & (width <= np.exp(1.5) + 1e-6)).all()
