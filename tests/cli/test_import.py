"""`tofmix import`: every kind of source into a recording that `estimate` reads, several targets, refusals."""

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
import xarray
from numpy.typing import NDArray
from scipy.io import savemat
from support import naive_png
from support.bags import AMPLITUDE, DEPTH, INFO, KINDS, new_bag
from support.commandline import Tofmix

from tofmix.errors import ExitCode
from tofmix.io.importers import writing

SHAPE = (7, 4, 6)
SENSOR = """
[sensor]
profile = "sr3000"
name = "small camera"
rows = 4
cols = 6
fov_horizontal_deg = 60.0
fov_vertical_deg = 40.0
integration_time_ms = 1.2
"""


@pytest.fixture
def sensor(tmp_path: Path) -> Path:
    path = tmp_path / "camera.toml"
    path.write_text(SENSOR)
    return path


def samples() -> NDArray[np.uint16]:
    values = np.random.default_rng(6).integers(700, 7000, SHAPE).astype("u2")
    values[2, 1, 3] = 0
    return values


def write_source(folder: Path, kind: str) -> tuple[Path, tuple[str, ...]]:
    """Write the samples as a source of a kind; what to say beside its path."""
    if kind in KINDS:
        with new_bag(folder, kind) as (bag, path):
            for number, image in enumerate(samples()):
                bag.image(DEPTH, image, stamp_ns=10**9 + number * 10**8)
        return path, ("--depth-axis", "ray")
    path = folder / f"source.{kind}"
    if kind == "png":
        path = folder / "images"
        path.mkdir()
        for number, image in enumerate(samples()):
            (path / f"{number}.png").write_bytes(naive_png.encode(image))
        return path, ("--depth-axis", "ray")
    if kind == "tif":
        tifffile.imwrite(path, samples(), photometric="minisblack")
        return path, ("--depth-axis", "ray")
    if kind == "npy":
        np.save(path, samples())
    elif kind == "npz":
        np.savez(path, anything=samples())
    else:
        savemat(path, {"anything": np.moveaxis(samples(), 0, -1)})
    return path, ()


@pytest.mark.parametrize("kind", [*KINDS, "png", "tif", "npy", "npz", "mat"])
def test_every_source_comes_back_exactly(tofmix: Tofmix, tmp_path: Path, sensor: Path, kind: str) -> None:
    source, options = write_source(tmp_path, kind)
    out = tmp_path / "r.h5"
    done = tofmix.done("import", source, "-o", out, "--sensor", sensor, *options)
    assert done.err == ""
    assert "7 frames of 4 x 6 pixels" in done.out
    assert "taken as ranges" in done.out
    with h5py.File(out) as root:
        assert root["range"].dtype == np.uint16
        assert root["range"].attrs["_FillValue"] == [0]
        np.testing.assert_array_equal(root["range"][...], samples())
        assert root["sensor"].attrs["name"] == "small camera"
        assert root["sensor"].attrs["integration_time_ms"] == 1.2
        assert ("time" in root) == (kind in KINDS)
        if kind in KINDS:
            np.testing.assert_allclose(root["time"][...], 0.1 * np.arange(7), rtol=0, atol=1e-12)
    with xarray.open_dataset(out, engine="h5netcdf") as data:
        assert data["range"].dims == ("frame", "row", "col")
    tofmix.done("estimate", out)


def test_bag_depths_in_metres_become_ranges_by_its_intrinsics(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    fx, fy, cx, cy = 5.2, 5.5, 2.5, 1.5
    metres = (samples() / np.float32(1000)).astype("f4")
    metres[metres == 0] = np.nan
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, (4, 6), (fx, fy, cx, cy))
        for number, image in enumerate(metres):
            bag.image(DEPTH, image, stamp_ns=(1 + number) * 10**9)
            bag.image(AMPLITUDE, np.full((4, 6), number, "u2"), stamp_ns=(1 + number) * 10**9)
    done = tofmix.done(
        "import", path, "-o", tmp_path / "r.h5", "--sensor", sensor, "--topic", DEPTH, "--amplitude", AMPLITUDE
    )
    assert "pinhole fx 5.2 fy 5.5 cx 2.5 cy 1.5" in done.out
    row, col = np.mgrid[0:4, 0:6]
    x, y, z = (col - cx) / fx * metres, (row - cy) / fy * metres, metres
    with h5py.File(tmp_path / "r.h5") as root:
        np.testing.assert_allclose(root["range"][...], 1000 * np.sqrt(x**2 + y**2 + z**2), rtol=3e-7)
        assert np.isnan(root["range"][2, 1, 3])
        np.testing.assert_array_equal(root["amplitude"][:, 0, 0], np.arange(7))


@pytest.mark.parametrize("intrinsics", [None, "5,6,2.5,1.5"])
def test_array_depths_along_z_become_ranges(
    tofmix: Tofmix, tmp_path: Path, sensor: Path, intrinsics: str | None
) -> None:
    source, _ = write_source(tmp_path, "npy")
    given = () if intrinsics is None else ("--intrinsics", intrinsics)
    done = tofmix.done("import", source, "-o", tmp_path / "r.h5", "--sensor", sensor, "--depth-axis", "z", *given)
    row, col = np.mgrid[0:4, 0:6]
    if intrinsics is None:
        assert "field of view 60 x 40 degrees, equal angles" in done.out
        over = 1 / (np.cos(np.deg2rad((col - 2.5) * 10)) * np.cos(np.deg2rad((row - 1.5) * 10)))
    else:
        over = np.sqrt(1 + ((col - 2.5) / 5) ** 2 + ((row - 1.5) / 6) ** 2)
    with h5py.File(tmp_path / "r.h5") as root:
        expected = np.where(samples() == 0, np.nan, samples() * over)
        np.testing.assert_allclose(root["range"][...], expected, rtol=1e-7)


def test_scale_invalid_and_frame_rate_options_are_applied(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    np.save(tmp_path / "a.npy", samples())
    tofmix.done(
        "import",
        tmp_path / "a.npy",
        "-o",
        tmp_path / "r.h5",
        "--sensor",
        sensor,
        "--scale",
        0.5,
        "--invalid",
        65535,
        "--invalid",
        int(samples()[0, 0, 0]),
        "--frame-rate",
        20,
    )
    with h5py.File(tmp_path / "r.h5") as root:
        read = root["range"][...]
        np.testing.assert_allclose(root["time"][...], np.arange(7) / 20)
    gone = (samples() == 0) | (samples() == samples()[0, 0, 0])
    np.testing.assert_array_equal(read, np.where(gone, np.nan, samples() * np.float32(0.5)))


def test_long_sources_are_written_in_blocks(
    tofmix: Tofmix, tmp_path: Path, sensor: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = []
    for limit in (10**6, 200):  # 200 bytes are two frames of 4 x 6
        monkeypatch.setattr(writing, "BLOCK_BYTES", limit)
        out = tmp_path / f"{limit}.h5"
        source, options = write_source(tmp_path, "tif")
        tofmix.done("import", source, "-o", out, "--sensor", sensor, *options)
        with h5py.File(out) as root:
            written.append(root["range"].chunks[0])
            np.testing.assert_array_equal(root["range"][...], samples())
    assert written == [7, 2]


def test_import_warns_of_doubtful_ranges(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    np.save(tmp_path / "m.npy", samples() / 1000)
    said = tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "m.h5", "--sensor", sensor)
    said.refused(ExitCode.BAD_INPUT, "too small for mm; give --units m, or --units mm if mm is right")
    said = tofmix.done("import", tmp_path / "m.npy", "-o", tmp_path / "m.h5", "--sensor", sensor, "--units", "mm")
    assert "no camera sees so near; check the units; if the numbers are in m: tofmix import" in said.err
    said = tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "b.h5", "--sensor", "sr3000", "--scale", 1000)
    assert said.err.count("\n") == 1
    assert "4 x 6 pixels, SR-3000 has 144 x 176" in said.err
    np.save(tmp_path / "counts.npy", samples() // 1000)
    tofmix.done("import", tmp_path / "counts.npy", "-o", tmp_path / "c.h5", "--sensor", sensor)
    np.save(tmp_path / "z.npy", np.zeros(SHAPE, "u2"))
    assert "no valid sample" in tofmix("import", tmp_path / "z.npy", "-o", tmp_path / "z.h5", "--sensor", sensor).err
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, (4, 6), (50.0, 50.0, 2.5, 1.5))
        bag.image(DEPTH, samples()[0], stamp_ns=10**9)
        bag.image(AMPLITUDE, samples()[0], stamp_ns=2 * 10**9)
    said = tofmix.done(
        "import", path, "-o", tmp_path / "v.h5", "--sensor", sensor, "--topic", DEPTH, "--amplitude", AMPLITUDE
    )
    assert "1 frame without an amplitude image" in said.err


def test_the_same_source_gives_the_same_bytes(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    source, options = write_source(tmp_path, "mcap")
    for name in ("a.h5", "b.h5"):
        assert tofmix("import", source, "-o", tmp_path / name, "--sensor", sensor, *options).code == 0
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_truncated_source_leaves_no_output(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    with new_bag(tmp_path, "mcap") as (bag, path):
        for number, image in enumerate(samples()):
            bag.image(DEPTH, image, stamp_ns=10**9 * (number + 1), lost_bytes=2 * (number == 6))
    out = tmp_path / "r.h5"
    out.write_text("old")
    failed = tofmix("import", path, "-o", out, "--sensor", sensor, "--overwrite")
    assert failed.code == ExitCode.BAD_INPUT
    assert failed.err.count("\n") == 1
    assert out.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bag_mcap", "camera.toml", "r.h5"]


def test_import_refuses_options_and_sources_with_their_exit_code(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    source, _ = write_source(tmp_path, "npy")
    images, _ = write_source(tmp_path, "png")
    (tmp_path / "no_sensor.toml").write_text("[recording]\nframes = 3\n")
    (tmp_path / "old.h5").write_text("old")
    blank, metres = tmp_path / "blank.npy", tmp_path / "metres.csv"
    blank.touch()
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as root:
        root["data"] = samples()
    metres.write_text("frame,row,col,range_m\n0,0,0,1.5\n1,0,0,1.6\n")
    tofmix.done("import", metres, "-o", tmp_path / "m.h5", "--units", "m")
    out = ("-o", tmp_path / "r.h5")
    chosen: tuple[Any, ...] = ("--sensor", sensor)
    for arguments, code, text in (
        ((source, *out, "--units", "m", "--scale", 1000), ExitCode.USAGE, "both set the unit"),
        ((source, *out, "--fov", "70"), ExitCode.USAGE, "--fov: '70' is not HxV"),
        ((source, *out, "--fov", "70x190"), ExitCode.USAGE, "up to 360x180"),
        ((source, *out, "--fov", "200x90", "--depth-axis", "z"), ExitCode.USAGE, "a pinhole sees less than 180"),
        ((source, *out, "--shape", "8"), ExitCode.USAGE, "ROWSxCOLS"),
        ((source, *out, "--axes", "frame,row"), ExitCode.USAGE, "is not an order of frame, row and col"),
        ((source, *out, "--depth-axis", "z"), ExitCode.BAD_INPUT, "give --intrinsics FX,FY,CX,CY or --fov HxV"),
        ((images, *out), ExitCode.BAD_INPUT, "or --depth-axis ray if they are along the beam"),
        ((source, *out, "--sensor", "sr9"), ExitCode.BAD_INPUT, "not a built-in sensor (sr3000"),
        ((source, *out, "--sensor", tmp_path / "no_sensor.toml"), ExitCode.BAD_INPUT, "no table [sensor]"),
        ((source, *out, "--sensor", source), ExitCode.BAD_INPUT, "not a UTF-8 text file"),
        ((source, *chosen), ExitCode.USAGE, "--output"),
        ((source, "-o", tmp_path / "old.h5", *chosen), ExitCode.USAGE, "--overwrite"),
        ((foreign, "-o", foreign, *chosen, "--overwrite"), ExitCode.USAGE, "is the input"),
        ((source, "-o", tmp_path / "none" / "r.h5", *chosen), ExitCode.STORAGE, "no such folder"),
        ((tmp_path / "none.npy", *out, *chosen), ExitCode.BAD_INPUT, "No such file"),
        ((tmp_path / "camera.toml", *out, *chosen), ExitCode.USAGE, "not a known source"),
        ((source, *out, *chosen, "--topic", "a"), ExitCode.USAGE, "--dataset does not apply to"),
        ((source, *out, *chosen, "--intrinsics", "lens.yaml"), ExitCode.USAGE, "nor a calibration file"),
        ((source, *out, *chosen, "--depth-axis", "z", "--intrinsics", "5,5"), ExitCode.USAGE, "FX,FY,CX,CY"),
        (
            (source, *out, *chosen, "--depth-axis", "z", "--intrinsics", "0,5,1,1"),
            ExitCode.BAD_INPUT,
            "--intrinsics: fx: 0 is",
        ),
        ((source, *out, *chosen, "--scale", "inf"), ExitCode.USAGE, "--scale"),
        ((source, *out, *chosen, "--scale", "nan"), ExitCode.USAGE, "--scale"),
        ((source, *out, *chosen, "--amplitude", tmp_path / "none.npy"), ExitCode.BAD_INPUT, "none.npy"),
        ((source, *out, "--shape", "3x3"), ExitCode.USAGE, f"--shape 3x3: {source} has images of 4 x 6 already"),
        ((source, "-o", tmp_path / "e.npy"), ExitCode.USAGE, "must not end in .npy; choose .h5"),
        (
            (images / "0.png", *out),
            ExitCode.USAGE,
            f"a recording needs a folder of images: tofmix import {images} -o {images}.h5",
        ),
        ((blank, *out), ExitCode.BAD_INPUT, "blank.npy: empty"),
        (
            (metres, *out, "--units", "mm"),
            ExitCode.BAD_INPUT,
            "the column is range_m, but --units or --scale says 1 mm",
        ),
    ):
        tofmix("import", *arguments).refused(code, text)
    assert not (tmp_path / "r.h5").exists(), "a refused import leaves nothing behind"
    assert (tmp_path / "old.h5").read_text() == "old"


SHAPE_ANY_CAMERA = (60, 4, 6)
"""Frames enough for a noise curve."""


def samples_any_camera(shape: tuple[int, ...] = SHAPE_ANY_CAMERA, seed: int = 3) -> NDArray[np.float64]:
    """A wall whose pixels stand 10 mm apart, with 4 mm of noise."""
    rng = np.random.default_rng(seed)
    wall = 1500.0 + 10.0 * np.arange(np.prod(shape[-2:])).reshape(shape[-2:])
    return np.asarray(wall + rng.normal(0.0, 4.0, shape))


def read(path: Path, name: str = "range") -> NDArray[Any]:
    with h5py.File(path) as root:
        return np.asarray(root[name][...])


def test_array_without_a_sensor_has_unknown_camera_data(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples_any_camera())
    out = tmp_path / "a.h5"
    done = tofmix("import", tmp_path / "a.npy", "-o", out)
    assert (done.code, done.err) == (0, "")
    assert "depths along the beam, taken as ranges (--depth-axis z if they are along z)" in done.out
    assert "not known: field of view (export, map and surfaces need it: import --fov), largest range" in done.out
    with h5py.File(out) as root:
        assert root["sensor"].attrs["name"] == "unknown"
        for key in ("range_min_mm", "range_max_mm", "fov_horizontal_deg", "fov_vertical_deg", "integration_time_ms"):
            assert np.isnan(root["sensor"].attrs[key]), key
        assert "noise_sigma" not in root["sensor"]
    tofmix.done("verify", out)
    told = tofmix("info", out)
    assert "No field of view" in told.out
    assert "No range_max_mm" in told.out


@pytest.mark.slow
def test_commands_name_the_missing_camera_data(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", samples_any_camera((60, 8, 8)))
    tofmix("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5")
    layers = tmp_path / "a.layers.h5"
    done = tofmix.done("estimate", tmp_path / "a.h5")
    assert "noise: sigma 4 mm" in done.err or "noise: sigma 3.9" in done.err
    assert "no range_max_mm" in done.err
    assert (read(layers, "n_modes") == 1).all()
    refused = tofmix("export", layers, "-o", tmp_path / "a.ply")
    refused.refused(ExitCode.BAD_INPUT, "no field of view, so points cannot be placed; give it with --fov")
    tofmix.done("export", layers, "-o", tmp_path / "a.ply", "--fov", "60,45")
    refused = tofmix("map", layers, "-o", tmp_path / "map.yaml")
    assert refused.code == ExitCode.BAD_INPUT
    assert refused.err == (
        f"tofmix: {layers}: the directions of its pixels are not known; import the recording with --fov HxV or"
        " --intrinsics, and estimate again\n"
    )
    remedy = "known; give them with --fov HxV, or import"
    assert tofmix("surfaces", layers).err == refused.err.replace("known; import", remedy)


def test_metres_are_noticed_after_empty_first_frames(tofmix: Tofmix, tmp_path: Path) -> None:
    values = (samples_any_camera((250, 4, 6)) / 1000).astype("f4")
    values[:120] = np.nan
    np.save(tmp_path / "m.npy", values)
    assert tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "m.h5").code == ExitCode.BAD_INPUT


@pytest.mark.parametrize("kind", ["png", "tif"])
def test_images_are_along_z_and_become_ranges_by_an_ideal_pinhole(tofmix: Tofmix, tmp_path: Path, kind: str) -> None:
    flat = np.full((3, 4, 6), 2000, dtype=np.uint16)
    source = tmp_path / ("images" if kind == "png" else "a.tif")
    if kind == "png":
        source.mkdir()
        for number, image in enumerate(flat):
            (source / f"{number}.png").write_bytes(naive_png.encode(image))
    else:
        tifffile.imwrite(source, flat, photometric="minisblack")
    done = tofmix.done("import", source, "-o", tmp_path / "a.h5", "--fov", "90x60")
    assert "depths along z converted to ranges by an ideal pinhole of 90 x 60 degrees" in done.out
    assert "--depth-axis ray if they are along the beam" in done.out
    row, col = np.mgrid[0:4, 0:6]
    x, y = (col - 2.5) / 3.0, (row - 1.5) / 2.0 * np.tan(np.radians(30))
    np.testing.assert_allclose(read(tmp_path / "a.h5"), np.tile(2000 * np.sqrt(1 + x**2 + y**2), (3, 1, 1)), rtol=1e-6)
    tofmix.done("import", source, "-o", tmp_path / "b.h5", "--depth-axis", "ray")
    np.testing.assert_array_equal(read(tmp_path / "b.h5"), flat)


def write_h5(path: Path, name: str, **attributes: object) -> None:
    with h5py.File(path, "w") as root:
        dataset = root.create_dataset(
            name, data=samples_any_camera().astype("f4"), chunks=(7, 2, 6), compression="gzip"
        )
        for key, value in attributes.items():
            dataset.attrs[key] = value
        root.create_dataset("calibration/dark", data=np.zeros((4, 6)))


def test_only_dataset_of_frames_is_found_without_its_name(tofmix: Tofmix, tmp_path: Path) -> None:
    write_h5(tmp_path / "x.h5", "entry/data")
    done = tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5")
    assert (done.code, done.err) == (0, "")
    assert "dataset entry/data of an HDF5 file" in done.out
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), samples_any_camera().astype("f4"))


def test_units_and_fill_value_of_a_dataset_are_used_and_the_command_line_overrules_them(
    tofmix: Tofmix, tmp_path: Path
) -> None:
    write_h5(tmp_path / "x.h5", "d", units="cm", _FillValue=np.float32(samples_any_camera().astype("f4")[0, 0, 0]))
    tofmix.done("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5")
    found = read(tmp_path / "r.h5")
    assert np.isnan(found[0, 0, 0])
    np.testing.assert_allclose(found.ravel()[1:], 10 * samples_any_camera().ravel()[1:], rtol=1e-6)
    tofmix.done("import", tmp_path / "x.h5", "-o", tmp_path / "s.h5", "--units", "mm")
    np.testing.assert_allclose(read(tmp_path / "s.h5").ravel()[1:], samples_any_camera().ravel()[1:], rtol=1e-6)
    write_h5(tmp_path / "y.h5", "d", units="counts")
    refused = tofmix("import", tmp_path / "y.h5", "-o", tmp_path / "y_.h5")
    refused.refused(ExitCode.BAD_INPUT, "units 'counts' are not a known unit of length")
    tofmix.done("import", tmp_path / "y.h5", "-o", tmp_path / "y_.h5", "--scale", 2)


def test_one_of_several_datasets_is_chosen_by_name(tofmix: Tofmix, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as root:
        root["a/first"], root["a/second"] = samples_any_camera().astype("f4"), samples_any_camera(seed=9).astype("f4")
        root["a/time"] = np.arange(SHAPE_ANY_CAMERA[0]) / 25.0
    refused = tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5")
    refused.refused(ExitCode.BAD_INPUT, "choose one with --dataset: a/first (60, 4, 6), a/second (60, 4, 6)")
    tofmix.done(
        "import", tmp_path / "x.h5", "-o", tmp_path / "r.h5", "--dataset", "/a/first", "--amplitude", "a/second"
    )
    np.testing.assert_array_equal(read(tmp_path / "r.h5"), samples_any_camera().astype("f4"))
    np.testing.assert_array_equal(read(tmp_path / "r.h5", "amplitude"), samples_any_camera(seed=9).astype("f4"))
    np.testing.assert_allclose(read(tmp_path / "r.h5", "time"), np.arange(SHAPE_ANY_CAMERA[0]) / 25.0)


def test_a_recording_in_metres_keeps_its_camera(tofmix: Tofmix, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as root:
        root["range"], root["amplitude"] = (samples_any_camera() / 1000).astype("f4"), samples_any_camera().astype("f4")
        root.create_group("sensor").attrs["range_max_mm"] = 9000.0
    assert tofmix("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5").code == ExitCode.BAD_INPUT
    tofmix.done("import", tmp_path / "x.h5", "-o", tmp_path / "r.h5", "--units", "m")
    np.testing.assert_allclose(read(tmp_path / "r.h5"), samples_any_camera(), rtol=1e-6)
    with h5py.File(tmp_path / "r.h5") as root:
        assert root["sensor"].attrs["range_max_mm"] == 9000.0
        assert "amplitude" in root


def test_a_long_csv_may_name_its_unit_and_count_from_1(tofmix: Tofmix, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame,row,col,range_m\n1,1,1,1.5\n1,1,2,1.6\n2,1,1,1.7\n2,1,2,-1\n")
    done = tofmix.done("import", tmp_path / "a.csv", "-o", tmp_path / "r.h5", "--invalid", -1)
    assert "rows and columns are taken to start at 1, because none is 0" in done.err
    expected = np.array([[[1500.0, 1600.0]], [[1700.0, np.nan]]])
    np.testing.assert_allclose(read(tmp_path / "r.h5"), expected)


@pytest.mark.parametrize(
    ("text", "options", "reason"),
    [
        ("1,2,3\n4,5,6\n", (), "give --shape ROWSxCOLS"),
        ("1,2,3\n4,5,6\n", ("--shape", "2x2"), "3 values in the first line, --shape 2x2 has 4"),
        ("1,2\n4\n", ("--shape", "1x2"), "line 2: 1 value, the first line has 2"),
        ("1,2\n4,x\n", ("--shape", "1x2"), "line 2: cannot be read"),
        ("", ("--shape", "1x2"), "empty"),
        ("a,b\n", ("--shape", "1x2"), "no frame below its header"),
        ("frame,row,range\n0,0,1000\n", (), "its header names no col"),
        ("frame,row,col,depth\n0,0,0,1000\n", (), "its header names no range"),
        ("frame,row,col,range\n", (), "no sample below its header"),
        ("frame,row,col,range\n0,0.5,0,1000\n", (), "row: 0.5 is not a whole number"),
        ("frame,row,col,range\n0,0,-1,1000\n", (), "col: -1 is not a whole number"),
        ("frame,row,col,range\n0,0,0,1000\n0,0,0,2000\n", (), "need a column target"),
        ("frame,row,col,range\n0,0,0,1000\n0,0,90000,2000\n", (), "no more than 4096"),
        ("frame,row,col,range\n0,0,0,1000\n0,9,0,2000\n", ("--shape", "4x6"), "outside of --shape 4x6"),
        ("frame,row,col,range\n0,0,0,oops\n", (), "cannot be read"),
        ("frame,row,col,target,range\n0,0,0,0,9\n0,4000,4000,60,9\n", (), "61 targets of 4001 x 4001 pixels; no more"),
    ],
)
def test_invalid_csv_is_refused_in_one_line(
    tofmix: Tofmix, tmp_path: Path, text: str, options: tuple[str, ...], reason: str
) -> None:
    (tmp_path / "a.csv").write_text(text)
    tofmix("import", tmp_path / "a.csv", "-o", tmp_path / "r.h5", *options).refused(ExitCode.BAD_INPUT, reason)
    assert not (tmp_path / "r.h5").exists()


def test_json_lists_the_output_and_unknown_camera_data(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((5, 3, 4), 1234.0))
    done = tofmix.done("import", tmp_path / "a.npy", "-o", tmp_path / "a.h5", "--units", "mm", "--json")
    made = json.loads(done.out)
    assert (made["frames"], made["rows"], made["cols"], made["targets"], made["unit_mm"]) == (5, 3, 4, 0, 1.0)
    assert made["output"] == str(tmp_path / "a.h5")
    unknown = ["field of view", "largest range", "noise curve", "times of the frames", "amplitudes"]
    unknown += ["modulation frequency"]
    assert [line.split(" (")[0] for line in made["not_known"]] == unknown


SHAPE_TARGETS = (90, 3, 6, 8)
"""Frames, targets, rows, columns."""

NEAR_MM, FAR_MM, SIGMA_MM = 800.0, 2000.0, 6.0


def samples_targets() -> NDArray[np.uint16]:
    """A near wall in all zones, a far one as second target in the right half; one target of ten is lost."""
    rng = np.random.default_rng(5)
    values = np.zeros(SHAPE_TARGETS)
    values[:, 0] = rng.normal(NEAR_MM, SIGMA_MM, values[:, 0].shape)
    values[:, 1, :, 4:] = rng.normal(FAR_MM, SIGMA_MM, values[:, 1, :, 4:].shape)
    values[rng.random(SHAPE_TARGETS) < 0.1] = 0
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
    np.save(folder / "t.npy", samples_targets())
    imported = tofmix.done(
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
    assert "90 frames of 6 x 8 pixels of 3 targets" in imported.out
    estimated = tofmix.done("estimate", folder / "t.h5")
    assert "Each pixel has up to 3 targets a frame" in estimated.err
    assert "A share is the share of its detections" in estimated.err
    return folder


def test_all_valid_targets_are_samples_of_their_pixel(made: Path) -> None:
    valid = samples_targets() > 0
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
    tofmix.done("verify", recording, layers)
    shown = tofmix("inspect", layers, "--pixel", "2,5", "--recording", recording)
    assert "a share is the share of detections, up to 3 a frame" in shown.out
    assert json.loads(tofmix("inspect", layers, "--pixel", "2,5", "--json").out)["targets"] == 3
    assert "share of its detections" in " ".join(tofmix("report", layers).out.split())
    page = tmp_path / "t.html"
    tofmix.done("report", layers, "--recording", recording, "--html", page)
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


@pytest.mark.slow
def test_windows_are_counted_in_frames(tofmix: Tofmix, made: Path, tmp_path: Path) -> None:
    out = tmp_path / "w.layers.h5"
    done = tofmix.done("estimate", made / "t.h5", "-o", out, "--window", 40, "--json")
    said = json.loads(done.out)
    assert (said["windows"], said["window_frames"], said["frames_left_out"], said["targets"]) == (2, 40, 10, 3)
    with h5py.File(out) as root:
        assert root["window_stop"][...].tolist() == [40, 80]
        np.testing.assert_array_equal(root["n_samples"][1], (samples_targets()[40:80] > 0).sum(axis=(0, 1)))
    tofmix.done("verify", out)
    shown = json.loads(
        tofmix("inspect", out, "--pixel", "2,5", "--window", 1, "--recording", made / "t.h5", "--json").out
    )
    pixel = next(one for one in shown["pixels"] if one["col"] == 5)
    assert pixel["n_samples"] == (samples_targets()[40:80, :, 2, 5] > 0).sum()
    assert tofmix("estimate", made / "t.h5", "-o", out, "--window", 91, "--overwrite").code == ExitCode.USAGE


@pytest.mark.slow
def test_bytes_do_not_depend_on_pieces_of_a_recording_with_targets(tofmix: Tofmix, made: Path) -> None:
    tofmix.same_in_pieces(made / "t.h5", "--window", 40)


@pytest.mark.parametrize("source", ["averaged", pytest.param("thin-beam", marks=pytest.mark.slow)])
def test_maps_for_comparison_average_all_detections(tofmix: Tofmix, made: Path, tmp_path: Path, source: str) -> None:
    tofmix.done("map", made / "t.layers.h5", "-o", tmp_path / "m.yaml", "--from", source, "--recording", made / "t.h5")


@pytest.mark.parametrize("axes", ["frame,row,col,target", "target,row,col,frame"])
@pytest.mark.parametrize("kind", ["npy", "npz", "h5"])
def test_target_arrays_of_any_order_of_axes_are_imported(tofmix: Tofmix, tmp_path: Path, kind: str, axes: str) -> None:
    order = [["frame", "target", "row", "col"].index(name) for name in axes.split(",")]
    values: Any = np.ascontiguousarray(np.transpose(samples_targets(), order))
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
    tofmix.done("import", path, "-o", tmp_path / "r.h5", "--axes", axes)
    with h5py.File(tmp_path / "r.h5") as root:
        np.testing.assert_array_equal(root["range"][...], samples_targets())


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
    tofmix.done("import", *command)
    with h5py.File(command[-1]) as root:
        valid = np.where(samples_targets() > 0, samples_targets(), 65535)
        nearest = valid.min(axis=1)
        np.testing.assert_array_equal(root["range"][...], np.where(nearest < 65535, nearest, 0))


def test_strongest_target_has_its_own_amplitude_and_needs_amplitudes(
    tofmix: Tofmix, made: Path, tmp_path: Path
) -> None:
    refused = tofmix("import", made / "t.h5", "-o", tmp_path / "s.h5", "--target", "strongest")
    refused.refused(ExitCode.BAD_INPUT, "--target nearest")
    light = np.random.default_rng(3).uniform(1, 99, SHAPE_TARGETS).astype(np.float32)
    np.save(tmp_path / "a.npy", light)
    tofmix.done(
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
    best = np.where(samples_targets() > 0, light, -1.0).argmax(axis=1)[:, None]
    with h5py.File(tmp_path / "s.h5") as root:
        for name, values in (("range", samples_targets()), ("amplitude", light)):
            expected = np.take_along_axis(values, best, axis=1)[:, 0]
            some = (samples_targets() > 0).any(axis=1)
            np.testing.assert_array_equal(root[name][...][some], expected[some])


def test_target_of_a_recording_with_one_sample_a_frame_is_a_wrong_option(tofmix: Tofmix, tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", samples_targets()[:, 0])
    refused = tofmix("import", tmp_path / "one.npy", "-o", tmp_path / "one.h5", "--target", "nearest")
    refused.refused(ExitCode.USAGE, "leave the option out")
