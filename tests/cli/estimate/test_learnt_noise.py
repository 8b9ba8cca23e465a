"""`tofmix estimate` with learnt noise: the same bytes in however many pieces, and what a file keeps of it."""

import functools
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.commandline import Tofmix
from support.files import write_recording
from support.learnt_pixels import KNOWN, surfaces

from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.learnt.bootstrap import calibrate
from tofmix.io.layers.layers_file import open_layers

FRAMES, ROWS, COLS = 60, 6, 8


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Skewed noise on background, of whole mm, in two windows; four cells; thresholds of few draws."""
    monkeypatch.setattr("tofmix.grid.CELL_PIXELS", 24)
    fewer = functools.partial(calibrate, draws=100)
    monkeypatch.setattr("tofmix.estimation.learnt.recordings.known_thresholds", fewer)
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
def test_bytes_do_not_depend_on_workers_memory_shards_or_resumption(
    tofmix: Tofmix, recording: Path, tmp_path: Path
) -> None:
    one = tmp_path / "one.h5"
    outcome = tofmix("estimate", recording, *QUICK, "-o", one, "--workers", 1)
    assert outcome.code == 0, outcome.err
    assert "% by pixel" in outcome.err
    expected = one.read_bytes()
    two = tmp_path / "two.h5"
    assert tofmix("estimate", recording, *QUICK, "-o", two, "--workers", 2, "--memory", "250MB").code == 0
    assert two.read_bytes() == expected
    for number in (1, 2):
        assert tofmix("estimate", recording, *QUICK, "--shard", f"{number}/2").code == 0
    parts = sorted(tmp_path.glob("*.part"))
    assert len(parts) == 2
    assert tofmix("merge", *parts, "-o", tmp_path / "merged.h5").code == 0
    assert (tmp_path / "merged.h5").read_bytes() == expected


@pytest.mark.slow
def test_resumed_run_has_the_same_bytes(
    tofmix: Tofmix, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import os

    assert tofmix("estimate", recording, *QUICK, "-o", tmp_path / "one.h5").code == 0
    real, left = os.pwrite, 3

    def limited(descriptor: int, data: bytes, offset: int) -> int:
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(28, "No space left on device")
        return real(descriptor, data, offset)

    with monkeypatch.context() as patch:
        patch.setattr("os.pwrite", limited)
        assert "--resume continues from the finished blocks" in tofmix("estimate", recording, *QUICK).err
    resumed = tofmix("estimate", recording, *QUICK, "--resume")
    assert resumed.code == 0, resumed.err
    assert "blocks from the interrupted run" in resumed.err
    assert (tmp_path / "a.layers.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()


@pytest.mark.slow
def test_layers_follow_from_the_sensor_that_their_file_carries(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    assert tofmix("estimate", recording, *WINDOW).code == 0
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
        assert tofmix("verify", tmp_path / "a.layers.h5").code == 0


@pytest.mark.slow
def test_noise_widths_own_is_stored_in_the_file(tofmix: Tofmix, recording: Path, tmp_path: Path) -> None:
    assert tofmix("estimate", recording, *WINDOW, "--noise-widths", "own", "--noise-shape", "gaussian").code == 0
    with h5py.File(tmp_path / "a.layers.h5") as root:
        assert root["noise_width"].shape == root["n_modes"].shape
        assert root["noise_width"].attrs["units"] == "1"
        assert root["sensor"].attrs["noise_width_spread"] > 0
        assert "noise_shape_z" not in root["sensor"]
        width = root["noise_width"][...]
        assert np.isfinite(width).all()
        assert ((width >= np.exp(-1.5) - 1e-6) & (width <= np.exp(1.5) + 1e-6)).all()
