"""`tofmix estimate --noise auto` on recordings with amplitudes: what was chosen is told, stored, and enough to redo."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from support.commandline import Tofmix
from support.sizes import sized

from tofmix.errors import ExitCode


def write_reflective(path: Path, exponent: float, curve: dict[str, NDArray[np.float64]] | None = None) -> Path:
    """A wall whose reflectivity falls from left to right; sigma is 10 mm (amplitude / 200)^-exponent."""
    rng = np.random.default_rng(7)
    light = np.geomspace(60.0, 600.0, 40) * np.ones((60, sized(20, 12), 40))
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
    outcome = tofmix("estimate", path, "--noise", "auto")
    assert outcome.code == 0, outcome.err
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
    outcome = tofmix("estimate", again)
    assert outcome.code == 0, outcome.err
    with h5py.File(tmp_path / "a.layers.h5") as one, h5py.File(tmp_path / "b.layers.h5") as other:
        for name in ("n_modes", "range", "sigma", "status"):
            np.testing.assert_array_equal(one[name][...], other[name][...])
    assert tofmix("report", tmp_path / "b.layers.h5", "--html", tmp_path / "b.html").code == 0


@pytest.mark.slow
def test_amplitude_without_effect_is_noted_and_changes_no_layer(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_reflective(tmp_path / "a.h5", 0.0)
    outcome = tofmix("estimate", path, "--noise", "auto")
    assert outcome.code == 0, outcome.err
    assert "sigma is measured by range only; amplitude adds no information" in outcome.err
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert sorted(root["sensor"]) == ["noise_range", "noise_sigma"]
    with h5py.File(path, "a") as root:
        del root["amplitude"]
    assert tofmix("estimate", path, "-o", tmp_path / "b.layers.h5", "--noise", "auto").code == 0
    with h5py.File(tmp_path / "a.layers.h5") as one, h5py.File(tmp_path / "b.layers.h5") as other:
        for name in ("n_modes", "range", "sigma", "sensor/noise_sigma"):
            np.testing.assert_array_equal(one[name][...], other[name][...])


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_workers_or_chunks(tofmix: Tofmix, tmp_path: Path) -> None:
    path = write_reflective(tmp_path / "a.h5", 0.85)
    auto = ["--noise", "auto", "--window", 30]
    for name, extra in (("x", ["--workers", 1]), ("y", ["--workers", 3, "--memory", "250MB"])):
        assert tofmix("estimate", path, "-o", tmp_path / name, *auto, *extra).code == 0
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes()


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
    outcome = tofmix("estimate", path)
    assert outcome.code == ExitCode.BAD_INPUT
    assert reason in outcome.err
    assert outcome.err.count("\n") == 1
