"""Several targets a zone, from import to report: all valid targets of a pixel are its samples."""

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray
from numpy.typing import NDArray
from support.commandline import Tofmix

import tofmix as tm
from tofmix.errors import ExitCode

SHAPE = (90, 3, 6, 8)
"""Frames, targets, rows, columns."""

NEAR_MM, FAR_MM, SIGMA_MM = 800.0, 2000.0, 6.0


def samples() -> NDArray[np.uint16]:
    """A near wall in all zones, a far one as second target in the right half; one target of ten is lost."""
    rng = np.random.default_rng(5)
    values = np.zeros(SHAPE)
    values[:, 0] = rng.normal(NEAR_MM, SIGMA_MM, values[:, 0].shape)
    values[:, 1, :, 4:] = rng.normal(FAR_MM, SIGMA_MM, values[:, 1, :, 4:].shape)
    values[rng.random(SHAPE) < 0.1] = 0
    return np.round(values).astype(np.uint16)


_MADE: list[Path] = []
"""The folder that the first test made; the others have copies."""


@pytest.fixture
def made(tofmix: Tofmix, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recording t.h5 and its layers."""
    if not _MADE:
        _MADE.append(_make(tofmix, tmp_path_factory.mktemp("made")))
    return Path(shutil.copytree(_MADE[0], tmp_path / "targets"))


def _make(tofmix: Tofmix, folder: Path) -> Path:
    np.save(folder / "t.npy", samples())
    imported = tofmix(
        "import",
        folder / "t.npy",
        "-o",
        folder / "t.h5",
        "--axes",
        "frame,target,row,col",
        "--sensor",
        "vl53l5cx",
        "--frame-rate",
        15,
    )
    assert imported.code == 0, imported.err
    assert "90 frames of 6 x 8 pixels of 3 targets" in imported.out
    estimated = tofmix("estimate", folder / "t.h5")
    assert estimated.code == 0, estimated.err
    assert "Each pixel has up to 3 targets a frame" in estimated.err
    assert "A share is the share of its detections" in estimated.err
    return folder


@pytest.mark.slow
def test_the_recording_has_the_axis_of_the_contract(made: Path) -> None:
    with h5py.File(made / "t.h5") as root:
        np.testing.assert_array_equal(root["range"][...], samples())
        scales = [dim[0].name for dim in root["range"].dims]
        assert scales == ["/frame", "/target", "/row", "/col"]
    with xarray.open_dataset(made / "t.h5", engine="h5netcdf") as data:
        assert data["range"].dims == ("frame", "target", "row", "col")


def test_all_valid_targets_are_samples_of_their_pixel(made: Path) -> None:
    valid = samples() > 0
    with h5py.File(made / "t.layers.h5") as root:
        np.testing.assert_array_equal(root["n_samples"][0], valid.sum(axis=(0, 1)))
        assert (root["n_modes"][0] == np.where(np.arange(8) < 4, 1, 2)).all()
        assert (root["window_start"][0], root["window_stop"][0], root.attrs["targets"]) == (0, 90, 3)
        np.testing.assert_allclose(root["range"][0, :, :, 0], NEAR_MM, atol=4)
        np.testing.assert_allclose(root["range"][0, :, 4:, 1], FAR_MM, atol=4)
        np.testing.assert_allclose(root["sensor/noise_sigma"][...], SIGMA_MM, rtol=0.1)
        share = valid[:, 1].sum(axis=0) / valid.sum(axis=(0, 1))
        np.testing.assert_allclose(root["weight"][0, :, 4:, 1], share[:, 4:], atol=0.002)


def test_every_command_explains_shares_of_detections(tofmix: Tofmix, made: Path, tmp_path: Path) -> None:
    layers, recording = made / "t.layers.h5", made / "t.h5"
    shown = tofmix("inspect", layers, "--pixel", "2,5", "--recording", recording)
    assert "a share is the share of detections, up to 3 a frame" in shown.out
    assert json.loads(tofmix("inspect", layers, "--pixel", "2,5", "--json").out)["targets"] == 3
    assert "share of its detections" in " ".join(tofmix("report", layers).out.split())
    page = tmp_path / "t.html"
    assert tofmix("report", layers, "--recording", recording, "--html", page).code == 0
    assert "share of its detections" in page.read_text()
    for path in (layers, recording):
        described = json.loads(tofmix("info", path, "--json").out)
        assert "shares_of_detections" in {warning["code"] for warning in described["warnings"]}
    assert described["sizes"] == {
        "frames": 90,
        "rows": 6,
        "cols": 8,
        "targets": 3,
        "file_bytes": recording.stat().st_size,
    }


def test_both_files_pass_verify(tofmix: Tofmix, made: Path) -> None:
    done = tofmix("verify", made / "t.h5", made / "t.layers.h5")
    assert done.code == 0, done.out + done.err


@pytest.mark.slow
def test_windows_are_counted_in_frames(tofmix: Tofmix, made: Path, tmp_path: Path) -> None:
    out = tmp_path / "w.layers.h5"
    done = tofmix("estimate", made / "t.h5", "-o", out, "--window", 40, "--json")
    assert done.code == 0, done.err
    said = json.loads(done.out)
    assert (said["windows"], said["window_frames"], said["frames_left_out"], said["targets"]) == (2, 40, 10, 3)
    with h5py.File(out) as root:
        assert root["window_stop"][...].tolist() == [40, 80]
        np.testing.assert_array_equal(root["n_samples"][1], (samples()[40:80] > 0).sum(axis=(0, 1)))
    assert tofmix("verify", out).code == 0
    shown = json.loads(
        tofmix("inspect", out, "--pixel", "2,5", "--window", 1, "--recording", made / "t.h5", "--json").out
    )
    pixel = next(one for one in shown["pixels"] if one["col"] == 5)
    assert pixel["n_samples"] == (samples()[40:80, :, 2, 5] > 0).sum()
    assert tofmix("estimate", made / "t.h5", "-o", out, "--window", 91, "--overwrite").code == ExitCode.USAGE


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_memory_or_shards(tofmix: Tofmix, made: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.layers.h5"
    window = ("--window", 40)
    assert tofmix("estimate", made / "t.h5", "-o", out, *window).code == 0
    parts = [tmp_path / f"{k}.part" for k in (1, 2)]
    for k, part in enumerate(parts, 1):
        assert tofmix("estimate", made / "t.h5", "-o", part, *window, "--shard", f"{k}/2", "--workers", 2).code == 0
    merged = tofmix("merge", *parts, "-o", tmp_path / "m.layers.h5")
    assert merged.code == 0, merged.err
    assert "2 windows of 40 frames" in merged.out
    assert (tmp_path / "m.layers.h5").read_bytes() == out.read_bytes()
    resumed = tofmix("estimate", made / "t.h5", "-o", out, *window, "--resume")
    assert resumed.code == 0, resumed.err
    assert "blocks from the interrupted run" in resumed.err


@pytest.mark.parametrize("source", ["averaged", pytest.param("thin-beam", marks=pytest.mark.slow)])
def test_maps_for_comparison_average_all_detections(tofmix: Tofmix, made: Path, tmp_path: Path, source: str) -> None:
    done = tofmix(
        "map", made / "t.layers.h5", "-o", tmp_path / "m.yaml", "--from", source, "--recording", made / "t.h5"
    )
    assert done.code == 0, done.err


def test_reconcile_refuses_recordings_with_targets(tofmix: Tofmix, made: Path, tmp_path: Path) -> None:
    refused = tofmix("reconcile", "three-boards", made / "t.h5", "-o", tmp_path / "gap")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err.count("\n") == 1
    assert "3 targets a pixel and frame" in refused.err
    assert not (tmp_path / "gap").exists()


@pytest.mark.parametrize("axes", ["frame,row,col,target", "target,row,col,frame"])
@pytest.mark.parametrize("kind", ["npy", "npz", "h5"])
def test_target_arrays_of_any_order_of_axes_are_imported(tofmix: Tofmix, tmp_path: Path, kind: str, axes: str) -> None:
    order = [["frame", "target", "row", "col"].index(name) for name in axes.split(",")]
    values: Any = np.ascontiguousarray(np.transpose(samples(), order))
    path = tmp_path / f"a.{kind}"
    if kind == "npy":
        np.save(path, values)
    elif kind == "npz":
        np.savez(path, depth=values, other=np.zeros(3))
    else:
        with h5py.File(path, "w") as root:
            root["depth"] = values
    refused = tofmix("import", path, "-o", tmp_path / "r.h5")
    assert refused.code == ExitCode.BAD_INPUT
    assert tofmix("import", path, "-o", tmp_path / "r.h5", "--axes", axes).code == 0
    with h5py.File(tmp_path / "r.h5") as root:
        np.testing.assert_array_equal(root["range"][...], samples())


def test_csv_with_a_target_column_is_imported(tofmix: Tofmix, tmp_path: Path) -> None:
    values = samples()[:20, :2]
    lines = ["frame,row,col,target,range_mm,amplitude"]
    lines += [
        f"{f},{r},{c},{t + 1},{values[f, t, r, c]},{50 - t}"
        for f, t, r, c in np.ndindex(values.shape)
        if values[f, t, r, c]
    ]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    done = tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "r.h5", "--shape", "6x8")
    assert (done.code, done.err) == (0, "")
    with h5py.File(tmp_path / "r.h5") as root:
        np.testing.assert_array_equal(root["range"][...], np.where(values > 0, values, np.nan).astype("f4"))
        assert set(root["amplitude"][:, 1][values[:, 1] > 0].tolist()) == {49.0}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Each pixel has up to 3 targets")
def test_from_python_the_samples_have_the_axis_and_shares_are_the_same(made: Path, tmp_path: Path) -> None:
    recording = tm.open(made / "t.h5")
    assert isinstance(recording, tm.Recording)
    assert (recording.shape, recording.targets) == ((90, 6, 8), 3)
    assert recording.range_mm.shape == SHAPE
    found = tm.estimate(recording, window=45, workers=1)
    assert found.window_stop.tolist() == [45, 90]
    assert found.n_samples.sum() == (samples() > 0).sum()
    saved = tm.open(found.save(tmp_path / "p.layers.h5"))
    assert isinstance(saved, tm.Estimate)
    assert saved.provenance.targets == 3
    again = tm.open(recording.save(tmp_path / "copy.h5"))
    assert isinstance(again, tm.Recording)
    np.testing.assert_array_equal(again.range_mm, recording.range_mm)


def test_refusal_of_reconcile_names_the_command_that_keeps_one_target(
    tofmix: Tofmix, made: Path, tmp_path: Path
) -> None:
    model = tmp_path / "model.toml"
    model.write_text(
        '[sensor]\nprofile = "sr4000"\nrows = 6\ncols = 8\n[[surface]]\nname = "wall"\n'
        f"center_mm = [0.0, 0.0, {NEAR_MM}]\nsize_mm = [9e3, 9e3]\n"
    )
    refused = tofmix("reconcile", model, made / "t.h5", "-o", tmp_path / "gap")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err.count("\n") == 1
    command = refused.err.strip().partition("tofmix import ")[2].split()
    assert command[1:3] == ["--target", "nearest"]
    assert tofmix("import", *command).code == 0
    with h5py.File(command[-1]) as root:
        valid = np.where(samples() > 0, samples(), 65535)
        nearest = valid.min(axis=1)
        np.testing.assert_array_equal(root["range"][...], np.where(nearest < 65535, nearest, 0))


def test_strongest_target_has_its_own_amplitude_and_needs_amplitudes(
    tofmix: Tofmix, made: Path, tmp_path: Path
) -> None:
    refused = tofmix("import", made / "t.h5", "-o", tmp_path / "s.h5", "--target", "strongest")
    assert refused.code == ExitCode.BAD_INPUT
    assert "--target nearest" in refused.err
    light = np.random.default_rng(3).uniform(1, 99, SHAPE).astype(np.float32)
    np.save(tmp_path / "a.npy", light)
    done = tofmix(
        "import",
        made / "t.npy",
        "-o",
        tmp_path / "s.h5",
        "--target",
        "strongest",
        "--amplitude",
        tmp_path / "a.npy",
        "--axes",
        "frame,target,row,col",
    )
    assert done.code == 0, done.err
    best = np.where(samples() > 0, light, -1.0).argmax(axis=1)[:, None]
    with h5py.File(tmp_path / "s.h5") as root:
        for name, values in (("range", samples()), ("amplitude", light)):
            expected = np.take_along_axis(values, best, axis=1)[:, 0]
            some = (samples() > 0).any(axis=1)
            np.testing.assert_array_equal(root[name][...][some], expected[some])


def test_target_of_a_recording_with_one_sample_a_frame_is_a_wrong_option(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", samples()[:, 0])
    refused = tofmix("import", tmp_path / "one.npy", "-o", tmp_path / "one.h5", "--target", "nearest")
    assert refused.code == ExitCode.USAGE
    assert "leave the option out" in refused.err
