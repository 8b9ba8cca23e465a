"""`tofmix import`: every kind of source into a recording that `estimate` reads, and refusals."""

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
TOPICS = ("--topic", DEPTH, "--amplitude", AMPLITUDE)
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
    done = tofmix("import", source, "-o", out, "--sensor", sensor, *options)
    assert done.code == 0, done.err
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
    assert tofmix("estimate", out).code == 0


def test_bag_depths_in_metres_become_ranges_by_its_intrinsics(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    fx, fy, cx, cy = 5.2, 5.5, 2.5, 1.5
    metres = (samples() / np.float32(1000)).astype("f4")
    metres[metres == 0] = np.nan
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, (4, 6), (fx, fy, cx, cy))
        for number, image in enumerate(metres):
            bag.image(DEPTH, image, stamp_ns=(1 + number) * 10**9)
            bag.image(AMPLITUDE, np.full((4, 6), number, "u2"), stamp_ns=(1 + number) * 10**9)
    done = tofmix(
        "import", path, "-o", tmp_path / "r.h5", "--sensor", sensor, "--topic", DEPTH, "--amplitude", AMPLITUDE
    )
    assert done.code == 0, done.err
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
    done = tofmix("import", source, "-o", tmp_path / "r.h5", "--sensor", sensor, "--depth-axis", "z", *given)
    assert done.code == 0, done.err
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
    done = tofmix(
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
    assert done.code == 0, done.err
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
        assert tofmix("import", source, "-o", out, "--sensor", sensor, *options).code == 0
        with h5py.File(out) as root:
            written.append(root["range"].chunks[0])
            np.testing.assert_array_equal(root["range"][...], samples())
    assert written == [7, 2]


def test_import_warns_of_doubtful_ranges(tofmix: Tofmix, tmp_path: Path, sensor: Path) -> None:
    np.save(tmp_path / "m.npy", samples() / 1000)
    said = tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "m.h5", "--sensor", sensor)
    assert said.code == ExitCode.BAD_INPUT
    assert "too small for mm; give --units m, or --units mm if mm is right" in said.err
    said = tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "m.h5", "--sensor", sensor, "--units", "mm")
    assert said.code == 0
    assert "no camera sees so near; check the units; if the numbers are in m: tofmix import" in said.err
    said = tofmix("import", tmp_path / "m.npy", "-o", tmp_path / "b.h5", "--sensor", "sr3000", "--scale", 1000)
    assert said.err.count("\n") == 1
    assert "4 x 6 pixels, SR-3000 has 144 x 176" in said.err
    np.save(tmp_path / "z.npy", np.zeros(SHAPE, "u2"))
    assert "no valid sample" in tofmix("import", tmp_path / "z.npy", "-o", tmp_path / "z.h5", "--sensor", sensor).err
    with new_bag(tmp_path, "mcap") as (bag, path):
        bag.info(INFO, (4, 6), (50.0, 50.0, 2.5, 1.5))
        bag.image(DEPTH, samples()[0], stamp_ns=10**9)
        bag.image(AMPLITUDE, samples()[0], stamp_ns=2 * 10**9)
    said = tofmix(
        "import", path, "-o", tmp_path / "v.h5", "--sensor", sensor, "--topic", DEPTH, "--amplitude", AMPLITUDE
    )
    assert said.code == 0, said.err
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
    assert tofmix("import", metres, "-o", tmp_path / "m.h5", "--units", "m").code == 0
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
        outcome = tofmix("import", *arguments)
        assert outcome.code == code, (arguments, outcome.err)
        assert text in outcome.err, outcome.err
        assert outcome.err.count("\n") == 1
        assert outcome.out == ""
    assert not (tmp_path / "r.h5").exists(), "a refused import leaves nothing behind"
    assert (tmp_path / "old.h5").read_text() == "old"
