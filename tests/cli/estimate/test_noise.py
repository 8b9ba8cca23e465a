"""`tofmix estimate --noise auto` and `--outliers`: the curve and p(c_r) from the recording itself."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import NOISE, boards, write_recording

from tofmix.errors import ExitCode

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
    outcome = tofmix("estimate", path, *option, "--mixing", "events")
    assert outcome.code == 0, outcome.err
    assert re.search(
        r"a\.h5: noise: sigma 1[45][\d.]* (to 1[45][\d.]* )?mm, Gaussian, widths alike; learnt from 480 p", outcome.err
    )
    assert outcome.err.count("\n") == 1
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert json.loads(root.attrs["options"])["noise"] == "auto"
        np.testing.assert_allclose(root["sensor/noise_sigma"][...], 15.0, rtol=0.08)
        np.testing.assert_allclose(root["range"][0, :, 0, 0], 1200, atol=15)


def test_noise_file_refuses_a_recording_without_a_curve(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    path = write_recording(tmp_path / "a.h5", samples, noise=None)
    refused = tofmix("estimate", path, "--noise", "file")
    assert refused.code == ExitCode.BAD_INPUT
    assert "no noise curve; measure it with --noise auto" in refused.err


def test_unmeasurable_noise_is_refused_with_the_remedy(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    path = write_recording(tmp_path / "a.h5", samples[:2], noise=None)
    refused = tofmix("estimate", path)
    assert refused.code == ExitCode.BAD_INPUT
    assert "choose a curve with --noise PROFILE" in refused.err
    assert not (tmp_path / "a.layers.h5").exists()


@pytest.mark.slow
def test_wrong_curve_is_reported_in_one_line(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    wrong = write_recording(tmp_path / "wrong.h5", samples, noise=WRONG)
    outcome = tofmix("estimate", wrong, "--noise", "auto")
    assert outcome.code == 0
    assert re.search(r"times the measured one at (29|30)\d\d mm", outcome.err)
    right = write_recording(tmp_path / "right.h5", samples, noise=TRUE)
    assert "times the measured one" not in tofmix("estimate", right, "--noise", "auto").err


@pytest.mark.slow
def test_contradicted_curve_is_replaced_unless_noise_is_file(
    tofmix: Tofmix, tmp_path: Path, samples: np.ndarray
) -> None:
    wrong = write_recording(tmp_path / "wrong.h5", samples, noise=WRONG)
    outcome = tofmix("estimate", wrong)
    assert outcome.code == 0
    assert "the samples contradict the file's curve; learnt instead: sigma 1" in outcome.err
    with h5py.File(tmp_path / "wrong.layers.h5") as root:
        np.testing.assert_allclose(root["sensor/noise_sigma"][...], 15.0, rtol=0.08)
    assert tofmix("estimate", wrong, "--noise", "file", "--overwrite").code == 0
    with h5py.File(tmp_path / "wrong.layers.h5") as root:
        np.testing.assert_array_equal(root["sensor/noise_sigma"][...], WRONG["noise_sigma"])


def test_consistent_curve_is_kept_without_a_note(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    right = write_recording(tmp_path / "right.h5", samples, noise=TRUE)
    assert tofmix("estimate", right, "--mixing", "events").err == ""
    assert tofmix("estimate", right, "--noise", "file", "-o", tmp_path / "file.h5").code == 0
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
    assert tofmix("estimate", path, "--outliers", choice).code == 0
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert root["sensor"].attrs["outlier_probability"] == stored
        assert json.loads(root.attrs["options"])["outliers"] == (stored if choice != "file" else "file")


def test_outliers_auto_counts_the_outlier_share(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    dirty = samples.copy()
    wild = rng.random(dirty.shape) < 0.02
    dirty[wild] = rng.integers(300, 7500, wild.sum())
    path = write_recording(tmp_path / "a.h5", dirty)
    assert tofmix("estimate", path, "--outliers", "auto").code == 0
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert root["sensor"].attrs["outlier_probability"] == pytest.approx(0.02, rel=0.25)
        assert json.loads(root.attrs["options"])["outliers"] == "auto"
        np.testing.assert_array_equal(root["sensor/noise_sigma"][...], NOISE["noise_sigma"])


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_workers_or_chunks(tofmix: Tofmix, tmp_path: Path, samples: np.ndarray) -> None:
    path = write_recording(tmp_path / "a.h5", samples, noise=None)
    auto = ["--noise", "auto", "--outliers", "auto"]
    for name, extra in (("x", ["--workers", 1]), ("y", ["--workers", 3, "--memory", "250MB"])):
        assert tofmix("estimate", path, "-o", tmp_path / name, *auto, *extra).code == 0
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes()


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
    outcome = tofmix("estimate", path, *extra)
    assert outcome.code == code
    assert reason in outcome.err
    assert outcome.err.count("\n") == 1
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
    assert done.code == ExitCode.USAGE
    assert f"{' '.join(option)} needs learnt noise; {' '.join(without)} uses a Gaussian curve" in done.err
    assert not (tmp_path / "a.layers.h5").exists()
