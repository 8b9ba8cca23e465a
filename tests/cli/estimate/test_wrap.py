"""`tofmix estimate --wrap` and `--unambiguous-range`: from a folded recording to layers and their report."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import write_recording

from tofmix.circle import fold
from tofmix.errors import ExitCode
from tofmix.optics.geometry import unambiguous_range_mm

LENGTH = unambiguous_range_mm(20e6)
SENSOR = {"range_min_mm": 300.0, "range_max_mm": 6500.0, "modulation_frequency_hz": 20e6}


def _folded(path: Path, dtype: str = "f4", **attributes: float) -> Path:
    """Left half a wall at the fold, right half a board."""
    rng = np.random.default_rng(3)
    range_mm = np.where(np.arange(12) < 6, LENGTH + 5.0, 2000.0) + rng.normal(0, 60, (60, 8, 12))
    noise = {"noise_range": [500.0, 8000.0], "noise_sigma": [60.0, 60.0]}
    return write_recording(
        path, fold(np.rint(range_mm), LENGTH).astype(dtype), attributes=SENSOR | attributes, noise=noise, fill=65535
    )


def _read(path: Path) -> dict[str, Any]:
    with h5py.File(path) as root:
        return {name: item[...] for name, item in root.items() if isinstance(item, h5py.Dataset)} | dict(root.attrs)


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "option"), [("f4", ["--wrap"]), ("u2", ["--unambiguous-range", LENGTH])])
def test_a_wall_at_the_fold_is_one_surface(tofmix: Tofmix, tmp_path: Path, dtype: str, option: list[object]) -> None:
    recording, layers = _folded(tmp_path / "a.h5", dtype), tmp_path / "a.layers.h5"
    outcome = tofmix("estimate", recording, *option, "--mixing", "events")
    said = [line for line in outcome.err.splitlines() if "compiling the kernels" not in line]
    assert (outcome.code, said) == (0, [])
    found = _read(layers)
    assert (found["n_modes"] == 1).all()
    wall = fold(found["range"][0, :, :6, 0] + LENGTH / 2, LENGTH) - LENGTH / 2
    np.testing.assert_allclose(wall, 5, atol=35)
    assert json.loads(found["options"])["unambiguous_range_mm"] == pytest.approx(LENGTH)
    assert (found["n_samples"] == 60).all()  # with another _FillValue, an integer 0 is a range
    assert tofmix("estimate", recording, "--noise", "file", "-o", tmp_path / "line.h5").code == 0
    line = _read(tmp_path / "line.h5")
    assert (line["n_modes"][0, :, :6] == 1).mean() < 0.9 or not (line["range"][0, :, :6, 0] > 6000).all()


@pytest.mark.slow
def test_bytes_do_not_depend_on_workers(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _folded(tmp_path / "a.h5")
    for name, workers in (("x", 1), ("y", 3)):
        assert tofmix("estimate", recording, "--wrap", "-o", tmp_path / name, "--workers", workers).code == 0
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes()


@pytest.mark.slow
def test_noise_and_outliers_are_measured_on_the_circle(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = _folded(tmp_path / "a.h5")
    automatic = "--noise", "auto", "--outliers", "auto"
    outcome = tofmix("estimate", recording, "--wrap", *automatic, "--mixing", "events")
    assert outcome.code == 0, outcome.err
    (line,) = outcome.err.splitlines()  # no warning that curve and recording disagree
    assert "noise: sigma 5" in line or "noise: sigma 6" in line
    found = tmp_path / "a.layers.h5"
    assert (_read(found)["n_modes"] == 1).all()
    with h5py.File(found) as root:
        sensor = root["sensor"]
        at = np.interp([2000.0, LENGTH], sensor["noise_range"][...], sensor["noise_sigma"][...])
        np.testing.assert_allclose(at, 60, rtol=0.06)
        assert sensor.attrs["outlier_probability"] < 0.001


def test_a_recording_without_frequency_is_refused(tofmix: Tofmix, tmp_path: Path) -> None:
    recording = write_recording(tmp_path / "a.h5", np.full((10, 2, 2), 1000.0))
    outcome = tofmix("estimate", recording, "--wrap")
    assert outcome.code == ExitCode.BAD_INPUT
    assert "no modulation_frequency_hz" in outcome.err
    assert outcome.err.count("\n") == 1
    assert not (tmp_path / "a.layers.h5").exists()


@pytest.mark.parametrize("extra", [["--wrap", "--unambiguous-range", 7000], ["--unambiguous-range", "inf"]])
def test_contradictory_range_options_are_usage_errors(tofmix: Tofmix, tmp_path: Path, extra: list[object]) -> None:
    assert tofmix("estimate", _folded(tmp_path / "a.h5"), *extra).code == ExitCode.USAGE


@pytest.mark.slow
def test_a_circle_too_short_for_the_camera_is_refused(tofmix: Tofmix, tmp_path: Path) -> None:
    outcome = tofmix("estimate", _folded(tmp_path / "a.h5"), "--unambiguous-range", 500)
    assert outcome.code == ExitCode.BAD_INPUT
    assert "shorter than 10 sigma" in outcome.err


def test_range_max_at_the_fold_leaves_out_c0_with_a_note(tofmix: Tofmix, tmp_path: Path) -> None:
    outcome = tofmix("estimate", _folded(tmp_path / "a.h5", range_max_mm=7490.0), "--wrap", "--mixing", "events")
    assert outcome.code == 0
    assert "c_0 is left out" in outcome.err
    assert outcome.err.count("\n") == 1
    found = _read(tmp_path / "a.layers.h5")
    assert (found["weight_no_return"] == 0).all()
    assert (found["n_modes"] == 1).all()


@pytest.mark.slow
def test_report_compares_sigma_with_the_curve_on_the_circle(tofmix: Tofmix, tmp_path: Path) -> None:
    recording, layers = _folded(tmp_path / "a.h5"), tmp_path / "a.layers.h5"
    assert tofmix("estimate", recording, "--wrap").code == 0
    page = tmp_path / "a.html"
    outcome = tofmix("report", layers, "--recording", recording, "--html", page, "--json")
    assert outcome.code == 0, outcome.err
    summary = json.loads(outcome.out)
    assert summary["options"]["unambiguous_range_mm"] == pytest.approx(LENGTH)
    assert summary["sigma_over_curve"]["q50"] == pytest.approx(1, abs=0.1)
    assert summary["pixels_with_close_layers"] == 0
    assert [one["code"] for one in summary["warnings"]] == ["flying_pixels_counted"]
    assert "mean direction of the samples on the circle" in page.read_text()


@pytest.mark.slow
@pytest.mark.compiled("25,344 pixels")
def test_wrap_keeps_the_ranges_of_boards_away_from_the_fold(tofmix: Tofmix, tmp_path: Path) -> None:
    """At 1.2 ms its sigma at the fold is 430 mm: the boards are found as on a line."""
    recording = tmp_path / "a.h5"
    assert tofmix("simulate", "three-boards", "-o", recording, "--frames", 60).code == 0
    for name, options in (("line.h5", []), ("circle.h5", ["--wrap"])):
        outcome = tofmix("estimate", recording, "-o", tmp_path / name, *options)
        assert outcome.code == 0, outcome.err
    line, circle = _read(tmp_path / "line.h5"), _read(tmp_path / "circle.h5")
    assert "c_0 is left out" in outcome.err  # range_max is at the fold
    boards = (line["n_modes"] == 1) & (line["range"][..., 0] < 4500) & (line["weight"][..., 0] > 0.99)
    assert boards.sum() > 1000
    np.testing.assert_allclose(circle["range"][boards, 0], line["range"][boards, 0], atol=0.01)
